"""The examples run as their first lines say, and what they print is right."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from outrider import datasets, io, offline, settings, simulate

pytestmark = pytest.mark.once

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(name, *arguments):
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py"), *map(str, arguments)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def crossing(tmp_path_factory):
    """Folder with a simulated recording of a car that crosses ahead, and its run; and what was printed."""
    folder = tmp_path_factory.mktemp("examples")
    return folder, run("simulate_and_evaluate", "crossing", folder)


def test_every_example_is_tried():
    text = Path(__file__).read_text()
    assert [e.stem for e in sorted(EXAMPLES.glob("*.py")) if f'run("{e.stem}"' not in text] == []


def test_simulate_and_evaluate(crossing):
    _, printed = crossing
    assert float(re.search(r"present (\d+\.\d) %", printed)[1]) > 80.0


def test_print_warnings(tmp_path):
    """The rider of the demo is on a collision course twice; 14 s in, a car touches it."""
    io.write_recording(tmp_path / "demo.mcap", simulate.record(simulate.load("demo")))
    printed = run("print_warnings", tmp_path / "demo.mcap")
    danger = [
        float(t) for t in re.findall(r"^ +(\d+\.\d) s  danger, track \d+ in \d\.\d s$", printed, flags=re.M)
    ]
    assert any(t < 6.4 for t in danger)
    assert any(10.0 < t < 13.9 for t in danger)


def test_live_replay(tmp_path):
    """Played six times as fast as it was recorded."""
    io.write_recording(tmp_path / "demo.mcap", simulate.record(simulate.load("demo")))
    printed = run("live_replay", tmp_path / "demo.mcap", 6)
    assert re.search(r"^danger +\d+\.\d ms after its last beam$", printed, flags=re.M)
    assert re.search(r"^\d+ scans, [1-9] dangers$", printed, flags=re.M)


def test_results_in_pandas(crossing):
    """The car accelerates from 3 to 9 m/s, and is 4 to 5 m long."""
    head, *rows = run("results_in_pandas", crossing[0] / "crossing").splitlines()
    assert head.split() == ["seen_s", "mean_speed", "top_speed", "length", "width"]
    best = max((row.split() for row in rows[1:]), key=lambda row: float(row[1]))
    assert 6.0 < float(best[3]) < 12.0
    assert 3.5 < float(best[4]) < 5.5


def test_compare_observers():
    printed = run("compare_observers", "turning", "multi_stage,constant_velocity")
    rows = [line for line in printed.splitlines() if re.match(r"\| (multi_stage|constant_velocity) ", line)]
    assert len(rows) == 2
    best = re.search(r"^best by J: (\w+), (\d+\.\d+) m/s$", printed, flags=re.M)
    assert float(best[2]) < 1.0
    (winner,) = [row for row in rows if row.startswith(f"| {best[1]} ")]
    assert winner.split(" | ")[6].endswith("*")


def test_guaranteed_bounds():
    printed = run("guaranteed_bounds", "turning", "0.2")
    rows = re.findall(
        r"^ +\d+\.\d +(\d\.\d\d) <= +(\d\.\d\d) +(\d\.\d\d) <= +(\d\.\d\d) ", printed, flags=re.M
    )
    assert len(rows) >= 6
    assert all(float(a) <= float(b) and float(c) <= float(d) for a, b, c, d in rows)
    outside, scans = map(
        int, re.search(r"^outside its bound in (\d+) of (\d+) scans$", printed, flags=re.M).groups()
    )
    assert outside == 0
    assert scans > 60


def test_lateral_velocity():
    """With cheap sensors the model at the right speed beats that of 10 m/s, and integration drifts."""
    head, *rows, last = run("lateral_velocity", "b_class", "5").splitlines()
    assert head.split() == ["estimator", "dry", "slippery"]
    error = {name: (float(dry), float(slippery)) for name, dry, slippery in map(str.split, rows)}
    itself = [float(word) for word in last.split()[2:4]]
    for road in (0, 1):
        assert error["scheduled"][road] < error["lq"][road] < itself[road] < error["integration"][road]
        assert error["kalman"][road] < error["lq"][road]


def test_relocalise():
    """Whatever the motion, the robot is found within seconds, and then known to centimetres."""
    head, *rows = run("relocalise", "asymmetric", "5").splitlines()
    assert head.split() == ["motion", "found", "after", "error", "observability"]
    assert len(rows) == 7
    for row in rows:
        _, found, _, error, _, seen = row.split()
        assert float(found) < 10.0
        assert float(error) < 0.1
        assert 0.02 < float(seen) < 1.0


def test_the_settings_of_the_model_cars_are_those_of_the_data_set():
    given = settings.load(EXAMPLES / "model_car.toml")
    assert given == offline.settle(datasets.entry("datmo/overtakes").settings, None)
