"""The unscented Kalman filter: against FilterPy, the linear filter, and what a road asks of it."""

import math
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from outrider import kernel, observers
from outrider.models import bicycle
from outrider.observers import _bicycle, ekf, ukf
from outrider.observers.ukf import Gains, State

pytestmark = pytest.mark.once

NAN = float("nan")
PLAIN = Gains(huber=0.0, coast=0.0, mean=1.0)
ORDER = [2, 3, 4, 5, 0, 1]  # of the sigma points: V, A, psi, beta, x, y


def covariance(state: Any) -> np.ndarray:
    """P (6, 6) of a state or its row."""
    P = np.zeros((6, 6))
    P[np.tril_indices(6)] = np.array(state)[6:]
    return P + np.tril(P, -1).T


def state_of(mean: Any, P: np.ndarray) -> State:
    """State with mean (6,) and covariance (6, 6)."""
    return kernel.from_row(State, np.r_[np.asarray(mean, float), P[np.tril_indices(6)]])


def measured(p: np.ndarray, yaw: Any = 0.0, sigma: float = 0.0, sigma_yaw: float = math.inf) -> np.ndarray:
    """Measurements (n, 9) at p (n, 2) and yaw (n,), with noise and the deviations that it has."""
    rng = np.random.default_rng(5)
    y = np.zeros((len(p), 9))
    y[:, :2] = p + rng.normal(0.0, 1.0, p.shape) * sigma
    y[:, 5] = yaw + (rng.normal(0.0, sigma_yaw, len(p)) if sigma_yaw < math.inf else 0.0)
    y[:, 2] = y[:, 4] = sigma**2
    y[:, 6] = sigma_yaw**2
    return y


def drive(n: int = 120, speed: float = 8.0, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Rows (n, 6) of a bicycle that changes speed and turns at random, irregular time steps (n,) [s]."""
    rng = np.random.default_rng(seed)
    dt = rng.uniform(0.05, 0.15, n)
    s, rows = bicycle.State(0.0, 0.0, speed, 0.0, 2.5, 0.0), []
    for k in range(n):
        s = bicycle.arc(s, dt[k]) if k else s
        rows.append(s)
        A = 0.95 * s.A - 0.05 * (s.V - speed) + rng.normal(0.0, 0.3)
        s = s._replace(A=A, beta=0.97 * s.beta + rng.normal(0.0, 0.01))
    return np.array(rows), dt


def run(y: np.ndarray, dt: Any, gains: Any, observer: Any = ukf) -> np.ndarray:
    """States (n, n_states), rows before the start NaN."""
    return observers.batch(observer, y[None], np.broadcast_to(dt, (1, len(y))), gains)[0]


def rms(e: Any) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(e), axis=-1))))


# ------------------------------------------------------------------ the same as others


def _root(M: np.ndarray) -> np.ndarray:
    """U (6, 6) with U'U = M, its rows the points' directions, position last."""
    U = np.zeros((6, 6))
    U[:, ORDER] = np.linalg.cholesky(M[np.ix_(ORDER, ORDER)]).T
    return U


def _residual(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    e = a - b
    angle = 4 if len(e) == 6 else 2
    e[angle:] = np.remainder(e[angle:] + np.pi, math.tau) - np.pi
    return e


def filterpy_filter(gains: Gains, outputs: int) -> UnscentedKalmanFilter:
    """FilterPy's filter with our motion and our points."""
    return UnscentedKalmanFilter(
        dim_x=6,
        dim_z=outputs,
        dt=0.1,
        hx=lambda x: x[[0, 1, 4][:outputs]],
        fx=lambda x, dt: np.array(bicycle.arc(bicycle.State(*x), dt, gains.l_r)),
        points=MerweScaledSigmaPoints(6, gains.alpha, gains.beta, gains.kappa, sqrt_method=_root),
        x_mean_fn=None if gains.mean else lambda points, weights: points[0],
        residual_x=_residual,
        residual_z=_residual,
    )


def process_noise(x: np.ndarray, dt: float, gains: Gains) -> np.ndarray:
    """Integral of responses to white noise at the mean speed, along and across the chord; A stays."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    V = x[2] + 0.5 * x[3] * dt
    course = x[4] + x[5] + 0.5 * (x[2] * dt + 0.5 * x[3] * dt**2) * np.sin(x[5]) / gains.l_r
    c, s, B = np.cos(course), np.sin(course), V * np.cos(x[5]) / gains.l_r
    Q = np.zeros((6, 6))
    for t, w in zip(0.5 * dt * (nodes + 1.0), 0.5 * dt * weights, strict=True):
        across = V * t + 0.5 * V * B * t * t
        jerk = np.array([c * t * t / 2, s * t * t / 2, t, 1.0, 0.0, 0.0])
        slip = np.array([-s * across, c * across, 0.0, 0.0, B * t, 1.0])
        yaw = np.array([-s * V * t, c * V * t, 0.0, 0.0, 1.0, 0.0])
        for q, column in ((gains.jerk, jerk), (gains.slip, slip), (gains.yaw, yaw)):
            Q += w * q**2 * np.outer(column, column)
    return Q


def the_same(state: np.ndarray, mean: np.ndarray, P: np.ndarray) -> None:
    ours = state[:6].copy()
    ours[4] += math.tau * round((mean[4] - ours[4]) / math.tau)
    np.testing.assert_allclose(ours, mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(covariance(state), P, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("heading", [0.0, 1.0])
@pytest.mark.parametrize(
    ("alpha", "beta", "kappa", "mean"),
    [
        (1.0, 2.0, -3.0, 1.0),
        (0.5, 2.0, 0.0, 1.0),
        (0.1, 2.0, 1.0, 1.0),
        (1.0, 0.0, 2.0, 1.0),
        (1.0, 2.0, -3.0, 0.0),
    ],
)
def test_it_is_the_filter_of_filterpy(
    heading: float, alpha: float, beta: float, kappa: float, mean: float
) -> None:
    g = PLAIN._replace(heading=heading, alpha=alpha, beta=beta, kappa=kappa, mean=mean)
    truth, dt = drive()
    y = measured(truth[:, :2], truth[:, 4], 0.1, 0.03)
    y[:, 2:5] = 0.012, 0.003, 0.008
    states = run(y, dt, g)
    outputs = 3 if heading else 2
    theirs = filterpy_filter(g, outputs)
    theirs.x, theirs.P = states[1, :6].copy(), covariance(states[1])
    R = np.diag([0.012 + g.noise**2, 0.008 + g.noise**2, 0.03**2 + g.heading_noise**2])
    R[0, 1] = R[1, 0] = 0.003
    for k in range(2, len(y)):
        theirs.Q = process_noise(theirs.x, dt[k], g)
        theirs.predict(dt[k])
        theirs.update(y[k, [0, 1, 5]][:outputs], R[:outputs, :outputs])
        the_same(states[k], theirs.x, theirs.P)


def test_looking_back_is_that_of_filterpy() -> None:
    truth, dt = drive(60)
    states = run(measured(truth[:, :2], truth[:, 4], 0.1, 0.03), dt, PLAIN)
    theirs = filterpy_filter(PLAIN, 3)
    later, x, P = states[-1], states[-1, :6], covariance(states[-1])
    for k in range(len(y := states) - 2, 1, -1):
        theirs.Q = process_noise(y[k, :6], dt[k + 1], PLAIN)
        xs, Ps, _ = theirs.rts_smoother(
            np.array([y[k, :6], x]), np.array([covariance(y[k]), P]), dts=np.full(2, dt[k + 1])
        )
        later = np.array(ukf.smooth(State(*y[k]), State(*later), dt[k + 1], PLAIN))
        x, P = xs[0], Ps[0]
        the_same(later, x, P)


def test_on_a_straight_road_it_is_the_linear_filter() -> None:
    """Yaw and slip known for sure: way, speed and acceleration are a linear system."""
    g = PLAIN._replace(slip=0.0, yaw=0.0, heading=0.0)
    rng = np.random.default_rng(3)
    dt = rng.uniform(0.05, 0.2, 80)
    u = np.cumsum(dt) * 8.0 + rng.normal(0.0, 0.1, 80)
    y = np.column_stack([u, np.zeros(80)])
    s = ukf.start(*(observers.Measurement(*row) for row in measured(y)[:2]), dt[1], g)
    P = covariance(s)
    for i in (1, 4, 5):
        P[i], P[:, i], P[i, i] = 0.0, 0.0, 1e-20
    s = state_of([s.x, 0.0, s.V, s.A, 0.0, 0.0], P)
    chain = [0, 2, 3]
    theirs = KalmanFilter(dim_x=3, dim_z=1)
    theirs.x, theirs.P, theirs.H = np.array([s.x, s.V, s.A]), P[np.ix_(chain, chain)], np.eye(3)[:1]
    for k in range(2, 80):
        t = dt[k]
        F = np.array([[1.0, t, t * t / 2], [0.0, 1.0, t], [0.0, 0.0, 1.0]])
        half = np.array(
            [[t**5 / 20, t**4 / 8, t**3 / 6], [t**4 / 8, t**3 / 3, t**2 / 2], [t**3 / 6, t**2 / 2, t]]
        )
        theirs.predict(F=F, Q=g.jerk**2 * half)
        theirs.update(u[k], R=g.noise**2)
        seen = observers.Measurement(u[k], 0.0)
        s = ukf.step(s, seen, seen, t, g)
        np.testing.assert_allclose([s.x, s.V, s.A], theirs.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(covariance(s)[np.ix_(chain, chain)], theirs.P, rtol=1e-9, atol=1e-9)


def test_the_mean_of_the_images_lies_inside_the_arc() -> None:
    """E[V t cos(e)] = V t exp(-var / 2) for a Gaussian error e of the course; the points have order four."""
    P = np.diag([1e-4, 1e-4, 1e-6, 1e-6, 0.04, 1e-12])
    s = state_of([0.0, 0.0, 10.0, 0.0, 0.0, 0.0], P)
    assert ukf.predict(s, 0.5, PLAIN).x == pytest.approx(5.0 * math.exp(-0.02), abs=5e-5)
    assert ukf.predict(s, 0.5, PLAIN._replace(mean=0.0)).x == pytest.approx(5.0, abs=1e-9)


# ------------------------------------------------------------------ whatever is measured

wild = st.one_of(st.floats(-1e3, 1e3), st.sampled_from([0.0, NAN, math.inf, -math.inf, 1e300, -1e300]))


@settings(max_examples=150)
@given(
    rows=st.lists(st.tuples(*[wild] * 7), min_size=1, max_size=8),
    dts=st.lists(st.floats(0.0, 100.0), min_size=8, max_size=8),
    mean=st.sampled_from([0.0, 1.0]),
)
def test_the_covariance_stays_positive(rows: Any, dts: Any, mean: float) -> None:
    truth, dt = drive(20)
    y = measured(truth[:, :2], truth[:, 4], 0.05, 0.02)
    y[8 : 8 + len(rows), :7] = rows
    dt[8 : 8 + len(rows)] = dts[: len(rows)]
    for state in run(y, dt, Gains(mean=mean))[1:]:
        assert np.isfinite(state).all()
        P = covariance(state)
        assert (P.diagonal() > 0.0).all()
        d = np.sqrt(P.diagonal())
        assert np.linalg.eigvalsh(P / np.outer(d, d))[0] > -1e-9


def test_the_yaw_may_pass_the_cut() -> None:
    """The same drive, turned so that its yaw crosses pi, gives the same estimate turned."""
    truth, dt = drive()
    assert np.abs(truth[:, 4] - 2.5).max() > 0.7
    y = measured(truth[:, :2], truth[:, 4], 0.05, 0.02)
    turned, R = y.copy(), np.array([[-1.0, 0.0], [0.0, -1.0]])
    turned[:, :2], turned[:, 5] = y[:, :2] @ R, y[:, 5] - math.pi
    turned[:, 5] = np.remainder(turned[:, 5] + np.pi, math.tau) - np.pi
    a, b = run(y, dt, Gains())[1:], run(turned, dt, Gains())[1:]
    np.testing.assert_allclose(b[:, :2], a[:, :2] @ R, atol=1e-9)
    np.testing.assert_allclose(b[:, [2, 3, 5]], a[:, [2, 3, 5]], atol=1e-9)
    np.testing.assert_allclose(np.cos(b[:, 4] - a[:, 4]), -1.0, atol=1e-9)


def test_a_missing_sample_costs_less_than_it_brings() -> None:
    truth, dt = drive()
    y = measured(truth[:, :2], truth[:, 4], 0.05, 0.02)
    y[40:50, 0] = NAN
    states = run(y, dt, Gains())
    spread = [sum(covariance(s).diagonal()[:2]) for s in states[39:51]]
    assert all(np.diff(spread[:-1]) > 0.0)
    assert spread[-1] < spread[-2]
    assert rms(states[60:, :2] - truth[60:, :2]) < 0.06


# ------------------------------------------------------------------ on the road


def test_the_heading_tells_reversing_and_speed_zero_is_no_border() -> None:
    t = np.arange(0.0, 12.0, 0.1)
    V = 4.0 - 0.8 * t
    x = 4.0 * t - 0.4 * t * t
    p = np.column_stack([x * np.cos(0.6), x * np.sin(0.6)])
    states = run(measured(p, 0.6, 0.02, 0.02), 0.1, Gains())
    assert np.abs(states[30:, 2] - V[30:]).max() < 0.5
    assert np.abs(states[30:, 4] - 0.6).max() < 0.06
    assert states[-1, 2] == pytest.approx(V[-1], abs=0.2)


def test_what_brakes_unseen_stops() -> None:
    s = state_of([0.0, 0.0, 5.0, -4.0, 0.0, 0.0], np.diag([0.01, 0.01, 0.1, 0.1, 0.001, 0.0001]))
    g = PLAIN._replace(mean=0.0)
    after = ukf.predict(s, 3.0, g)
    assert (after.x, after.V, after.A) == pytest.approx((3.125, 0.0, 0.0), abs=1e-9)
    sooner = ukf.predict(s, 0.5, g)
    assert (sooner.x, sooner.V) == pytest.approx((2.0, 3.0))


def test_huber_holds_an_outlier_off() -> None:
    truth, dt = drive()
    clean = measured(truth[:, :2], truth[:, 4], 0.05, 0.02)
    bad = clean.copy()
    bad[::15, 1] += 3.0
    off = {k: rms(run(bad, dt, Gains(huber=k))[20:, :2] - truth[20:, :2]) for k in (0.0, 2.0)}
    assert off[2.0] < 0.3 * off[0.0]
    assert rms(run(clean, dt, Gains(huber=2.0))[20:, :2] - truth[20:, :2]) < 0.06


def test_what_sets_off_backwards_is_turned_round() -> None:
    """Its front was not known: the first way says forward, unless it goes faster than anything reverses."""
    P = np.diag([0.01, 0.01, 0.1, 0.5, 0.01, 0.001])
    s = state_of([0.0, 0.0, -5.0, -1.0, 0.2, 0.05], P)
    y = observers.Measurement(-0.5 * math.cos(0.25), -0.5 * math.sin(0.25))
    after = ukf.motion(ukf.step(s, y, y, 0.1, Gains(heading=0.0)), Gains())
    assert after.speed == pytest.approx(5.0, abs=0.3)
    assert math.cos(after.course - 0.25 - math.pi) == pytest.approx(1.0, abs=1e-2)


def test_two_scans_later_more_is_known() -> None:
    truth, dt = drive(400)
    y = measured(truth[:, :2], truth[:, 4], 0.05, 0.02)
    g = Gains()
    states = run(y, dt, g)
    late = observers.lagged(ukf, states[None], dt[None], 2, g)[0]

    def error(s: np.ndarray) -> float:
        course = s[:, 4] + s[:, 5]
        v = s[:, 2:3] * np.column_stack([np.cos(course), np.sin(course)])
        chi = truth[:, 4] + truth[:, 5]
        return rms((v - truth[:, 2:3] * np.column_stack([np.cos(chi), np.sin(chi)]))[20:-2])

    assert error(late) < 0.8 * error(states)


def test_it_is_as_good_as_the_extended_filter() -> None:
    truth, dt = drive(400)
    y = measured(truth[:, :2], truth[:, 4], 0.05, 0.02)
    ours, theirs = run(y, dt, Gains()), run(y, dt, ekf.Gains(), ekf)
    np.testing.assert_allclose(ours[20:, :3], theirs[20:, :3], atol=0.02)
    assert rms(ours[20:, :2] - truth[20:, :2]) < 0.05


def test_its_covariance_is_honest() -> None:
    """Squared errors of position in its own deviations are 2 on average, as the noise is what it is told."""
    g = Gains(noise=0.1, jerk=1.0, slip=0.02, yaw=0.1, huber=0.0, coast=0.0, heading_noise=0.02)
    n, rng, squares = 80, np.random.default_rng(8), []
    for _ in range(30):
        s, rows = np.array([0.0, 0.0, 15.0, 0.0, 0.3, 0.0]), []
        for _ in range(n):
            Q = process_noise(s, 0.1, g)
            moved = np.array(bicycle.arc(bicycle.State(*s), 0.1, g.l_r))
            s = moved + np.linalg.cholesky(Q + 1e-15 * np.eye(6)) @ rng.normal(size=6)
            rows.append(s)
        truth = np.array(rows)
        y = measured(truth[:, :2], truth[:, 4])
        y[:, :2] += rng.normal(0.0, g.noise, (n, 2))
        y[:, 5] += rng.normal(0.0, g.heading_noise, n)
        y[:, 6] = 0.0
        for state, true in zip(run(y, 0.1, g)[30:], truth[30:], strict=True):
            e = state[:2] - true[:2]
            squares.append(e @ np.linalg.solve(covariance(state)[:2, :2], e))
    assert np.mean(squares) == pytest.approx(2.0, rel=0.15)


def test_the_innovation_and_the_spread_are_those_of_the_state() -> None:
    truth, dt = drive(40)
    g = Gains()
    s = State(*run(measured(truth[:, :2], truth[:, 4], 0.05, 0.02), dt, g)[-1])
    i = ukf.innovation(s, observers.Measurement(s.x + 1.0, s.y - 2.0, 0.01, 0.002, 0.03), g)
    least = max(g.noise**2, _bicycle.LEAST)
    assert (i.x, i.y) == pytest.approx((1.0, -2.0))
    assert (i.xx, i.xy, i.yy) == pytest.approx((s.xx + 0.01 + least, s.yx + 0.002, s.yy + 0.03 + least))
    rng = np.random.default_rng(2)
    drawn = rng.multivariate_normal(np.array(s)[:6], covariance(s), 200_000)
    course = drawn[:, 4] + drawn[:, 5]
    C = np.cov(drawn[:, 0], drawn[:, 2] * np.cos(course))
    c = ukf.spread(s, g)
    assert (c.xx, c.xu, c.uu) == pytest.approx((C[0, 0], C[0, 1], C[1, 1]), rel=0.05)
