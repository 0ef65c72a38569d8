"""Rectangles: exact where the returns are, turned as the world is turned, sure only of what was seen."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from made_worlds import look
from outrider import rectangle
from outrider.geometry import compose, corners, transform, wrap, wrap_axis
from outrider.rectangle import fit_closeness, fit_sized, solve3

SIZE = np.array([4.5, 1.8])
SIGMA = 0.06
SCALE = np.array([SIGMA, 2.0])
EMPTY = np.zeros((0, 2))
ANGLES = st.floats(-np.pi, np.pi)


def fitted(p, eye, prior, far=EMPTY, weight=1.0, size=SIZE, spread=(3.0, 0.3)):
    """Pose and normal equations of the sized rectangle from returns p and beams that went past to `far`."""
    pose, N = np.empty(3), np.empty((3, 4))
    o, far_o = np.tile(np.asarray(eye, float), (len(p), 1)), np.tile(np.asarray(eye, float), (len(far), 1))
    prior = np.array([*prior, *spread])
    cost, sides = fit_sized(
        prior[:3].copy(), p, o, far, far_o, np.full(len(far), weight), prior, size, SCALE, pose, N
    )
    return pose, N, cost, sides


def beside(far, eye, p, count=12):
    """The ends of the beams next to the body, on either side, as the tracker hands them over."""
    middle = np.arctan2(*(p.mean(axis=0) - eye)[::-1])
    turn = wrap(np.arctan2(*(far - eye).T[::-1]) - middle)
    left, right = np.sort(turn[turn > 0.0])[:count], np.sort(-turn[turn < 0.0])[:count]
    return far[((turn > 0.0) & (turn <= left[-1])) | ((turn < 0.0) & (-turn <= right[-1]))]


# ------------------------------------------------------------------ of unknown size


@given(ANGLES, st.floats(2.0, 6.0), st.floats(0.8, 1.9), st.floats(-20.0, 20.0))
@settings(max_examples=25)
def test_closeness_of_an_exact_corner_is_the_rectangle(yaw, length, width, x):
    """Returns on two sides from corner to corner: all of it within the step of the search and the floor."""
    box = corners(np.array([x, 3.0, yaw]), np.array([length, width]))
    share = np.linspace(0.0, 1.0, 15)[:, None]
    p = np.vstack([box[1] + share * (box[0] - box[1]), box[1] + share[1:] * (box[2] - box[1])])
    floor = 0.005
    cx, cy, heading, long, wide = fit_closeness(np.ascontiguousarray(p), floor)
    step = 0.5 * np.pi / rectangle.ANGLES / 8.0 + floor / width
    assert abs(wrap_axis(heading - yaw)) <= step
    assert np.hypot(cx - x, cy - 3.0) < length * step
    assert (long, wide) == pytest.approx((length, width), abs=length * step)


def test_closeness_holds_all_returns():
    p = np.random.default_rng(0).normal(size=(40, 2))
    cx, cy, heading, long, wide = fit_closeness(p, 0.02)
    q = transform(np.array([0.0, 0.0, -heading]), p - [cx, cy])
    assert (np.abs(q) <= np.array([long, wide]) / 2.0 + 1e-12).all()
    assert long >= wide


# ------------------------------------------------------------------ of known size


@given(ANGLES, st.floats(6.0, 20.0), ANGLES)
@settings(max_examples=25)
def test_exact_returns_give_the_exact_pose(yaw, away, bearing):
    """Two sides in view, no noise: the pose within the accuracy of the iteration."""
    true = np.array([away * np.cos(bearing), away * np.sin(bearing), yaw])
    eye = np.zeros(2)
    p, far = look(true, SIZE, eye)
    u, v = transform(np.array([0.0, 0.0, -yaw]), eye - true[:2])
    if min(abs(u) - 0.5 * SIZE[0], abs(v) - 0.5 * SIZE[1]) < 1.0:  # one side alone, or nearly
        return
    pose, _, _, sides = fitted(p, eye, true + np.array([0.3, -0.2, 0.1]), beside(far, eye, p))
    assert np.hypot(*(pose - true)[:2]) < 2e-3
    assert abs(wrap(pose[2] - true[2])) < 2e-3
    on_end = np.abs(np.abs(transform(np.array([0.0, 0.0, -yaw]), p - true[:2])[:, 0]) - 0.5 * SIZE[0]) < 1e-6
    if min(on_end.sum(), (~on_end).sum()) > max(2, len(p) // 10):
        assert sides == 3


def test_with_noise_the_errors_are_those_of_least_squares():
    """Over many draws: mean square of each error no more than a few times its variance by the information."""
    rng, noise = np.random.default_rng(0), 0.02
    true, eye = np.array([7.0, 5.0, 0.4]), np.zeros(2)
    p, _ = look(true, SIZE, eye)
    ray = (p - eye) / np.linalg.norm(p - eye, axis=1, keepdims=True)
    errors, scaled = [], []
    for _ in range(60):
        pose, N, _, _ = fitted(
            p + rng.normal(0.0, noise, (len(p), 1)) * ray, eye, true + np.array([0.1, 0.1, 0.05])
        )
        cov = np.linalg.inv(N[:, :3]) * (noise / SIGMA) ** 2
        error = pose - true
        errors.append(error)
        scaled.append(error @ np.linalg.solve(cov, error))
    assert np.sqrt(np.mean(np.square(errors), axis=0)) == pytest.approx([0.0, 0.0, 0.0], abs=0.02)
    assert np.mean(scaled) < 3.0 * 1.5  # rays meet the sides aslant, so the error across them is smaller
    assert np.abs(np.mean(errors, axis=0)).max() < 0.006


@given(ANGLES, st.floats(-50.0, 50.0), st.floats(-50.0, 50.0))
@settings(max_examples=20)
def test_turning_the_world_turns_the_answer(turn, x, y):
    move = np.array([x, y, turn])
    true, eye = np.array([8.0, 3.0, 0.7]), np.zeros(2)
    p, far = look(true, SIZE, eye)
    far = beside(far, eye, p)
    start = true + np.array([0.2, 0.3, -0.1])
    here = fitted(p, eye, start, far)[0]
    there = fitted(transform(move, p), transform(move, eye), compose(move, start), transform(move, far))[0]
    error = there - compose(move, here)
    assert np.hypot(*error[:2]) < 1e-3
    assert abs(wrap(error[2])) < 1e-3


def test_the_mirror_image_has_the_mirrored_answer():
    true, eye = np.array([8.0, 3.0, 0.7]), np.zeros(2)
    p, far = look(true, SIZE, eye)
    far = beside(far, eye, p)
    start = true + np.array([0.2, 0.3, -0.1])
    flip = np.array([1.0, -1.0])
    pose, N, cost, sides = fitted(p, eye, start, far)
    other, M, cost2, sides2 = fitted(p * flip, eye * flip, start * [1, -1, -1], far * flip)
    assert other == pytest.approx(pose * [1, -1, -1], abs=1e-9)
    assert cost2 == pytest.approx(cost, rel=1e-9)
    assert sides2 == sides
    sign = np.outer([1, -1, -1], [1, -1, -1])
    assert np.allclose(M[:, :3], sign * N[:, :3], atol=1e-6)


def equations(pose, p, far, weight, prior, size=SIZE, eye=(0.0, 0.0)):
    N = np.empty((3, 4))
    o, far_o = np.tile(np.asarray(eye), (len(p), 1)), np.tile(np.asarray(eye), (len(far), 1))
    cost, _ = rectangle._normal_equations(pose, p, o, far, far_o, weight, prior, size, SCALE, N)
    return cost, N


@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.05, 0.05), st.integers(0, 5))
@settings(max_examples=40)
def test_the_gradient_is_that_of_the_cost(dx, dy, turn, seed):
    """g = half the slope of the cost, by central differences, with beams through the body and a prior."""
    rng = np.random.default_rng(seed)
    true, eye = np.array([7.0, 4.0, 0.3]), np.zeros(2)
    p, _ = look(true, SIZE, eye, beams=120)
    p = p + rng.normal(0.0, 0.03, p.shape)
    aim = np.arctan2(true[1], true[0]) + np.array([-0.2, -0.1, 0.15, 0.25])
    far = 25.0 * np.column_stack([np.cos(aim), np.sin(aim)])
    prior, weight = np.array([6.8, 4.1, 0.35, 0.5, 0.2]), np.ones(4)
    pose = true + np.array([dx, dy, turn])
    _, N = equations(pose, p, far, weight, prior)
    h = 1e-6
    slope = [
        (
            equations(pose + h * e, p, far, weight, prior)[0]
            - equations(pose - h * e, p, far, weight, prior)[0]
        )
        / (2.0 * h)
        for e in np.eye(3)
    ]
    assert 2.0 * N[:, 3] == pytest.approx(slope, rel=1e-4, abs=1e-3)
    assert np.allclose(N[:, :3], N[:, :3].T)
    assert (np.linalg.eigvalsh(N[:, :3]) > 0.0).all()


def depth(pose, size, eye, end):
    """How far the beam from eye to end cuts into the silhouette of the body [m]."""
    across = np.array([-(end - eye)[1], (end - eye)[0]]) / np.hypot(*(end - eye))
    box = (corners(pose, size) - eye) @ across
    return min(box.max(), -box.min())


def test_a_beam_that_went_through_pushes_the_body_aside():
    """Of the rear only the middle is seen, so across it is open, until a beam goes past on the left."""
    eye = np.zeros(2)
    y = np.linspace(-0.4, 0.4, 9)
    p = np.column_stack([np.full(9, 8.0), y])
    guess = np.array([8.0 + 0.5 * SIZE[0], 0.0, 0.0])
    far = np.array([[20.0, 0.7 * 20.0 / 8.0]])  # 0.2 m inside the left corner
    without, *_ = fitted(p, eye, guess)
    with_it, *_ = fitted(p, eye, guess, far)
    assert abs(without[1]) < 0.01
    assert depth(without, SIZE, eye, far[0]) > 0.1
    assert depth(with_it, SIZE, eye, far[0]) < 0.03
    assert with_it[1] < -0.1
    assert with_it[0] == pytest.approx(without[0], abs=0.05)


@pytest.mark.parametrize("end", ["before", "behind"])
def test_a_beam_that_did_not_reach_the_body_says_nothing(end):
    true, eye = np.array([8.0, 3.0, 0.3]), np.zeros(2)
    p, _ = look(true, SIZE, eye)
    short = np.array([[4.0, 1.5]]) if end == "before" else np.array([[-8.0, -3.0]])
    assert np.array_equal(fitted(p, eye, true, short)[0], fitted(p, eye, true)[0])


def test_silence_moves_a_body_but_does_not_turn_it():
    """Beams without return count little, and add nothing to the heading's row of the equations."""
    true, eye = np.array([7.0, 4.0, 0.3]), np.zeros(2)
    p, _ = look(true, SIZE, eye, beams=120)
    aim = np.arctan2(4.0, 7.0) + np.array([-0.2, 0.2])
    far = 25.0 * np.column_stack([np.cos(aim), np.sin(aim)])
    prior = np.array([*true, 0.5, 0.2])
    alone, silent = (equations(true, p, far[:k], np.full(k, 0.05), prior)[1] for k in (0, 2))
    assert np.array_equal(silent[2], alone[2])
    assert silent[:2, 3] != pytest.approx(alone[:2, 3])


def test_the_information_is_small_only_where_nothing_was_seen():
    """The middle of a long side: sure across it, open along it, and of the heading within the baseline."""
    p = np.column_stack([np.linspace(-0.7, 0.7, 15), np.full(15, 5.0)])
    true = np.array([0.0, 5.0 + 0.5 * SIZE[1], 0.0])
    _, N, _, sides = fitted(p, np.zeros(2), true)
    sigma = np.sqrt(np.diag(np.linalg.inv(N[:, :3])))
    assert sigma[1] < 2.0 * SIGMA / np.sqrt(15.0)
    assert sigma[0] > 1.0
    assert sigma[2] == pytest.approx(SIGMA / np.sqrt(15.0) / np.std(p[:, 0]), rel=0.3)
    assert sides == 2  # a long side


def test_an_outlier_hardly_counts():
    true, eye = np.array([8.0, 4.0, 0.5]), np.zeros(2)
    p, _ = look(true, SIZE, eye)
    stray = np.vstack([p, true[:2] - np.array([3.5, 2.0])])
    moved = fitted(stray, eye, true)[0] - fitted(p, eye, true)[0]
    assert np.hypot(*moved[:2]) < 0.01


@given(st.integers(0, 10_000), st.sampled_from([0.0, 1e-3, 8.0]))
def test_solve3_solves(seed, damping):
    rng = np.random.default_rng(seed)
    B = rng.normal(size=(3, 3))
    A, g = B @ B.T + 0.1 * np.eye(3), rng.normal(size=3)
    z = solve3(np.column_stack([A, g]), damping)
    assert np.allclose((A + damping * np.diag(np.diag(A))) @ z, g, atol=1e-8)
