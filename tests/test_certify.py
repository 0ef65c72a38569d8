"""`outrider design` and `outrider certify` as they are typed."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from outrider import cli
from outrider.io.run import open_run

pytestmark = pytest.mark.once

PUBLISHED, UNSTABLE = "67.20,823.1,2818.5", "78.83,914.6,-2215.8"


# ---------------------------------------------------------------- what is proven


def test_the_shipped_proofs_of_an_observer(outrider: Any) -> None:
    code, out, _ = outrider("certify", "multi_stage")
    assert code == 0
    assert out.count("multi_stage: proven") == 2
    assert "speed [m/s]: 1 to 20" in out


def test_the_published_high_gain_over_the_region_it_was_found_to_hold(outrider: Any) -> None:
    region = ("--speed", "2:20", "--accel", 1, "--yaw-rate", 1.9)
    code, out, _ = outrider("certify", "high_gain", "--gain", PUBLISHED, *region)
    assert code == 0
    assert "high_gain: proven" in out
    region = ("--speed", "5:20", "--accel", 3, "--yaw-rate", 1.7)
    assert outrider("certify", "high_gain", "--gain", PUBLISHED, *region)[0] == 0


def test_where_a_frozen_matrix_is_unstable_the_eigenvalue_is_named(outrider: Any) -> None:
    region = ("--speed", "2:20", "--accel", 3, "--yaw-rate", 0.5)
    code, out, err = outrider("certify", "high_gain", "--gain", PUBLISHED, *region)
    assert (code, out) == (3, "")
    assert "eigenvalue +0." in err
    code, _, err = outrider("certify", "high_gain", "--gain", UNSTABLE)
    assert code == 3
    assert "eigenvalue +" in err
    assert "no proof can exist" in err


def test_a_kalman_filter_claims_nothing(outrider: Any) -> None:
    code, _, err = outrider("certify", "ekf")
    assert code == 3
    assert "nothing is claimed" in err
    assert outrider("certify", "ekf", "--speed", "1:2")[0] == 2


# ---------------------------------------------------------------- from design to tracks


def test_designed_gains_are_certified_and_used(outrider: Any, tmp_path: Path) -> None:
    file = tmp_path / "gains.json"
    region = ("--speed", "1:15", "--rear-axle", 1.4, "--slip", "20deg")
    code, out, _ = outrider("design", "multi_stage", *region, "-o", file)
    assert code == 0
    assert "Clarabel said" in out
    assert "l_r = 1.4" in out
    assert outrider("certify", file)[0] == 0
    scenario = tmp_path / "head_on.toml"
    scenario.write_text(
        'title = "A car comes straight at a standing rider"\nduration_s = 1.0\n'
        'vehicles = [{ name = "car", x_m = 20.0, y_m = 0.0, yaw_deg = 180.0, speed_mps = 8.0 }]\n'
    )
    assert outrider("simulate", scenario, "-o", tmp_path / "rec.mcap")[0] == 0
    track = ("track", tmp_path / "rec.mcap", "--no-pictures", "--gains", file)
    assert outrider(*track, "-o", tmp_path / "run")[0] == 0
    used = open_run(tmp_path / "run").settings.observer
    made = json.loads(file.read_text())["gains"]
    assert used.name == "multi_stage"
    assert used.gains["multi_stage"] == made
    code, _, err = outrider(*track, "-o", tmp_path / "other", "--observer", "ekf")
    assert code == 2
    assert "leave one out" in err
    edited = file.read_text().replace('"l_r": 1.4', '"l_r": 1.5')
    file.write_text(edited)
    assert outrider(*track, "-o", tmp_path / "third")[0] == 3
    assert outrider("certify", file)[0] == 3


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ("high_gain", "--speed", "5:20", "--accel", "2", "--yaw-rate", "0.3", "--rate", "0.2"),
            "high_gain: proven",
        ),
        (("constant_velocity", "--speed", "8:12", "--window", "36deg"), "constant_velocity: proven"),
        (("speed", "--rate", "1", "--gain-bound", "60"), "multi_stage: speed: proven"),
        (("table", "--speed", "1:20"), "multi_stage: orientation: proven"),
        (("orientation", "--speed", "8", "--sector", "printed"), "multi_stage: orientation: proven"),
        (("orientation", "--speed", "8", "--sector", "tight"), "multi_stage: orientation: proven"),
        (("position",), "multi_stage: position: proven"),
    ],
    ids=" ".join,
)
def test_every_design_reports_what_it_proved(outrider: Any, arguments: Any, said: str) -> None:
    code, out, _ = outrider("design", *arguments)
    assert code == 0
    assert said in out
    assert "Clarabel said" in out


def test_theta_is_told_beside_the_gain(capsys: pytest.CaptureFixture[str]) -> None:
    """[HG 76-78]; on stderr, so that --json stays readable."""
    arguments = ("design", "high_gain", "--lipschitz", "1.25", "--speed", "5", "--accel", "1", "--json")
    assert cli.run(arguments) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["gains"]["L1"] == pytest.approx(38.6, rel=1e-2)
    assert "theta = 5.81" in err


def test_scripts_can_read_both(outrider: Any, tmp_path: Path) -> None:
    code, out, _ = outrider("design", "high_gain", "--speed", "5", "--yaw-rate", "0.2", "--json")
    made = json.loads(out)
    assert code == 0
    assert made["proven"] is True
    assert made["region"]["speed [m/s]"][0] == 5.0
    assert made["made"]["solver"] == "Clarabel"
    found = json.loads(outrider("certify", "invariant", "--json")[1])
    assert found[0]["observer"] == "invariant"
    assert found[0]["margin"] > found[0]["rounding"]


def test_the_map_is_drawn(outrider: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from outrider.design import region

    monkeypatch.setattr(region, "COUNT", 4)
    picture = tmp_path / "map.png"
    code, out, _ = outrider("certify", "high_gain", "--map", "-o", picture)
    assert code == 0
    assert str(picture) in out
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert outrider("certify", "multi_stage", "--map")[0] == 2


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("design", "high_gain", "--speed", "0:5"), "above 0"),
        (("design", "multi_stage", "--speed", "-1:5"), "crosses 0"),
        (("design", "multi_stage", "--slip", "steep"), "want a number"),
        (("design", "multi_stage", "--speed", "9:2"), "LOW:HIGH"),
        (("design", "multi_stage", "--window", "1"), "says nothing to multi_stage"),
        (("design", "constant_velocity", "--window", "95deg"), "window below pi/2"),
        (("design", "ekf"), "no design"),
        (("design", "speed", "-o", "x.json"), "one stage"),
        (("design", "speed", "--rate", "inf"), "finite"),
        (("certify", "high_gain", "--gain", "1,nan,3"), "finite"),
        (("certify", "high_gain", "--gain", "1,2"), "want 3 to"),
        (("certify", "high_gain", "--speed", "-3:5"), "above 0"),
        (("certify", "multi_stage", "--speed", "0:5"), "crosses 0"),
        (("certify", "multi_stage", "--form", "sampled"), "want continuous"),
        (("certify", "nobody"), "not known"),
        (("certify", "none.json"), "cannot be read"),
        (("certify", "multi_stage", "-o", "x.json"), "-o without"),
    ],
    ids=lambda a: " ".join(a) if isinstance(a, tuple) else a,
)
def test_a_wrong_argument_is_one_line_and_exit_2(outrider: Any, arguments: Any, word: str) -> None:
    code, out, err = outrider(*arguments)
    assert (code, out) == (2, "")
    assert word in err


@pytest.mark.parametrize(
    ("arguments", "relax"),
    [
        (("design", "high_gain", "--speed", "2", "--accel", "3", "--yaw-rate", "1"), "lower the rate"),
        (("design", "speed", "--rate", "3", "--fastest", "8", "--gain-bound", "1"), "bound on the gain"),
        (("design", "high_gain", "--theta", "2"), "theta"),
        (("certify", "high_gain", "--speed", "5", "--accel", "3", "--yaw-rate", "4"), "narrow the region"),
    ],
    ids=lambda a: " ".join(a) if isinstance(a, tuple) else a,
)
def test_what_cannot_be_proven_says_what_to_relax(outrider: Any, arguments: Any, relax: str) -> None:
    code, _, err = outrider(*arguments)
    assert code == 3
    assert relax in err


def test_without_the_solver_proofs_are_still_checked(tmp_path: Path) -> None:
    """In an interpreter that has neither Clarabel nor CVXPY, and has not loaded SciPy or Numba for it."""
    script = (
        "import sys\n"
        "for name in ('clarabel', 'cvxpy'): sys.modules[name] = None\n"
        "from outrider.cli import run\n"
        "code = run(['certify', 'multi_stage'])\n"
        "print({'numba', 'scipy', 'matplotlib'} & set(sys.modules))\n"
        "sys.exit(10 * code + run(['design', 'speed']))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path, env=dict(os.environ)
    )
    assert done.returncode == 2, done.stderr
    assert "proven" in done.stdout
    assert "set()" in done.stdout
    assert "outrider[design]" in done.stderr
