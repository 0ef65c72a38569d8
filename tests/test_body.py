"""Sizes: what is bounded is measured, what is open can only grow, and a whole pass tells the truth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from made_worlds import BACKDROP, driven, look, world
from outrider.body import GROWTH, learn, measure
from outrider.geometry import rotate
from outrider.records import TrackState

NOISE = 0.03
LENGTHS = st.floats(0.3, 6.0)
SIGMAS = st.one_of(st.floats(0.02, 0.5), st.floats(-0.5, -0.02), st.just(np.inf))


def size_after(size, seen, sigma, least=0.05):
    rows = [np.array([row]) for row in (size, seen, sigma)]
    return learn(*rows, least)[0]


@given(st.tuples(LENGTHS, LENGTHS), st.tuples(LENGTHS, LENGTHS), st.tuples(SIGMAS, SIGMAS))
def test_an_open_side_never_shrinks_and_an_unseen_one_stays(old, seen, sigma):
    before = np.array([*old, 0.5, 0.15])
    after = size_after(before, np.array(seen), np.array(sigma))
    for a in range(2):
        if np.isinf(sigma[a]):
            assert after[a] == before[a]
        elif sigma[a] < 0.0:
            assert before[a] <= after[a] <= max(before[a], seen[a])
        assert min(before[a], seen[a]) <= after[a] <= max(before[a], seen[a])
        assert 0.05 <= after[2 + a] <= before[2 + a]


def test_a_bounded_side_is_averaged_as_a_kalman_filter_does():
    after = size_after([4.3, 1.8, 0.5, 0.15], [4.6, 1.8], [0.1, np.inf])
    gain = 0.5**2 / (0.5**2 + 4.0 * 0.1**2)  # one look counts as a quarter: neighbouring scans err alike
    assert after[0] == pytest.approx(4.3 + gain * 0.3)
    assert after[2] == pytest.approx(0.5 * np.sqrt(1.0 - gain))


def test_a_look_that_cannot_be_of_this_body_is_left_out():
    assert size_after([4.3, 1.8, 0.05, 0.05], [2.0, 1.8], [0.05, np.inf])[0] == 4.3


@given(st.floats(3.6, 5.0), st.integers(0, 1000))
@settings(max_examples=20)
def test_bounded_looks_converge_to_their_mean(true, seed):
    rng = np.random.default_rng(seed)
    size = np.array([4.3, 1.8, 0.5, 0.15])
    for _ in range(200):
        size = size_after(size, [true + rng.normal(0.0, 0.05), 1.8], [0.05, np.inf])
    assert size[0] == pytest.approx(true, abs=0.06)


# ------------------------------------------------------------------ one look


def one_look(pose, true, believed, eye, free, keep=slice(None), gap=0.0):
    p, _ = look(pose, true, eye)
    turn = np.arctan2(*(p - eye).T[::-1])
    p = p[np.argsort(np.unwrap(turn - np.arctan2(pose[1] - eye[1], pose[0] - eye[0])))][keep]
    beams = np.arange(len(p))
    W_o = np.tile([*eye, 0.0], (len(p), 1)).astype(float)
    rows = np.array([[0, len(p)]])
    seen, sigma = measure(
        p,
        W_o,
        beams,
        rows,
        np.array([free]),
        np.full((1, 2), gap),
        np.array([pose]),
        np.array([believed]),
        NOISE,
    )
    return seen[0], sigma[0]


POSE, TRUE = np.array([0.0, 6.0, 0.0]), np.array([4.4, 1.8])


def test_a_side_with_two_free_ends_is_measured_and_the_other_is_not():
    seen, sigma = one_look(POSE, TRUE, (4.3, 1.8), np.zeros(2), (True, True))
    assert seen[0] == pytest.approx(4.4, abs=0.15)
    assert 0.0 < sigma[0] < 0.1
    assert np.isinf(sigma[1])


@pytest.mark.parametrize("free", [(False, True), (True, False), (False, False)])
def test_a_side_with_an_open_end_is_a_lower_bound(free):
    _, sigma = one_look(POSE, TRUE, (4.3, 1.8), np.zeros(2), free)
    assert sigma[0] < 0.0


def test_a_corner_bounds_a_side():
    """Seen from aslant both sides end in the corner; the far ends are free."""
    eye = np.array([-8.0, 0.0])
    seen, sigma = one_look(POSE, TRUE, (4.3, 1.8), eye, (True, True))
    assert (sigma > 0.0).all()
    assert seen == pytest.approx(TRUE, abs=0.25)


@pytest.mark.parametrize("x", [0.0, 2.0, 8.0])
def test_a_gap_beside_the_last_return_is_shared(x):
    """Half of what the next beam skipped is taken to be body: the more, the flatter it meets the side."""
    eye = np.array([x, 0.0])
    without, doubt = one_look(POSE, TRUE, (4.3, 1.8), eye, (True, True))
    wide, more = one_look(POSE, TRUE, (4.3, 1.8), eye, (True, True), gap=0.05)
    ends = np.array([-2.2, 2.2]) if x < 2.2 else np.array([-2.2])  # the nearer end is a corner that is seen
    skipped = 0.05 * np.hypot(ends - x, 6.0 - 0.9) / (6.0 - 0.9)
    assert wide[0] - without[0] == pytest.approx(0.5 * skipped.sum(), rel=0.05)
    assert more[0] > doubt[0]


@given(st.floats(-3.0, 3.0))
@settings(max_examples=20)
def test_the_size_turns_with_the_world(turn):
    eye = np.array([-8.0, 0.0])
    want = one_look(POSE, TRUE, (4.3, 1.8), eye, (True, True))
    p, _ = look(POSE, TRUE, eye)
    n = len(p)
    order = np.argsort(np.arctan2(*(p - eye).T[::-1]))
    p = np.ascontiguousarray(rotate(p[order], turn))
    pose = np.array([[*rotate(POSE[None, :2], turn)[0], turn]])
    W_o = np.tile([*rotate(eye[None], turn)[0], 0.0], (n, 1))
    rows, gap, free = np.array([[0, n]]), np.zeros((1, 2)), np.ones((1, 2), bool)
    seen, sigma = measure(p, W_o, np.arange(n), rows, free, gap, pose, np.array([[4.3, 1.8]]), NOISE)
    assert seen[0] == pytest.approx(want[0], abs=1e-9)
    assert sigma[0] == pytest.approx(want[1], abs=1e-9)


def test_what_sticks_out_too_far_belongs_to_something_else():
    """A wall in line with the side does not lengthen the body by more than it may grow in one look."""
    seen, _ = one_look(POSE, np.array([12.0, 1.8]), (4.3, 1.8), np.zeros(2), (True, True))
    assert seen[0] <= 4.3 + 2.0 * GROWTH


# ------------------------------------------------------------------ over a pass


def learnt(text, seconds, seed=0):
    """Extent of the one moving track at the end of a pass."""
    steps = driven(world(text, seconds), seed)
    last = next(s.tracks for s in reversed(steps) if (s.tracks.state == TrackState.CONFIRMED).any())
    return last.extent[last.state == TrackState.CONFIRMED][0]


@pytest.mark.parametrize("seed", [0, 1])
def test_a_car_that_shows_all_its_sides_is_learnt(seed):
    """Round the sensor on a circle of 9 m, then away: sides, front and rear."""
    circle = """
        [[vehicles]]
        name = "car"
        x_m = -14.0
        y_m = -8.0
        speed_mps = 6.0
        manoeuvres = [{ duration_s = 2.0 }, { duration_s = 7.0, steering_deg = 24.0 },
                      { duration_s = 2.0, steering_deg = 0.0 }]
        """
    assert learnt(circle + BACKDROP, 10.0, seed) == pytest.approx([4.5, 1.8], abs=0.1)


@pytest.mark.parametrize(("length", "width"), [(4.5, 1.8), (3.6, 1.6), (5.2, 2.0)])
def test_a_car_that_passes_is_learnt(length, width):
    """Front, side and rear, one after the other; grazing beams at the far ends do not come back."""
    passing = f"""
        [[vehicles]]
        name = "car"
        x_m = -22.0
        y_m = 5.0
        speed_mps = 6.0
        length_m = {length}
        width_m = {width}
        """
    assert learnt(passing + BACKDROP, 7.0) == pytest.approx([length, width], abs=0.12)


def test_a_two_wheeler_stays_small():
    bicycle = """
        [[vehicles]]
        name = "bicycle"
        x_m = -14.0
        y_m = 4.0
        speed_mps = 5.0
        length_m = 1.8
        width_m = 0.6
        rear_axle_m = 0.5
        wheelbase_m = 1.1
        """
    for step in driven(world(bicycle + BACKDROP, 6.0)):
        moving = step.tracks.state == TrackState.CONFIRMED
        assert (step.tracks.extent[moving] <= [2.2, 0.9]).all()
    length, width = learnt(bicycle + BACKDROP, 6.0)
    assert length == pytest.approx(1.8, abs=0.15)
    assert width == pytest.approx(0.6, abs=0.2)
