"""Segments are a partition of the returns that hangs on the geometry and on nothing else."""

import dataclasses
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from made_scans import look
from made_worlds import prepared, single, world
from outrider import detect, simulate
from outrider.records import Kind
from outrider.segment import segment
from outrider.settings import Detect

DETECT = Detect()
ANYTHING = hnp.arrays(
    np.float32,
    st.integers(0, 60),
    elements=st.one_of(st.floats(0.25, 39.0, width=32), st.sampled_from([np.nan, np.inf, 0.0])),
)
A_ROOM = [(0.0, 5.0), (0.5 * np.pi, 4.0), (np.pi, 6.0), (-0.5 * np.pi, 3.0)]


def parts(scan, settings=DETECT):
    """The segments as sets of beams."""
    found = segment(scan, settings)
    return [frozenset(found.beams[a:b].tolist()) for a, b in zip(found.start, found.stop, strict=True)]


def wall(n=480, walls=((0.5 * np.pi, 2.0),), reach=40.0, **fields):
    """Noise-free scan of straight walls, each given by the angle of its normal and its distance."""
    angle = -np.pi + 2.0 * np.pi / n * np.arange(n)
    ranges = look(np.zeros((n, 3)), angle, walls)
    return single(np.where(ranges < reach, ranges, np.inf), **fields)


@given(ANYTHING, st.booleans())
def test_every_return_is_in_exactly_one_segment(ranges, sequential):
    scan = single(ranges, sequential)
    found = segment(scan, DETECT)
    assert sorted(found.beams) == np.flatnonzero(scan.valid & (scan.range <= DETECT.max_range_m)).tolist()
    assert (found.stop > found.start).all()
    assert np.array_equal(found.start[1:], found.stop[:-1])
    if len(found.beams):
        assert found.start[0] == 0
        assert found.stop[-1] == len(found.beams)


@given(ANYTHING.filter(len), st.integers(0, 59))
def test_where_the_turn_begins_changes_nothing(ranges, shift):
    """All beams at one time: the ring of beams has no beginning."""
    scan = single(ranges, sequential=False)
    n = len(scan.angle)
    order = np.roll(np.arange(n), -(shift % n))
    angle = scan.angle[order] + 2.0 * np.pi * (np.arange(n) >= n - shift % n)
    rows = {f: getattr(scan, f)[order] for f in ("range", "valid", "W_p", "W_sensor", "beam_t")}
    turned = dataclasses.replace(scan, angle=angle, **rows)
    assert {frozenset(order[list(p)].tolist()) for p in parts(turned)} == set(parts(scan))


@pytest.mark.parametrize("n", [0, 1, 2])
def test_as_few_beams_as_there_may_be(n):
    assert sum(len(p) for p in parts(single(np.full(n, 3.0)))) == n
    assert len(parts(single(np.full(n, 3.0)))) == n  # two beams of a circle face opposite ways


@pytest.mark.parametrize("sequential", [True, False])
def test_a_ring_is_one_segment_cut_where_the_turn_begins(sequential):
    found = segment(single(np.full(480, 5.0), sequential), DETECT)
    assert found.start.tolist() == [0]
    assert np.array_equal(found.beams, np.arange(480))


def test_the_ends_of_the_turn_are_never_joined():
    """The wall behind is met by the first beam and by the last, a whole turn apart in time."""
    behind = [(np.pi, 4.0)]
    assert len(parts(wall(walls=behind, reach=8.0))) == 2
    assert len(parts(wall(walls=behind, reach=8.0, sequential=False))) == 1


@pytest.mark.parametrize("missing", [0, 1, 2, 3, 4, 5, 9])
def test_a_gap_of_more_beams_than_the_limit_splits(missing):
    scan = wall(reach=6.0)
    k = 360  # straight at the wall
    ranges = np.where((np.arange(480) >= k) & (np.arange(480) < k + missing), np.inf, scan.range)
    assert len(parts(single(ranges))) == (2 if missing > DETECT.max_gap_beams else 1)


def test_a_wall_is_one_segment_down_to_the_angle_of_the_rule():
    """At a bearing steeper than lambda the rule bridges the step from beam to beam of an even wall."""
    scan = wall()
    bearing = np.arctan2(scan.W_p[:, 1], np.abs(scan.W_p[:, 0]))
    steep = scan.valid & (bearing > DETECT.breakpoint_angle_rad + 0.02)
    whole = max(parts(scan), key=len)
    assert set(np.flatnonzero(steep)) <= whole


@given(st.floats(0.5, 15.0), st.floats(1.6, 8.0))
def test_a_step_in_depth_splits(near, step):
    ranges = np.full(480, near)
    ranges[200:280] = near + step
    found = parts(single(ranges))
    assert frozenset(range(200, 280)) in found
    assert len(found) == 3  # and the rest, in two pieces: the turn begins in it


def test_neighbours_within_the_noise_are_never_split():
    noise = np.random.default_rng(0).normal(0.0, DETECT.range_noise_m, 480)
    assert len(parts(single(2.0 + noise))) == 1


def test_returns_beyond_the_limit_are_left_out():
    near = Detect(max_range_m=4.5)
    scan = wall(walls=A_ROOM)
    assert set().union(*parts(scan, near)) == set(np.flatnonzero(scan.range <= 4.5))


def test_a_hundred_thousand_beams_are_quick():
    noise = np.random.default_rng(0).normal(0.0, 0.02, 100_000)
    scan = single(np.clip(wall(100_000, A_ROOM).range + noise, 0.2, 39.0))
    begin = time.perf_counter()
    found = segment(scan, DETECT)
    assert time.perf_counter() - begin < 1.0
    assert len(found.beams) == 100_000


# ------------------------------------------------------------------ what segments look like


def test_a_car_a_pole_and_a_house_are_told_apart_by_size():
    street = world(
        """
        [[parked]]
        name = "car"
        x_m = 6.0
        y_m = 5.0
        [[poles]]
        x_m = 5.0
        y_m = -3.0
        [[walls]]
        points_m = [[-12.0, 9.0], [-12.0, -9.0]]
        """,
        1.0,
    )
    for scan in prepared(simulate.record(street)):
        _, found = detect.detect(scan, DETECT)

        def at(x, y, found=found):
            return int(np.hypot(*(found.W_p - [x, y]).T).argmin())

        assert found.kind[at(6.0, 5.0)] == Kind.VEHICLE
        assert found.kind[at(5.0, -3.0)] == Kind.SMALL
        house = np.flatnonzero(found.W_p[:, 0] < -10.0)
        assert Kind.LARGE in found.kind[house]
        assert (found.extent[:, 0] >= found.extent[:, 1]).all()
        assert (np.linalg.eigvalsh(found.cov) > 0.0).all()
