"""Found without a guess: every pose that two ranges allow, and what remains of them as the robot drives."""

import numpy as np
import pytest

from outrider.errors import InputError
from outrider.relocalise import Sample, anywhere, lost, motions, room, simulate
from outrider.relocalise.anywhere import Search, apart
from outrider.relocalise.observers import pose_ekf
from outrider.relocalise.outline import Polygon
from outrider.relocalise.seeds import matches, seeds
from outrider.relocalise.simulate import Faults

pytestmark = pytest.mark.once

NONE = np.full(2, np.nan)
PAIRS = [(60.0, -60.0), (90.0, -90.0), (20.0, -30.0), (0.0, 90.0)]
WALLS = ["ellipse", "asymmetric", "rectangle"]


def samples(where, drives, robot):
    """What one robot's sensors say, row by row."""
    steps = np.diff(drives.t, prepend=drives.t[0])
    for dt, (v, w), ranges in zip(steps, drives.odometry[:, robot], drives.ranges[:, robot], strict=True):
        yield Sample(float(dt), v, np.float64(0.0), w, ranges, NONE, NONE, where.angles)


def error(where, pose, truth):
    """Metres plus radians to the truth or a pose that looks the same."""
    same = [where.wall.turned(truth, k) for k in range(where.wall.symmetry)]
    return float(apart(np.array(same), pose).min())


def searched(where, drives, robot):
    """Every answer of a search along a drive."""
    search = Search(where)
    return [search.step(sample) for sample in samples(where, drives, robot)]


@pytest.mark.parametrize("name", WALLS)
@pytest.mark.parametrize("angles", PAIRS)
def test_matches_see_what_was_measured(name, angles):
    wall, angles = room.load(name).wall, np.deg2rad(angles)
    headings = np.linspace(-np.pi, np.pi, 48, endpoint=False) + 0.01
    for truth in simulate.anywhere(room.load(name), 4, np.random.default_rng(1)):
        ranges = wall.ray(truth[:2], truth[2] + angles).range
        found = matches(wall, ranges, angles, headings)
        assert found.shape == (48, 2, 3)
        found = found[np.isfinite(found[..., 0])]
        again = wall.ray(found[:, None, :2], found[:, 2:] + angles).range
        assert np.abs(again - ranges).max(initial=0.0) < 1e-9


@pytest.mark.parametrize("name", ["ellipse", "asymmetric"])
@pytest.mark.parametrize("angles", PAIRS)
def test_the_true_pose_is_a_match_at_its_heading(name, angles):
    where, angles = room.load(name), np.deg2rad(angles)
    for truth in simulate.anywhere(where, 12, np.random.default_rng(2)):
        ranges = where.wall.ray(truth[:2], truth[2] + angles).range
        found = matches(where.wall, ranges, angles, truth[2:])[0]
        assert np.nanmin(np.abs(found[:, :2] - truth[:2]).max(axis=1)) < 1e-7


@pytest.mark.parametrize("name", ["ellipse", "asymmetric"])
def test_there_are_no_other_matches(name):
    """Counted by brute force: of the robots that see the first range, those that see the second."""
    where = room.load(name)
    wall, angles = where.wall, where.angles
    rim = wall.at(2.0 * np.pi * np.arange(20000) / 20000).r
    (truth,) = simulate.anywhere(where, 1, np.random.default_rng(3))
    ranges = wall.ray(truth[:2], truth[2] + angles).range
    counts = []
    for heading in np.linspace(-3.0, 3.0, 12):
        first = ranges[0] * np.array([np.cos(heading + angles[0]), np.sin(heading + angles[0])])
        x = rim - first
        off = wall.ray(x, np.full(len(x), heading + angles[1])).range - ranges[1]
        crossings = np.isfinite(off * np.roll(off, 1)) & (
            np.nan_to_num(off) * np.nan_to_num(np.roll(off, 1)) < 0.0
        )
        found = matches(wall, ranges, angles, np.array([heading]))[0, :, 0]
        counts.append(np.isfinite(found).sum())
        assert counts[-1] == crossings.sum()
    assert max(counts) == 2


@pytest.mark.parametrize("name", WALLS)
@pytest.mark.parametrize("angles", PAIRS)
def test_a_seed_is_near_the_truth_despite_noise(name, angles):
    where = room.load(name)._replace(angles=np.deg2rad(angles))
    rng = np.random.default_rng(4)
    for truth in simulate.anywhere(where, 8, rng):
        ranges = where.wall.ray(truth[:2], truth[2] + where.angles).range + 0.01 * rng.standard_normal(2)
        found = seeds(where, ranges, where.angles)
        assert apart(found, truth).min() < 0.35
        assert len(found) < 400


def test_seeds_where_noise_leaves_no_chord_long_enough():
    """Both rays along the longest axis: a little too long, the nearest pose; far too long, none."""
    where = room.load("ellipse")._replace(angles=np.array([0.0, np.pi]))
    near = seeds(where, np.array([4.005, 4.005]), where.angles)
    assert apart(near, np.zeros(3)).min() < 0.15
    assert seeds(where, np.array([4.1, 4.1]), where.angles).shape == (0, 3)


def test_no_ray_of_a_seed_ends_on_an_unknown_wall():
    corners = ((-4.0, -2.5), (4.0, -2.5), (4.0, 2.5), (-4.0, 2.5))
    wall = Polygon(corners_m=corners, corner_radius_m=0.3, unknown_sides=(1,))
    where = room.load("rectangle")._replace(wall=wall)
    truth = np.array([-1.0, 0.3, 2.0])
    ranges = wall.ray(truth[:2], truth[2] + where.angles).range
    found = seeds(where, ranges, where.angles)
    assert apart(found, truth).min() < 0.2
    assert wall.known(wall.ray(found[:, None, :2], found[:, 2:] + where.angles).s).all()
    assert len(found) < len(seeds(room.load("rectangle"), ranges, where.angles))


@pytest.mark.parametrize("sigma", [0.01, 0.05])
@pytest.mark.parametrize(("name", "runs"), [("ellipse", 16), ("asymmetric", 12)])
def test_found_from_anywhere(name, runs, sigma):
    """At least 15 of 16 and every one ambiguous in the ellipse, 12 of 12 and none in the asymmetric room."""
    where = room.load(name)._replace(sigma=sigma)
    drives = simulate.drives(where, motions.constant, runs, seconds=6.0, seed=5)
    good = 0
    for robot in range(runs):
        last = searched(where, drives, robot)[-1]
        good += error(where, last.pose[0], drives.truth[-1, robot]) < 0.25
        twins = where.wall.symmetry - 1
        assert last.ambiguous == (twins > 0)
        assert last.twin.sum() == twins == len(last.pose) - 1
    assert good >= (15 if name == "ellipse" else 12)


def test_twins_stay_as_likely_as_the_truth():
    where = room.load("ellipse")
    drives = simulate.drives(where, motions.spin, 1, seconds=15.0, seed=6)
    last = searched(where, drives, 0)[-1]
    assert last.log_weight == pytest.approx([0.0, 0.0], abs=0.1)
    assert apart(where.wall.turned(last.pose[0], 1), last.pose[1]) < 1e-3


def test_turning_and_moving_the_room_changes_nothing():
    where = room.load("asymmetric")
    turn, centre = 30.0, (3.0, -7.0)
    there = where._replace(wall=type(where.wall)(**{
        **{name: getattr(where.wall, name) for name in where.wall.__struct_fields__},
        "turn_deg": turn, "centre_m": centre,
    }))  # fmt: skip
    drives = simulate.drives(where, motions.constant, 1, seconds=6.0, seed=7)
    here = searched(where, drives, 0)[-1].pose[0]
    c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    moved = np.array([centre[0] + c * here[0] - s * here[1], centre[1] + s * here[0] + c * here[1], here[2]])
    moved[2] += np.deg2rad(turn)
    assert apart(searched(there, drives, 0)[-1].pose[0], moved) < 5e-3


def test_it_waits_until_both_ranges_are_there():
    where = room.load("ellipse")
    search = Search(where)
    for ranges in ([np.nan, np.nan], [1.0, np.nan], [np.nan, 2.0], [0.0, 0.0]):
        found = search.step(Sample(0.1, 0.0, 0.0, 0.0, np.array(ranges), NONE, NONE, where.angles))
        assert len(found.pose) == 0
        assert found.ambiguous
    ranges = where.wall.ray(np.array([1.0, 0.5]), 0.3 + where.angles).range
    found = search.step(Sample(0.1, 0.0, 0.0, 0.0, ranges, NONE, NONE, where.angles))
    assert len(found.pose) > 20
    assert found.ambiguous


def test_standing_still_leaves_it_ambiguous():
    where = room.load("asymmetric")
    drives = simulate.drives(where, lambda t, pose, room, limits: np.zeros(2), 1, seconds=5.0, seed=8)
    assert searched(where, drives, 0)[-1].ambiguous


def test_a_circle_is_refused():
    with pytest.raises(InputError, match="circle"):
        Search(room.load("circle"))


@pytest.mark.parametrize("name", ["ellipse", "asymmetric"])
def test_found_although_ranges_are_short_or_missing(name):
    where = room.load(name)
    drives = simulate.drives(
        where, motions.spin, 2, seconds=15.0, seed=9, faults=Faults(lost=0.1, short=0.25)
    )
    for robot in range(2):
        last = searched(where, drives, robot)[-1]
        assert error(where, last.pose[0], drives.truth[-1, robot]) < 0.1


def test_found_again_after_it_was_carried():
    where = room.load("asymmetric")
    drives = simulate.drives(where, motions.spin, 2, seconds=9.0, seed=10, faults=Faults(kidnapped=(6.0,)))
    for robot in range(2):
        found = searched(where, drives, robot)
        told = [t for t, answer in zip(drives.t, found, strict=True) if answer.moved]
        assert len(told) >= 1
        assert 6.0 < told[0] < 8.0
        assert error(where, found[-1].pose[0], drives.truth[-1, robot]) < 0.1
        assert not found[-1].ambiguous


def test_what_remains():
    gains = anywhere.Gains()
    pose = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.05, 0.0, 0.05], [2.0, 0.0, 3.1], [2.0, 0.0, -3.1]])
    kept = anywhere.remaining(pose, np.array([-41.0, -5.0, 0.0, -39.0, -38.0]), gains)
    assert kept.tolist() == [2, 4]


def test_a_right_pose_is_never_called_lost_and_a_carried_robot_soon():
    where = room.load("ellipse")
    drives = simulate.drives(
        where, motions.random, 12, seconds=60.0, seed=11, faults=Faults(kidnapped=(55.0,))
    )
    state = pose_ekf.start(drives.truth[0], where.angles, where, pose_ekf.Gains())
    watches, told = [lost.Lost() for _ in range(12)], np.full(12, np.inf)
    for k in range(1, len(drives.t)):
        v, w = drives.odometry[k].T
        sample = Sample(0.1, v, 0.0 * v, w, drives.ranges[k], NONE, NONE, where.angles)
        state = pose_ekf.step(state, sample, where, pose_ekf.Gains())
        for i, watch in enumerate(watches):
            if watch.step(0.1, float(state.distance[i]), int(state.rays[i])):
                told[i] = min(told[i], drives.t[k])
    assert (told > 55.0).all()
    assert (told < 57.0).all()


def test_lost_by_chance():
    """Ten minutes of innovations as they should be, and with one sample in eight spoilt: no alarm."""
    rng = np.random.default_rng(12)
    distances = rng.chisquare(2, 6000)
    right, spoilt = lost.Lost(), lost.Lost()
    assert not any(right.step(0.1, float(d), 2) for d in distances)
    distances[rng.random(6000) < 0.125] = 1e3
    assert not any(spoilt.step(0.1, float(d), 2) for d in distances)


def test_lost_needs_ranges():
    watch = lost.Lost()
    assert not any(watch.step(0.1, 0.0, 0) for _ in range(100))
    assert [watch.step(0.1, 50.0, 1) for _ in range(8)] == [False] * 7 + [True]
    assert not watch.step(0.1, np.nan, 0)
    watch.reset()
    assert not watch.step(0.1, 50.0, 1)
