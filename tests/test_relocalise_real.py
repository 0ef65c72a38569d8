"""A real car in a room with three known walls, and a real robot's odometry: docs/relocalise-real.md."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from outrider.relocalise.follow import TRACKING
from outrider.relocalise.room import Room
from outrider.relocalise.run import run
from outrider.relocalise.wall import circle

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.relocalise_real import recordings, report, study  # noqa: E402

GIVEN = study.KNOWN | {"gate": study.GATE}
ROOM = recordings.room()


@pytest.fixture(scope="module")
def kept():
    return json.loads((ROOT / "benchmarks" / "results" / "relocalise-real.json").read_text())


@pytest.fixture(scope="module")
def turns(data):
    if not (data / "datmo_2dlidar").is_dir():
        pytest.skip("datmo_2dlidar is not among the recordings")
    return {name: recordings.turns(data, name) for name in recordings.CAR_RUNS}


@pytest.fixture(scope="module")
def logs(turns):
    return {name: recordings.car(turned) for name, turned in turns.items()}


def test_the_page_says_what_was_kept(kept, tmp_path):
    page = (ROOT / "docs" / "relocalise-real.md").read_text()
    copy = tmp_path / "page.md"
    copy.write_text(page)
    report.write(kept, copy)
    assert copy.read_text() == page
    assert page.count("<!-- table ") == len(report.BLOCKS)


def test_the_pair_is_on_straight_walls_the_longest_first():
    room = ROOM.wall
    ranges = room.ray(np.array([-1.0, 0.0]), recordings.BEARINGS + 0.3).range
    first, second = recordings.pair(ranges)
    assert room.known(room.ray(np.array([-1.0, 0.0]), recordings.BEARINGS[[first, second]] + 0.3).s).any()
    assert ranges[first] >= ranges[second]
    assert abs(np.angle(np.exp(1j * np.diff(recordings.BEARINGS[[first, second]])[0]))) >= np.deg2rad(59.9)
    bumpy = ranges.copy()
    bumpy[first] -= 1.0
    assert first not in recordings.pair(bumpy)
    assert recordings.pair(np.full(24, np.nan)) is None
    assert recordings.fixed(0, -90) == (12, 6)


def test_the_room_is_one_of_three_known_walls():
    assert ROOM.wall.symmetry == 1
    share = np.diff(ROOM.wall.unknown(), axis=1).sum() / (2 * np.pi)
    assert 0.5 < share < 0.6
    assert ROOM.strays == 0.4


@pytest.mark.parametrize("name", recordings.CAR_RUNS)
def test_from_a_known_start_ranges_are_better_than_odometry(logs, name, kept):
    log = logs[name]
    with_ranges, _ = study.followed(log, ROOM, "pose_ekf", GIVEN)
    without, _ = study.followed(study.blind(log), ROOM, "pose_ekf", GIVEN)
    error = study.errors(with_ranges, log)
    assert error["rms_m"] < 0.8 * study.errors(without, log)["rms_m"]
    assert error["rms_m"] == pytest.approx(kept["cars"][name]["tracking"]["pair"]["rms_m"], rel=0.2)
    assert error["rms_m"] < 0.10
    assert error["largest_m"] < 0.25


@pytest.mark.parametrize("name", recordings.CAR_RUNS)
def test_from_anywhere_the_pose_is_found_once_and_kept(logs, name):
    made = run(logs[name], ROOM, None, gains={"gate": study.GATE})
    known = made.way.state == TRACKING
    error = made.errors()
    assert known[np.argmax(known) :].all()
    assert made.log.t[np.argmax(known)] < 9.0
    assert error[known, 0].max() < 0.35
    assert np.median(error[known, 0]) < 0.10


def test_two_fixed_beams_hardly_see_two_known_walls(turns):
    for turned in turns.values():
        said = study.told(recordings.car(turned, recordings.fixed(60, -60)), ROOM)
        assert said["both_of_the_wall"] < 0.05
    chosen = study.told(recordings.car(turns["overtakes"]), ROOM)
    assert chosen["both_of_the_wall"] > 0.2
    assert chosen["too_long"] < 0.02 < chosen["too_short"]


def test_the_published_observer_needs_more_than_this(logs):
    log = logs["parallel"]
    pose, _ = study.followed(log, ROOM, "wall_range", study.PUBLISHED)
    assert study.errors(pose, log)["rms_m"] > 1.0


def test_the_noise_of_a_real_unicycle_is_far_above_the_default(data):
    """Its speeds are commands: uncertain by 30 % over a second, not by 2 %."""
    if not (data / "mrclam_unicycle").is_dir():
        pytest.skip("mrclam_unicycle is not among the recordings")
    log, field = recordings.robot(data), Room(circle(50.0), ROOM.angles)
    part = log.part(log.t[-1] - 300.0, log.t[-1])
    default, fitting = (study.drift(part, field, 10.0, gains) for gains in ({}, study.ROBOT_NOISE))
    assert default["windows"] >= 20
    assert 0.05 < default["median_m"] / default["way_m"] < 0.15
    assert default["normalised"] > 10.0
    assert 0.3 < fitting["normalised"] < 3.0
