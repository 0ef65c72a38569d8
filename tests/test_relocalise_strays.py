"""Ranges of something else than the wall: where the room's file tells of them, they spoil nothing."""

import numpy as np
import pytest

from outrider.geometry import wrap
from outrider.relocalise import lost, mount
from outrider.relocalise import room as rooms
from outrider.relocalise.anywhere import sowings
from outrider.relocalise.follow import TRACKING
from outrider.relocalise.log import checked
from outrider.relocalise.run import run

pytestmark = pytest.mark.once

DT, ROWS = 0.1, 230
CLEAN = rooms.load("asymmetric")._replace(sigma=0.03)
TOLD = CLEAN._replace(strays=0.4)
START = {"start_position": 0.05, "start_heading": 0.03, "start_doubt": 0.0, "gate": 3.0}


def driven(seed):
    """A robot on a wavy circle; two times in five something stands before a sensor, for a second and more."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(ROWS)
    v, w = 0.5 + 0.1 * np.sin(0.7 * t), 0.5 + 0.1 * np.sin(0.7 * t + 1.0)
    pose = [np.array([-0.5, -1.0, 0.3])]
    for k in range(1, ROWS):
        pose.append(mount.advanced(pose[-1], v[k], w[k], DT))
    truth = np.array(pose)
    assert CLEAN.wall.inside(truth[:, :2], 0.2).all()
    ranges = CLEAN.wall.ray(truth[:, None, :2], truth[:, 2:] + CLEAN.angles).range
    ranges = ranges + CLEAN.sigma * rng.standard_normal(ranges.shape)
    for i in range(2):
        for begin in range(20 + 15 * i, ROWS, 30):  # never both at once for long
            blocked = ranges[begin : begin + 12, i]
            blocked[:] = rng.uniform(0.3, 0.8) + 0.1 * rng.random(len(blocked))
    names = {"x": truth[:, 0], "y": truth[:, 1], "theta": wrap(truth[:, 2])}
    return checked({"t": t, "v": v, "w": w, "range_1": ranges[:, 0], "range_2": ranges[:, 1]} | names)


@pytest.mark.parametrize("seed", range(3))
def test_a_known_pose_is_kept(seed):
    log = driven(seed)
    made = run(log, TOLD, log.truth[0], gains=START)
    assert (made.way.state == TRACKING).all()
    assert made.errors()[:, 0].max() < 0.15


@pytest.mark.parametrize("seed", range(2))
def test_a_pose_is_found_and_not_called_lost(seed):
    made = run(driven(seed), TOLD, None, gains={"gate": 3.0})
    known = made.way.state == TRACKING
    assert made.log.t[np.argmax(known)] < 4.0
    assert known[np.argmax(known) :].all()
    assert made.errors()[known, 0].max() < 0.1


def test_a_search_that_begins_with_something_in_the_way_puts_itself_right():
    """What is found first fits what is in the way; that is noticed, and the right pose is found."""
    made = run(driven(0).part(2.0, 23.0), TOLD, None, gains={"gate": 3.0})
    first = np.argmax(made.way.state == TRACKING)
    assert made.errors()[first, 0] > 1.0
    assert any("lost" in event for _, event in made.events)
    assert made.way.state[-1] == TRACKING
    assert made.errors()[-1, 0] < 0.1


def test_seeds_are_sown_until_one_sample_is_surely_of_the_wall():
    assert sowings(0.0) == sowings(0.001) == 1
    for strays in (0.1, 0.4, 0.7):
        missed = 1.0 - (1.0 - strays) ** 2
        assert missed ** sowings(strays) <= 0.01 < missed ** (sowings(strays) - 1)


def test_patience_grows_with_the_share_of_strays():
    usual = lost.Gains()
    assert lost.among(usual, 0.0) == pytest.approx(usual)
    patient = lost.among(usual, 0.5)
    assert patient == pytest.approx((4.0 * usual.window, 4.0 * usual.least, 1.0 - 0.25 * (1.0 - usual.share)))
    rng = np.random.default_rng(0)
    watch = lost.Lost(patient)
    assert not any(watch.step(DT, 100.0 * (rng.random() < 0.6), 2) for _ in range(2000))
    assert any(watch.step(DT, 100.0, 2) for _ in range(60))
