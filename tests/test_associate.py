"""Which returns belong to which track: the cheapest assignment, the whole body, and not its neighbour."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from made_worlds import BACKDROP, driven, prepared, world
from outrider import associate, detect, simulate
from outrider.associate import Fits, assign, inside, near_pairs, owners
from outrider.geometry import transform
from outrider.records import TrackState
from outrider.segment import Segments
from outrider.settings import Settings

SETTINGS = Settings()
GATE = 4.0


# ------------------------------------------------------------------ the assignment


def random_fits(rng, n_tracks, n_segments, share):
    pairs = np.argwhere(rng.random((n_tracks, n_segments)) < share)
    k = len(pairs)
    x, P, pose = np.zeros((k, 6)), np.tile(np.eye(6), (k, 1, 1)), rng.normal(0.0, 3.0, (k, 3))
    P *= rng.uniform(0.2, 3.0, (k, 1, 1))
    cost, zeros = rng.uniform(0.0, 5.0, k), np.zeros(k, np.int64)
    return Fits(pairs, np.zeros(k), pose, np.tile(0.1 * np.eye(3), (k, 1, 1)), cost, *(zeros,) * 4, x, P)


def worth(fits, row):
    """What a pair costs, from the definition: infinite outside the gate or where the shape is another's."""
    S = fits.P[row][:2, :2] + fits.cov[row][:2, :2]
    e = fits.pose[row, :2] - fits.x[row, :2]
    d2 = float(e @ np.linalg.solve(S, e))
    if d2 >= GATE**2 or fits.cost[row] >= associate.WORST_FIT:
        return np.inf
    return d2 + 2.0 * fits.cost[row] + np.log1p(fits.P[row, 0, 0] + fits.P[row, 1, 1])


@given(st.integers(0, 10_000), st.integers(0, 4), st.integers(0, 4), st.sampled_from([0.3, 0.7, 1.0]))
@settings(max_examples=60)
def test_no_assignment_is_cheaper(seed, n_tracks, n_segments, share):
    """Against all assignments there are: most pairs first, then the least sum."""
    fits = random_fits(np.random.default_rng(seed), n_tracks, n_segments, share)
    price = np.full((n_tracks, n_segments), np.inf)
    for row, (i, j) in enumerate(fits.pairs):
        price[i, j] = worth(fits, row)
    best = (0, 0.0)
    for size in range(1, min(n_tracks, n_segments) + 1):
        for tracks in itertools.combinations(range(n_tracks), size):
            for segments in itertools.permutations(range(n_segments), size):
                total = sum(price[i, j] for i, j in zip(tracks, segments, strict=True))
                if np.isfinite(total):
                    best = min(best, (-size, total))
    chosen = assign(fits, n_tracks, n_segments, GATE)
    found = fits.pairs[chosen]
    assert len(set(found[:, 0])) == len(set(found[:, 1])) == len(found) == -best[0]
    assert sum(price[i, j] for i, j in found) == pytest.approx(best[1])


def test_a_vague_track_does_not_outbid_a_sharp_one():
    """Both could have it; the one that was surer of finding it there gets it."""
    zeros = np.zeros(2, np.int64)
    P = np.stack([4.0 * np.eye(6), 0.04 * np.eye(6)])
    pose = np.tile([0.2, 0.0, 0.0], (2, 1))
    fits = Fits(
        np.array([[0, 0], [1, 0]]),
        np.zeros(2),
        pose,
        np.tile(0.01 * np.eye(3), (2, 1, 1)),
        np.zeros(2),
        *(zeros,) * 4,
        np.zeros((2, 6)),
        P,
    )
    assert fits.pairs[assign(fits, 2, 1, GATE), 0].tolist() == [1]


# ------------------------------------------------------------------ geometry


@given(st.floats(-3.0, 3.0), st.floats(-9.0, 9.0), st.integers(0, 1000))
@settings(max_examples=30)
def test_inside_turns_with_the_world(turn, x, seed):
    p = np.random.default_rng(seed).uniform(-4.0, 4.0, (50, 2))
    size = np.array([4.5, 1.8])
    want = (np.abs(p[:, 0]) < 2.25 + 0.1) & (np.abs(p[:, 1]) < 0.9 + 0.1)
    got = inside(np.array([x, -2.0, turn]), size, transform(np.array([x, -2.0, turn]), p), 0.1)
    edge = np.abs(np.abs(p) - [2.35, 1.0]).min(axis=1) < 1e-9
    assert np.array_equal(got[~edge], want[~edge])


def test_an_owner_holds_all_beams_of_a_segment():
    segments = Segments(np.arange(9), np.array([0, 2, 5]), np.array([2, 5, 9]))
    assert owners(segments, np.array([[0, 5]])).tolist() == [0, 0, -1]
    assert owners(segments, np.array([[5, 9], [2, 5]])).tolist() == [-1, 1, 0]
    assert owners(segments, np.zeros((0, 2), np.int64)).tolist() == [-1, -1, -1]


def test_what_is_too_large_or_too_far_is_not_worth_a_fit():
    room = world("[[parked]]\nname = 'car'\nx_m = 8.0\ny_m = 4.0\n" + BACKDROP, 0.5)
    scan = prepared(simulate.record(room))[0]
    _, found = detect.detect(scan, SETTINGS.detect)
    x, P, size = np.zeros((1, 6)), np.tile(0.05 * np.eye(6), (1, 1, 1)), np.array([[4.5, 1.8]])
    dt = found.hit_t[None] - scan.t
    x[0, :2] = [8.0, 4.0]
    pairs = near_pairs(x, P, size, dt, found, GATE)
    assert len(pairs)
    assert (np.hypot(*(found.W_p[pairs[:, 1]] - [8.0, 4.0]).T) < 6.0).all()
    x[0, :2] = [-30.0, -30.0]
    assert len(near_pairs(x, P, size, dt, found, GATE)) == 0


# ------------------------------------------------------------------ whole bodies


def near(points, place, within):
    """Rows of points (n, 2) that lie within a distance of a place."""
    return np.flatnonzero(np.hypot(*(points - np.asarray(place)).T) < within)


def test_a_body_with_a_post_before_it_is_one():
    """The post hides some beams in the middle of the side: both halves belong to the same track."""
    split = world(
        """
        [[parked]]
        name = "car"
        x_m = 0.0
        y_m = 7.0
        [[poles]]
        x_m = 0.0
        y_m = 3.0
        radius_m = 0.12
        """
        + BACKDROP
    )
    for step in driven(split)[5:]:
        d = step.detections
        (track,) = near(step.tracks.W_p, [0.0, 7.0], 2.5)
        halves = np.flatnonzero(d.track == step.tracks.id[track])
        x = step.scan.W_p[np.concatenate([d.first[halves], d.last[halves]]), 0]
        assert len(halves) >= 2
        assert x.min() < -1.5
        assert x.max() > 1.5


@pytest.mark.parametrize("gap", [0.7, 1.2])
def test_a_post_beside_a_car_is_not_part_of_it(gap):
    beside = world(
        f"""
        [[parked]]
        name = "car"
        x_m = 1.0
        y_m = 6.0
        [[poles]]
        x_m = {1.0 + 2.25 + gap}
        y_m = 5.6
        radius_m = 0.15
        """
        + BACKDROP
    )
    post = np.array([3.25 + gap, 5.6])
    for step in driven(beside)[5:]:
        d = step.detections
        (car,) = near(step.tracks.W_p, [1.0, 6.0], 0.15)
        assert step.tracks.extent[car] == pytest.approx([4.5, 1.8], abs=0.3)
        on_post = near(step.scan.W_p[d.first], post, 0.3)
        assert len(on_post)
        assert (d.track[on_post] != step.tracks.id[car]).all()


# ------------------------------------------------------------------ neighbours


PASSING = """
    [[vehicles]]
    name = "right"
    x_m = -25.0
    y_m = 5.0
    speed_mps = 7.0
    [[vehicles]]
    name = "left"
    x_m = 25.0
    y_m = 8.0
    yaw_deg = 180.0
    speed_mps = 7.0
    """
OVERTAKING = """
    [[vehicles]]
    name = "near"
    x_m = -9.0
    y_m = 8.0
    speed_mps = 4.0
    [[vehicles]]
    name = "far"
    x_m = -22.0
    y_m = 5.2
    speed_mps = 9.0
    """


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("text", [PASSING, OVERTAKING])
def test_a_passing_neighbour_steals_no_identity(text, seed):
    """Two cars a metre apart; each moving identity follows one of them and never the other."""
    what = world(text + BACKDROP, 7.0)
    steps = driven(what, seed)
    t = np.array([s.tracks.t for s in steps]) - simulate.EPOCH_NS * 1e-9
    truth = simulate.truth_at(what, t)
    follows = {name: set() for name in truth}
    for k, step in enumerate(steps):
        for i in np.flatnonzero(step.tracks.state == TrackState.CONFIRMED):
            off = {n: np.hypot(*(step.tracks.W_p[i] - [m.x[k], m.y[k]])) for n, m in truth.items()}
            nearest = min(off, key=off.get)
            assert off[nearest] < 1.0
            follows[nearest].add(int(step.tracks.id[i]))
    one, two = follows.values()
    assert len(one) == len(two) == 1
    assert one != two
