"""Whether a body has moved is told by two scans of the same places, not by how it seems to slide."""

import dataclasses

import numpy as np
import pytest

from made_worlds import driven, prepared, since_start, world
from outrider import simulate
from outrider.change import votes
from outrider.records import TrackState

MARGIN = np.array([0.35, 0.02])
FENCE = "".join(f"[[walls]]\npoints_m = [[{x}.0, -4.0], [{x}.9, -4.0]]\n" for x in range(-10, 60, 3))
HOUSES = "[[walls]]\npoints_m = [[-30.0, -8.0], [80.0, -8.0]]\n"
RIDER = "[rider]\nspeed_mps = 7.0\n"
CAR = """
    [[vehicles]]
    name = "car"
    x_m = -6.0
    y_m = 6.0
    speed_mps = {speed}
    """
BACK = "[[walls]]\npoints_m = [[-40.0, 15.0], [40.0, 15.0]]\n"


def scans_of(text, seconds=2.0):
    return prepared(simulate.record(world(text, seconds)))


def asked(now, box, old, old_box):
    return votes(now, np.array(box), old, np.array(old_box), MARGIN)


def test_a_car_that_crossed_has_left_one_place_and_come_to_another():
    scans = scans_of(CAR.format(speed=6.0) + BACK)
    old, now = scans[2], scans[12]
    way = 6.0 * (now.t - old.t)
    x = -6.0 + 6.0 * (now.t - simulate.EPOCH_NS * 1e-9)
    same, changed, _, unknown = asked(now, [x, 6.0, 0.0, 4.5, 1.8], old, [x - way, 6.0, 0.0, 4.5, 1.8])
    assert changed + 0.5 * unknown > 10.0
    assert same <= 0.3 * changed


def test_a_standing_car_taken_for_a_moving_one_is_still_where_it_was():
    scans = scans_of(CAR.format(speed=0.0) + BACK)
    same, changed, _, unknown = asked(
        scans[12], [-6.0, 6.0, 0.0, 4.5, 1.8], scans[2], [-9.0, 6.0, 0.0, 4.5, 1.8]
    )
    assert same > 5.0
    assert same > 0.3 * (changed + unknown)


@pytest.mark.parametrize("claimed", [0.8, 2.0, 4.0])
def test_a_wall_that_seems_to_slide_was_there_before(claimed):
    """A piece of wall, seen by a moving sensor, said to have come from `claimed` metres back."""
    scans = scans_of(RIDER + HOUSES)
    now, old = scans[12], scans[6]
    x = float(now.ego.W_pose[0])
    same, changed, _, unknown = asked(now, [x, -8.5, 0.0, 4.0, 1.8], old, [x - claimed, -8.5, 0.0, 4.0, 1.8])
    assert same > 2.0
    assert changed == 0.0
    assert unknown == 0.0


def test_a_wall_seen_through_gaps_never_moves():
    """A fence with gaps before a wall, passed at 7 m/s: pieces of wall slide by, and none is confirmed."""
    for seed in (0, 1):
        for step in driven(world(RIDER + FENCE + HOUSES, 6.0), seed):
            assert not (step.tracks.state == TrackState.CONFIRMED).any()


def test_a_car_across_is_seen_to_move_within_a_second():
    seen = driven(world(CAR.format(speed=6.0) + BACK, 3.0))
    confirmed = np.array([(s.tracks.state == TrackState.CONFIRMED).any() for s in seen])
    assert confirmed[since_start(seen) > 1.0].all()


def test_the_votes_do_not_hang_on_which_scan_is_called_earlier():
    scans = scans_of(CAR.format(speed=6.0) + BACK)
    a, b = [-0.3, 6.0, 0.0, 4.5, 1.8], [-4.5, 6.0, 0.0, 4.5, 1.8]
    assert np.array_equal(asked(scans[9], a, scans[2], b), asked(scans[2], b, scans[9], a))


def test_overlap_with_itself_says_nothing():
    """Every return in one rectangle lies in the other too: no vote, however many returns."""
    scans = scans_of(CAR.format(speed=0.0) + BACK)
    box = [-6.0, 6.0, 0.0, 4.5, 1.8]
    assert not asked(scans[12], box, scans[2], box).any()


def test_a_scan_without_beams_has_no_vote():
    scan = scans_of(CAR.format(speed=0.0) + BACK)[5]
    none = dataclasses.replace(
        scan,
        **{
            f: getattr(scan, f)[:0]
            for f in ("angle", "range", "valid", "beam_t", "W_p", "W_sensor", "intensity")
        },
    )
    box, other = [-6.0, 6.0, 0.0, 4.5, 1.8], [-9.0, 6.0, 0.0, 4.5, 1.8]
    assert not asked(none, box, none, other).any()
    asked(scan, box, none, other)  # and beside a full one nothing breaks
