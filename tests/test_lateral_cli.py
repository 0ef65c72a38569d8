"""`outrider lateral` as it is typed: what it prints, what it writes, how it ends."""

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet as pq

from outrider import cars, cli, lateral
from outrider.lateral import log as logs
from outrider.lateral.log import Log
from refusals import refused


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """Folder with two simulated drives of a B-class car, a.parquet and b.csv."""
    folder = tmp_path_factory.mktemp("drives")
    for name, seed in (("a.parquet", 5), ("b.csv", 13)):
        tokens = ["lateral", "simulate", f"winding:{seed}", "--seed", str(seed), "-o", str(folder / name)]
        assert cli.run(tokens) == 0
    return folder


@pytest.fixture
def command(outrider):
    """Call `outrider lateral` in this process: exit code, stdout, stderr."""
    return lambda *tokens: outrider("lateral", *tokens)


def columns(folder):
    return pq.read_table(folder / "estimate.parquet").to_pydict()


# ------------------------------------------------------------------ estimate


def test_an_estimate_leaves_a_folder(command, drives, tmp_path):
    code, out, _ = command(drives / "a.parquet", "--observer", "scheduled", "-o", tmp_path / "run")
    assert code == 0
    assert {p.name for p in (tmp_path / "run").iterdir()} == {
        *("estimate.parquet", "summary.json", "settings.toml", "car.toml", "vy.png")
    }
    table = pq.read_table(tmp_path / "run" / "estimate.parquet")
    assert table.column_names == ["t", "vx", "vy", "slip", "yaw_rate", "bias", "held"]
    assert [str(f.type) for f in table.schema] == ["double"] * 6 + ["bool"]
    assert "rmse" in out
    assert "vy itself has rms" in out
    assert "never" in out  # held


def test_the_estimate_is_that_of_the_library(command, drives, tmp_path):
    assert command(drives / "b.csv", "--observer", "lq", "-o", tmp_path / "run", "--no-pictures")[0] == 0
    car, log = cars.load("b_class"), logs.read(drives / "b.csv")
    track = lateral.estimate(lateral.get("lq"), log.samples(car), car)
    made = columns(tmp_path / "run")
    np.testing.assert_array_equal(
        np.column_stack([made[n] for n in lateral.Estimate._fields]), track.estimate
    )
    np.testing.assert_array_equal(made["held"], track.held)
    np.testing.assert_allclose(np.tan(made["slip"]) * made["vx"], made["vy"], atol=1e-12)
    error = json.loads((tmp_path / "run" / "summary.json").read_text())["error"]
    assert error["rmse_mps"] == pytest.approx(np.sqrt(np.mean((track.estimate[:, 0] - log.vy) ** 2)))
    assert error["rms_vy_mps"] == pytest.approx(np.sqrt(np.mean(log.vy**2)))
    assert cars.load(tmp_path / "run" / "car.toml") == car


def test_the_default_is_better_than_no_estimate(command, drives, tmp_path):
    told = json.loads(command(drives / "a.parquet", "-o", tmp_path / "run", "--no-pictures", "--json")[1])
    assert told["estimator"] == "kalman"
    assert told["error"]["rmse_mps"] < 0.5 * told["error"]["rms_vy_mps"]
    assert told["folder"] == str(tmp_path / "run")


def test_a_run_repeats_from_its_own_files(command, drives, tmp_path):
    first, again = tmp_path / "first", tmp_path / "again"
    log = drives / "a.parquet"
    chosen = ["--car", "D", "--observer", "ultra_local", "--set", "k4=0.7", "--set", "k5=0.8"]
    assert command(log, *chosen, "-o", first, "--no-pictures")[0] == 0
    kept = tomllib.loads((first / "settings.toml").read_text())
    assert (kept["estimator"], kept["gains"]["k4"], kept["car_was"]) == ("ultra_local", 0.7, "D")
    tokens = ["--car", first / "car.toml", "--gains", first / "settings.toml", "-o", again, "--no-pictures"]
    assert command(log, *tokens)[0] == 0
    assert columns(first) == columns(again)
    assert refused(command(log, *tokens, "--force", "--observer", "lq"), "ultra_local", "leave one out")


def test_what_was_not_seen_is_held_and_marked(command, tmp_path):
    """Standstill, a short dropout that is coasted over, a long one, reverse, and no ay at all."""
    t = 0.01 * np.arange(3000)
    vx = np.where(t < 5.0, 10.0, np.where(t < 8.0, 0.3, np.where(t < 20.0, 8.0, -3.0)))
    yaw_rate, steering = np.full(3000, 0.1), np.full(3000, 0.02)
    yaw_rate[1000:1030] = np.nan
    yaw_rate[1500:1600] = np.nan
    logs.write(Log(t, vx, yaw_rate, np.full(3000, np.nan), steering), "drive.parquet")
    code, out, _ = command("drive.parquet", "-o", "run", "--no-pictures")
    assert code == 0
    held = np.array(columns(tmp_path / "run")["held"])
    expected = (np.abs(vx) < 1.0) | np.isnan(yaw_rate)
    np.testing.assert_array_equal(held, expected)
    vy = np.array(columns(tmp_path / "run")["vy"])
    assert np.isfinite(vy).all()
    assert len(set(vy[500:800])) == 1
    slip = np.array(columns(tmp_path / "run")["slip"])
    np.testing.assert_array_equal(np.isnan(slip), np.abs(vx) < 1.0)
    assert "held" in out
    assert "430 of the rows, 4.3 s" in out
    assert "yaw_rate missing in 130 rows, at most 1.00 s on end" in out
    assert "ay missing in 3000 rows" in out


def test_suspected_units_are_told_and_the_estimate_made(command, drives, tmp_path):
    log = logs.read(drives / "a.parquet")
    logs.write(Log(log.t, log.vx, log.yaw_rate, log.ay, log.steering * 180.0 / np.pi), "deg.csv")
    code, out, _ = command("deg.csv", "-o", "run", "--no-pictures")
    assert code == 0
    assert "deg instead of rad" in out
    assert command("deg.csv", "-o", "run2", "--no-pictures", "--column", "steering=steering")[0] == 0
    told = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert any("deg instead of rad" in text for text in told["doubts"])


CAR = "mass_kg = {}\ninertia_kgm2 = 2000.0\nfront_m = 1.0\nrear_m = 1.3\n"
CAR += "front_stiffness_n_per_rad = 1e5\nrear_stiffness_n_per_rad = 1e5\n"


@pytest.mark.parametrize(
    ("tokens", "words"),
    [
        (["absent.csv"], ["absent.csv"]),
        (["t,vx,yaw_rate\n0,1,0\n1,1,0\n"], ["column steering [rad] missing"]),
        (["t,vx,yaw_rate,steering\n1,9,0,0\n0,9,0,0\n"], ["time goes back from 1 to 0 s at row 2"]),
        (["good", "--car", "van"], ["'van'", "b_class"]),
        (["good", "--car", "negative.toml"], ["negative.toml", "mass_kg = -3", "positive"]),
        (["good", "--observer", "kalmann"], ["did you mean kalman"]),
        (["good", "--observer", "lq", "--set", "q=1"], ["gain 'q'", "q_vy"]),
        (["good", "--observer", "lq", "--set", "q_vy"], ["--set 'q_vy'", "name=value"]),
        (["good", "--observer", "lq", "--set", "q_vy=high"], ["--set q_vy", "number"]),
        (["good", "--observer", "ultra_local", "--set", "k3=1"], ["k3 = 1", "k < 1"]),
        (["good", "--column", "wheel=delta"], ["'wheel'", "steering"]),
        (["good", "--gains", "absent.json"], ["absent.json"]),
        (["good", "--gains", "negative.toml"], ["negative.toml", "estimator"]),
    ],
)
def test_what_is_refused(command, drives, tmp_path, tokens, words):
    (tmp_path / "negative.toml").write_text(CAR.format(-3.0))
    (tmp_path / "good.csv").write_text((drives / "b.csv").read_text()[:20000].rpartition("\n")[0])
    log = tokens[0]
    if "\n" in log:
        (tmp_path / "bad.csv").write_text(log)
        log = "bad.csv"
    log = "good.csv" if log == "good" else log
    assert refused(command(log, *tokens[1:], "-o", "run"), *words)
    assert not (tmp_path / "run").exists()


def test_results_are_replaced_only_when_asked(command, drives, tmp_path):
    tokens = [drives / "a.parquet", "--observer", "lq", "-o", tmp_path / "run", "--no-pictures"]
    assert command(*tokens)[0] == 0
    assert refused(command(*tokens), "--force")
    assert command(*tokens, "--force")[0] == 0


# ------------------------------------------------------------------ simulate


def test_the_same_seed_makes_the_same_log(command, drives, tmp_path):
    tokens = ["simulate", "winding:5", "-o"]
    assert command(*tokens, "again.parquet", "--seed", "5")[0] == 0
    assert command(*tokens, "other.parquet", "--seed", "6")[0] == 0
    a, again, other = (
        logs.read(p).fingerprint() for p in (drives / "a.parquet", "again.parquet", "other.parquet")
    )
    assert a == again != other


def test_a_simulated_log_keeps_to_what_is_asked(command):
    code, out, _ = command(
        *("simulate", "winding:3", "--car", "D", "--noise", "none", "--speed", "8:15", "-o", "d.csv")
    )
    assert code == 0
    log = logs.read("d.csv")
    assert f"d.csv: {len(log.t)} rows" in out
    assert 5.0 < log.vx.min() < log.vx.max() < 15.5
    assert np.abs(log.ay).max() < 9.0
    gap = np.diff(log.vy) / np.diff(log.t) - (log.ay - log.vx * log.yaw_rate)[1:]
    assert np.sqrt(np.mean(gap**2)) < 0.1  # ay = vy' + vx r


@pytest.mark.parametrize(
    ("tokens", "word"),
    [
        (["winding:x"], "winding:5"),
        (["absent.csv"], "absent.csv"),
        (["winding:5", "--noise", "pink"], "mems"),
        (["winding:5", "--friction", "-1"], "friction"),
        (["winding:5", "--speed", "20:6"], "LOW:HIGH"),
        (["winding:5", "--car", "van"], "van"),
    ],
)
def test_what_cannot_be_simulated(command, tmp_path, tokens, word):
    assert refused(command("simulate", *tokens, "-o", "log.csv"), word)
    assert not (tmp_path / "log.csv").exists()
    (tmp_path / "log.csv").write_text("mine")
    assert refused(command("simulate", "winding:5", "-o", "log.csv"), "--force")


# ------------------------------------------------------------------ tune


def test_tuned_gains_serve_the_other_drive(command, drives, tmp_path):
    code, out, _ = command("tune", drives / "a.parquet", "--set", "base=0", "-o", "alpha.json")
    assert code == 0
    assert "chosen" in out
    assert (tmp_path / "alpha.png").read_bytes().startswith(b"\x89PNG")
    kept = json.loads((tmp_path / "alpha.json").read_text())
    assert kept["logs"][0]["sha256"] == logs.read(drives / "a.parquet").fingerprint()
    tokens = [drives / "b.csv", "--no-pictures", "--json"]
    tuned = json.loads(command(*tokens, "--gains", "alpha.json", "-o", "tuned")[1])
    off = [token for i in range(1, 8) for token in ("--set", f"k{i}=0")]
    plain = ["--observer", "ultra_local", "--set", "base=0", *off, "-o", "plain"]
    without = json.loads(command(*tokens, *plain)[1])
    assert tuned["estimator"] == "ultra_local"
    assert tuned["error"]["rmse_mps"] < without["error"]["rmse_mps"]
    assert refused(command("tune", drives / "a.parquet", "-o", "alpha.json"), "--force")
    (tmp_path / "alpha.json").unlink()
    assert refused(command("tune", drives / "a.parquet", "-o", "alpha.json"), "alpha.png", "--force")


def test_tuning_wants_vy(command, drives, tmp_path):
    log = logs.read(drives / "a.parquet")
    logs.write(Log(log.t, log.vx, log.yaw_rate, log.ay, log.steering), "blind.csv")
    assert refused(command("tune", "blind.csv", "-o", "alpha.json"), "vy")
    assert not (tmp_path / "alpha.json").exists()


# ------------------------------------------------------------------ identify


@pytest.mark.parametrize("options", [[], ["--no-vy"]])
def test_an_identified_car_serves_the_other_drive(command, drives, tmp_path, options):
    """The logs have the angle of the hand wheel, and the stiffness of the axles is guessed wrong."""
    for name in ("a.parquet", "b.csv"):
        log = logs.read(drives / name)
        logs.write(replace(log, steering=16.0 * log.steering), f"hand_{name}")
    begun = cars.load("b_class")
    guess = begun._replace(front_stiffness=1.5e5, rear_stiffness=8e4, steering_gain=0.05)
    cars.save(guess, "guess.toml")
    code, out, _ = command("identify", "hand_a.parquet", "--car", "guess.toml", *options, "-o", "car.toml")
    assert code == 0
    assert re.search(r"^mass_kg +1223 +kept +1223$", out, flags=re.M)
    found = cars.load("car.toml")
    assert found.steering_gain == pytest.approx(1 / 16, rel=0.05)
    assert found.front_stiffness == pytest.approx(begun.front_stiffness, rel=0.15)
    assert found.rear_stiffness == pytest.approx(begun.rear_stiffness, rel=0.15)
    error = {}
    for car in ("guess.toml", "car.toml"):
        tokens = ["hand_b.csv", "--car", car, "--observer", "tyre", "-o", car[:-5], "--no-pictures"]
        error[car] = json.loads(command(*tokens, "--json")[1])["error"]["rmse_mps"]
    assert error["car.toml"] < 0.5 * error["guess.toml"]
    assert refused(command("identify", "hand_a.parquet", "-o", "car.toml"), "--force")


def test_too_little_driving_identifies_nothing(command, drives, tmp_path):
    tokens = ["identify", drives / "a.parquet", "-o", "car.toml", "--span"]
    assert refused(command(*tokens, "10:20"), "s of driving")
    assert refused(command(*tokens, "1e4:2e4"), "want at least 2")
    assert refused(command(*tokens, "late"), "--span")
    assert not (tmp_path / "car.toml").exists()


def test_a_part_of_a_log(command, drives, tmp_path):
    tokens = ["--observer", "lq", "--span", "100:150", "-o", tmp_path / "run", "--no-pictures"]
    assert command(drives / "a.parquet", *tokens)[0] == 0
    t = columns(tmp_path / "run")["t"]
    assert (t[0], t[-1], len(t)) == (100.0, pytest.approx(149.99), 5000)


RACE_CAR = """
mass_kg = 982.0
inertia_kgm2 = 1605.0
front_m = 1.33
rear_m = 1.07
front_stiffness_n_per_rad = 70000.0
rear_stiffness_n_per_rad = 120000.0
"""


@pytest.mark.parametrize(("options", "column", "most"), [([], 1, 0.20), (["--no-vy"], 2, 0.26)])
def test_a_real_car_is_identified_on_one_half_and_estimated_on_the_other(
    command, data, tmp_path, options, column, most
):
    """The figures are those of docs/lateral.md."""
    page = (Path(__file__).parents[1] / "docs" / "lateral.md").read_text()
    (tmp_path / "start.toml").write_text(RACE_CAR)
    log = data / "revs_250lm" / "20140222_01_01_03_250lm_dev.parquet"
    tokens = ["identify", log, "--car", "start.toml", *options, "--span", "149:332.49", "-o", "car.toml"]
    assert command(*tokens)[0] == 0
    for name in ("tyre", "friction_bank", "kalman", "scheduled"):
        tokens = [log, "--car", "car.toml", "--observer", name, "--span", "332.49:600", "-o", name]
        error = json.loads(command(*tokens, "--no-pictures", "--json")[1])["error"]
        (row,) = re.findall(rf"^\| `{name}` \| (0\.\d\d) \| (0\.\d\d) \|$", page, flags=re.M)
        assert error["rmse_mps"] == pytest.approx(float(row[column - 1]), abs=0.015)
        assert error["rms_vy_mps"] == pytest.approx(0.74, abs=0.005)
        if name == "tyre":
            assert error["rmse_mps"] <= most


# ------------------------------------------------------------------ proofs


def test_an_estimators_proofs_are_checked(capsys):
    assert cli.run(["certify", "scheduled"]) == 0
    out = capsys.readouterr().out
    assert all(f"scheduled.{car}\nscheduled: proven" in out for car in cars.names())
    assert cli.run(["certify", "lq"]) == 3
    assert "nothing is claimed" in capsys.readouterr().err
