"""The predictor is a Kalman filter: as the textbook writes it, and never less sure than nothing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from outrider.geometry import rotate, wrap
from outrider.predictor import correct, mahalanobis2, predict

SEEDS = st.integers(0, 100_000)
FAR_OFF = 1e9  # a course speed that is never reached: no pull of the course


def drawn(seed, n=1):
    """States (n, 6), covariances, measurements (n, 3), their covariances, and time steps."""
    rng = np.random.default_rng(seed)
    B, C = rng.normal(size=(n, 6, 6)), rng.normal(size=(n, 3, 3))
    x = rng.normal(size=(n, 6)) * [20.0, 20.0, 8.0, 8.0, 1.0, 0.5]
    P = B @ B.transpose(0, 2, 1) + 1e-3 * np.eye(6)
    R = 0.1 * C @ C.transpose(0, 2, 1) + 1e-4 * np.eye(3)
    z = x[:, [0, 1, 4]] + rng.normal(size=(n, 3)) * [1.0, 1.0, 0.3]
    return x, P, z, R, rng.uniform(0.0, 1.0, n)


@given(SEEDS, st.floats(0.0, 20.0), st.floats(0.0, 10.0))
@settings(max_examples=50)
def test_prediction_is_that_of_the_textbook(seed, q, qh):
    """x = F x, P = F P F' + G G' q^2 with piecewise constant white acceleration, matrices in full."""
    x, P, _, _, dt = drawn(seed)
    (t,) = dt
    F = np.eye(6)
    F[0, 2] = F[1, 3] = F[4, 5] = t
    G = np.array([[t * t / 2, 0, 0], [0, t * t / 2, 0], [t, 0, 0], [0, t, 0], [0, 0, t * t / 2], [0, 0, t]])
    want = F @ P[0] @ F.T + G @ np.diag([q * q, q * q, qh * qh]) @ G.T
    got_x, got_P = predict(x, P, dt, np.array([q]), qh)
    assert got_x[0] == pytest.approx(F @ x[0], rel=1e-12, abs=1e-12)
    assert np.allclose(got_P[0], want, rtol=1e-12, atol=1e-11)


@given(SEEDS)
@settings(max_examples=50)
def test_correction_is_that_of_the_textbook(seed):
    """K = P H' S^-1, P = (I - K H) P (I - K H)' + K R K'."""
    x, P, z, R, _ = drawn(seed)
    H = np.eye(6)[[0, 1, 4]]
    K = P[0] @ H.T @ np.linalg.inv(H @ P[0] @ H.T + R[0])
    A = np.eye(6) - K @ H
    want = x[0] + K @ (z[0] - H @ x[0])
    want[4] = wrap(want[4])
    got_x, got_P = correct(x, P, z, R, 0.5, FAR_OFF, 0.0)
    assert got_x[0] == pytest.approx(want, rel=1e-9, abs=1e-9)
    assert np.allclose(got_P[0], A @ P[0] @ A.T + K @ R[0] @ K.T, rtol=1e-8, atol=1e-9)


def test_two_steps_of_prediction_are_one_without_noise():
    x, P, *_ = drawn(1, 5)
    dt, quiet = np.full(5, 0.3), np.zeros(5)
    once = predict(x, P, 2.0 * dt, quiet, 0.0)
    twice = predict(*predict(x, P, dt, quiet, 0.0), dt, quiet, 0.0)
    assert np.allclose(once[0], twice[0], atol=1e-12)
    assert np.allclose(once[1], twice[1], atol=1e-10)


def test_a_row_does_not_hang_on_the_others():
    x, P, z, R, dt = drawn(2, 7)
    q = np.linspace(1.0, 9.0, 7)
    x1, P1 = predict(x, P, dt, q, 4.0)
    x1, P1 = correct(x1, P1, z, R, 0.5, 1.0, 0.05)
    for i in range(7):
        row = slice(i, i + 1)
        x2, P2 = correct(*predict(x[row], P[row], dt[row], q[row], 4.0), z[row], R[row], 0.5, 1.0, 0.05)
        assert np.allclose(x2[0], x1[i], atol=1e-12)
        assert np.allclose(P2[0], P1[i], atol=1e-12)


@given(SEEDS, st.floats(0.01, 2.0), st.floats(0.0, 20.0))
@settings(max_examples=60)
def test_the_covariance_stays_one(seed, course_sigma, course_speed):
    """Symmetric and without negative eigenvalue over twenty scans of any kind; never grown by a look."""
    x, P, _, _, _ = drawn(seed, 3)
    rng = np.random.default_rng(seed + 1)
    for _ in range(20):
        x, P = predict(x, P, rng.uniform(0.0, 0.5, 3), np.full(3, 6.0), 4.0)
        _, _, _, R, _ = drawn(int(rng.integers(1 << 30)), 3)
        before = P
        x, P = correct(
            x, P, x[:, [0, 1, 4]] + 5.0 * rng.normal(size=(3, 3)), R, course_sigma, course_speed, 0.05
        )
        scale = np.trace(before, axis1=1, axis2=2)
        assert np.array_equal(P, P.transpose(0, 2, 1))
        assert (np.linalg.eigvalsh(P)[:, 0] > -1e-10 * scale).all()
        assert (np.linalg.eigvalsh(before - P)[:, 0] > -1e-10 * scale).all()
        assert np.isfinite(x).all()
        assert (np.abs(x[:, 4]) <= np.pi).all()


@given(SEEDS, st.integers(-2, 2))
@settings(max_examples=30)
def test_whole_turns_of_the_measured_heading_change_nothing(seed, turns):
    x, P, z, R, _ = drawn(seed)
    more = z + np.array([0.0, 0.0, 2.0 * np.pi * turns])
    a, b = (correct(x, P, m, R, 0.5, FAR_OFF, 0.05)[0][0] for m in (z, more))
    assert a[:4] == pytest.approx(b[:4], abs=1e-9)
    assert wrap(a[4] - b[4]) == pytest.approx(0.0, abs=1e-9)


def test_a_heading_across_the_seam_goes_the_short_way():
    x, P = np.array([[0.0, 0.0, 0.0, 0.0, np.pi - 0.1, 0.0]]), np.eye(6)[None]
    z = np.array([[0.0, 0.0, -np.pi + 0.1]])
    after = correct(x, P, z, np.eye(3)[None], 0.5, FAR_OFF, 0.0)[0][0]
    assert abs(after[4]) == pytest.approx(np.pi, abs=1e-12)  # half way between, through the seam


@given(st.floats(2.0, 20.0), st.floats(-3.1, 3.1), st.floats(-1.5, 1.5))
@settings(max_examples=30)
def test_the_course_draws_the_heading_and_never_turns_it_round(speed, course, off):
    x = np.array([[0.0, 0.0, speed * np.cos(course), speed * np.sin(course), wrap(course + off), 0.0]])
    P = np.diag([1.0, 1.0, 0.01, 0.01, 0.05, 0.1])[None]
    R = np.diag([1.0, 1.0, 0.05])[None]
    drawn_in = correct(x, P, x[:, [0, 1, 4]], R, 0.5, 1.4, 0.05)[0][0, 4]
    assert abs(wrap(drawn_in - course)) <= abs(off) + 1e-12
    backward = x + np.array([0.0, 0.0, 0.0, 0.0, np.pi, 0.0])  # a body that reverses
    z = np.column_stack([backward[:, :2], wrap(backward[:, 4])])
    assert wrap(correct(backward, P, z, R, 0.5, 1.4, 0.05)[0][0, 4] - backward[0, 4]) == pytest.approx(0.0)


@given(SEEDS, st.floats(-3.0, 3.0))
@settings(max_examples=30)
def test_the_distance_of_the_gate_is_that_of_the_inverse_and_turns_with_the_world(seed, turn):
    x, P, z, R, _ = drawn(seed)
    S, e = P[0, :2, :2] + R[0, :2, :2], (z - x[:, [0, 1, 4]])[0, :2]
    (d2,) = mahalanobis2(x, P, z, R)
    assert d2 == pytest.approx(e @ np.linalg.solve(S, e), rel=1e-9)
    T = rotate(np.eye(2), turn).T
    x2, z2, P2, R2 = x.copy(), z.copy(), P.copy(), R.copy()
    x2[:, :2], z2[:, :2] = rotate(x[:, :2], turn), rotate(z[:, :2], turn)
    P2[0, :2, :2], R2[0, :2, :2] = T @ P[0, :2, :2] @ T.T, T @ R[0, :2, :2] @ T.T
    assert mahalanobis2(x2, P2, z2, R2)[0] == pytest.approx(d2, rel=1e-8)
