"""`outrider relocalise` as it is typed: what it prints, what it writes, how it ends."""

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet as pq

from outrider import cli, relocalise
from outrider.relocalise import log as logs
from outrider.relocalise import motions, run
from outrider.relocalise import room as rooms
from refusals import refused

START = "0.6,-0.4,60deg"


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """Folder with a robot that spins in the ellipse, e.parquet, and one that drives in the egg, a.csv."""
    folder = tmp_path_factory.mktemp("drives")
    for name, wall, motion in (("e.parquet", "ellipse", "exciting"), ("a.csv", "asymmetric", "constant")):
        tokens = ["simulate", "--wall", wall, "--motion", motion, "--seconds", "10", "--start", START]
        assert cli.run(["relocalise", *tokens, "-o", str(folder / name)]) == 0
    return folder


@pytest.fixture
def command(outrider):
    """Call `outrider relocalise` in this process: exit code, stdout, stderr."""
    return lambda *tokens: outrider("relocalise", *tokens)


def columns(folder):
    return pq.read_table(folder / "estimate.parquet").to_pydict()


# ------------------------------------------------------------------ estimate


def test_a_run_leaves_a_folder(command, drives, tmp_path):
    code, out, _ = command(drives / "a.csv", "--wall", "asymmetric", "--anywhere", "-o", tmp_path / "run")
    assert code == 0
    assert {p.name for p in (tmp_path / "run").iterdir()} == {
        *("estimate.parquet", "hypotheses.parquet", "summary.json", "settings.toml", "room.toml"),
        *("room.png", "errors.png"),
    }
    assert "first known" in out
    assert "at the end, tracking" in out
    assert "against the log's pose" in out
    assert "observability" in out


def test_the_estimate_is_that_of_the_library(command, drives, tmp_path):
    tokens = ["--wall", "ellipse", "--start", "0.5,-0.3,60deg", "--observer", "wall_range", "--set", "ks=2"]
    assert command(drives / "e.parquet", *tokens, "-o", tmp_path / "run", "--no-pictures")[0] == 0
    log, room = logs.read(drives / "e.parquet"), rooms.load("ellipse")
    made = run.run(log, room, [0.5, -0.3, np.pi / 3], "wall_range", {"ks": 2.0})
    table = columns(tmp_path / "run")
    np.testing.assert_array_equal(np.column_stack([table[n] for n in ("x", "y", "theta")]), made.way.pose)
    kept = tomllib.loads((tmp_path / "run" / "settings.toml").read_text())
    assert (kept["observer"], kept["wall_was"], kept["gains"]["ks"]) == ("wall_range", "ellipse", 2.0)
    assert not (tmp_path / "run" / "room.png").exists()


def test_without_a_start_it_may_be_anywhere(command, drives, tmp_path):
    tokens = [drives / "e.parquet", "--wall", "ellipse", "--no-pictures", "--json", "-o"]
    free = json.loads(command(*tokens, tmp_path / "free")[1])
    told = json.loads(command(*tokens, tmp_path / "told", "--start", START)[1])
    assert free["at_the_end"]["state"] == "ambiguous"
    assert len(free["at_the_end"]["poses"]) == free["symmetry"] == 2
    assert told["at_the_end"]["state"] == "tracking"
    assert told["error"]["rmse_m"] < 0.05
    assert told["folder"] == str(tmp_path / "told")
    assert "the wall looks the same from 2 poses" in command(*tokens[:4], "-o", tmp_path / "words")[1]


def test_a_room_of_ones_own_units_and_a_span(command, drives, tmp_path):
    log = logs.read(drives / "e.parquet")
    (tmp_path / "mine.toml").write_text(
        '[wall]\nshape = "ellipse"\nhalf_axes_m = [4.0, 2.5]\n[sensors]\nangles_deg = [10.0, -10.0]\n'
    )
    rows = np.column_stack([log.t, log.v, log.w * 180 / np.pi, log.ranges * 1e3])
    text = "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    (tmp_path / "mine.csv").write_text("t,v,w [deg/s],left,range_2_mm\n" + text + "\n")
    tokens = ["--wall", "mine.toml", "--sensors", "60deg,-60deg", "--column", "range_1=left"]
    assert refused(command("mine.csv", *tokens[:4], "-o", "run"), "column range_1 [m] missing")
    code, out, _ = command("mine.csv", *tokens, "-o", "run", "--span", "2:6", "--no-pictures")
    assert code == 0
    assert "range_1 is mostly over twice the room's 8 m" in out
    (tmp_path / "mine.csv").write_text("t,v,w [deg/s],left [mm],range_2_mm\n" + text + "\n")
    tokens[-1] = "range_1=left [mm]"
    assert command("mine.csv", *tokens, "-o", "run2", "--span", "2:6", "--no-pictures")[0] == 0
    table = columns(tmp_path / "run2")
    assert (table["t"][0], len(table["t"])) == (2.0, 40)
    end = [k for k, t in enumerate(log.t) if t < 6.0][-1]
    truth, sign = log.truth[end, :2], np.sign(log.truth[end, 0] * table["x"][-1])
    np.testing.assert_allclose(sign * np.array([table["x"][-1], table["y"][-1]]), truth, atol=0.03)


def test_a_kidnapping_is_told(command, tmp_path):
    asked = ["--wall", "asymmetric", "--seconds", "14", "--kidnap", "6", "--seed", "2"]
    assert command("simulate", *asked, "-o", "k.parquet")[0] == 0
    code, out, _ = command("k.parquet", "--wall", "asymmetric", "-o", "run")
    assert code == 0
    assert "the ranges contradict the pose: lost, looked for anew" in out
    assert "at the end, tracking" in out
    assert "lost" in columns(tmp_path / "run")["state"]


def test_a_bad_range_is_masked_and_counted(command, drives, tmp_path):
    lines = (drives / "a.csv").read_text().splitlines()
    for k in (5, 6, 30):
        cells = lines[k].split(",")
        cells[3] = "-0.5"
        lines[k] = ",".join(cells)
    (tmp_path / "bad.csv").write_text("\n".join(lines) + "\n")
    code, out, _ = command("bad.csv", "--wall", "asymmetric", "-o", "run", "--no-pictures")
    assert code == 0
    assert "range_1 not positive in 3 rows: taken as no return" in out
    assert "at the end, tracking" in out


WALLS = {
    "open.toml": 'shape = "polygon"\ncorners_m = [[0, 0], [4, 0]]',
    "dented.toml": 'shape = "points"\npoints_m = [[2, 0], [0, 2], [-2, 0], [0, 1]]',
    "crossed.toml": 'shape = "polygon"\ncorners_m = [[0, 0], [4, 4], [4, 0], [0, 4]]',
    "typo.toml": 'shape = "elipse"\nhalf_axes_m = [4, 2]',
    "key.toml": 'shape = "ellipse"\nhalf_axis_m = [4, 2]',
}


@pytest.mark.parametrize(
    ("tokens", "words"),
    [
        (["absent.csv", "--wall", "ellipse"], ["absent.csv"]),
        (["good"], ["--wall"]),
        (["good", "--wall", "elipse"], ["ellipse"]),
        (["good", "--wall", "absent.toml"], ["absent.toml"]),
        *((["good", "--wall", name], [name]) for name in WALLS),
        (["good", "--wall", "circle"], ["circle"]),
        (["good", "--wall", "ellipse", "--sensors", "30deg,30deg"], ["same way", "different angles"]),
        (["good", "--wall", "ellipse", "--sensors", "30deg"], ["--sensors", "two numbers"]),
        (["good", "--wall", "ellipse", "--start", "5,0,0"], ["not inside the wall"]),
        (["good", "--wall", "ellipse", "--start", "1,0"], ["--start", "X,Y,THETA"]),
        (["good", "--wall", "ellipse", "--start", "-1,north,0"], ["--start", "number"]),
        (["good", "--wall", "ellipse", "--start", START, "--anywhere"], ["--anywhere", "one of them"]),
        (["good", "--wall", "ellipse", "--observer", "pose_efk"], ["did you mean pose_ekf"]),
        (["good", "--wall", "ellipse", "--set", "gait=3"], ["'gait'", "gate"]),
        (["good", "--wall", "ellipse", "--set", "gate"], ["--set 'gate'", "name=value"]),
        (["good", "--wall", "ellipse", "--column", "rng=left"], ["'rng'", "range_1"]),
        (["t,v,w,range_1\n0,0,0,1\n1,0,0,1\n", "--wall", "ellipse"], ["column range_2 [m] missing"]),
        (
            ["t,v,w,range_1,range_2\n1,0,0,1,1\n0,0,0,1,1\n", "--wall", "ellipse"],
            ["time goes back from 1 to 0 s at row 2"],
        ),
    ],
)
def test_what_is_refused(command, drives, tmp_path, tokens, words):
    for name, wall in WALLS.items():
        (tmp_path / name).write_text(f"[wall]\n{wall}\n")
    log = drives / "e.parquet" if tokens[0] == "good" else tokens[0]
    if "\n" in str(log):
        (tmp_path / "bad.csv").write_text(log)
        log = "bad.csv"
    assert refused(command(log, *tokens[1:], "-o", "run"), *words)
    assert not (tmp_path / "run").exists()


def test_results_are_replaced_only_when_asked(command, drives, tmp_path):
    tokens = [drives / "e.parquet", "--wall", "ellipse", "-o", tmp_path / "run", "--no-pictures"]
    assert command(*tokens)[0] == 0
    assert refused(command(*tokens), "--force")
    assert command(*tokens, "--force")[0] == 0


# ------------------------------------------------------------------ simulate


def test_a_simulated_log_keeps_to_what_is_asked(command, tmp_path):
    asked = [
        "--wall",
        "rectangle",
        "--motion",
        "random",
        "--seconds",
        "8",
        "--rate",
        "20",
        "--limits",
        "0.3,1",
    ]
    code, out, _ = command(
        "simulate", *asked, "--noise", "0.05", "--short", "0.1", "--lost", "0.2", "-o", "r.csv"
    )
    assert code == 0
    assert "r.csv: 161 rows, 8.0 s in rectangle" in out
    log = logs.read("r.csv")
    assert np.abs(log.v).max() < 0.33
    assert 0.5 < np.abs(log.w).max() < 1.1
    assert np.isnan(log.ranges).mean() == pytest.approx(0.2, abs=0.07)
    truth = motions.seen(log.truth, rooms.load("rectangle"))
    off = (log.ranges - truth)[np.isfinite(log.ranges)]
    assert np.mean(off < -0.2) == pytest.approx(0.1, abs=0.06)
    assert np.std(off[np.abs(off) < 0.2]) == pytest.approx(0.05, rel=0.2)


def test_the_same_seed_makes_the_same_log(command):
    for name, seed in (("a.csv", 3), ("b.csv", 3), ("c.csv", 4)):
        tokens = ["simulate", "--wall", "ellipse", "--seconds", "2", "--seed", str(seed), "-o", name]
        assert command(*tokens)[0] == 0
    a, b, c = (logs.read(name).fingerprint() for name in ("a.csv", "b.csv", "c.csv"))
    assert a == b != c


@pytest.mark.parametrize(
    ("tokens", "word"),
    [
        (["--motion", "spinn"], "did you mean spin"),
        (["--wall", "elipse"], "ellipse"),
        (["--start", "9,9,0"], "outside the wall"),
        (["--seconds", "-1"], "seconds"),
        (["--noise", "-0.1"], "noise"),
        (["--limits", "1"], "--limits"),
        (["--kidnap", "soon"], "--kidnap"),
        (["--lost", "2"], "lost"),
    ],
)
def test_what_cannot_be_simulated(command, tmp_path, tokens, word):
    assert refused(command("simulate", *tokens, "-o", "log.csv"), word)
    assert not (tmp_path / "log.csv").exists()
    (tmp_path / "log.csv").write_text("mine")
    assert refused(command("simulate", "-o", "log.csv"), "--force")


# ------------------------------------------------------------------ check


def test_a_good_room_is_said_to_be_good(command, tmp_path):
    code, out, _ = command("check", "--wall", "ellipse", "--sensors", "60deg,-60deg", "-o", "map.png")
    assert code == 0
    assert out.startswith("The pose can be found")
    assert "The wall looks the same from 2 poses" in out
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    assert refused(command("check", "--wall", "ellipse", "-o", "map.png"), "--force")


@pytest.mark.parametrize(
    ("tokens", "words"),
    [
        (["--wall", "circle"], ["cannot be found", "the wall is a circle"]),
        (["--wall", "ellipse", "--motion", "0,0"], ["cannot be found", "stands still"]),
        (["--wall", "rectangle"], ["parallel straight walls"]),
        (["--wall", "short.toml"], ["Out of the sensors' reach from"]),
        (["--wall", "asymmetric", "--sensors=-20deg,25deg"], ["45 deg apart"]),
    ],
)
def test_what_is_wrong_with_a_room_is_told(command, tmp_path, tokens, words):
    (tmp_path / "short.toml").write_text(
        '[wall]\nshape = "ellipse"\nhalf_axes_m = [4.0, 2.5]\n[sensors]\nrange_m = [0.1, 3.0]\n'
    )
    code, out, _ = command("check", *tokens)
    assert code == 0
    for word in words:
        assert word in out


def test_the_table_of_motions_is_that_of_the_library(command):
    told = json.loads(command("check", "--wall", "asymmetric", "--motion", "0.5,0.5", "--json")[1])
    assert told["seen"]["word"] == "good"
    assert told["seen"]["poses"] == 1
    assert told["motions"]["asked for"] == told["motions"]["on a circle"]
    assert told["motions"]["standing still"][0] == 0.0
    assert told["motions"]["asked for"][0] == pytest.approx(told["seen"]["median"])


def test_what_cannot_be_checked(command):
    assert refused(command("check", "--wall", "ellipse", "--sensors", "40deg,40deg"), "same way")
    assert refused(command("check", "--wall", "ellipse", "--motion", "fast"), "--motion")
    assert refused(command("check"), "--wall")


# ------------------------------------------------------------------ by name


def test_rooms_and_observers_are_listed(outrider):
    told = json.loads(outrider("ls", "rooms", "--json")[1])["rooms"]
    assert [row["name"] for row in told] == rooms.names()
    told = json.loads(outrider("ls", "relocalisers", "--json")[1])["relocalisers"]
    assert [row["name"] for row in told] == relocalise.names()
    assert all(row["reference"] for row in told)


def test_the_page_shows_what_is_printed(command):
    page = (Path(__file__).parents[1] / "docs" / "relocalise.md").read_text()
    (shown,) = re.findall(r"\$ outrider relocalise (check .*?)\n(.*?)\n\.\.\.\n", page, flags=re.S)
    tokens, lines = shown
    out = command(*tokens.split())[1]
    assert [line for line in lines.splitlines() if line not in out.splitlines()] == []
