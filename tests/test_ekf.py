"""The extended Kalman filter: against textbooks, FilterPy and closed forms, and what a road asks of it."""

import math
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from outrider import kernel, observers
from outrider.models import bicycle
from outrider.observers import Measurement, _bicycle, ekf
from outrider.observers.ekf import HIGH_NOISE, LOW_NOISE, Gains, State

NAN = float("nan")
PLAIN = Gains(huber=0.0, coast=0.0)
POSITION_ONLY = PLAIN._replace(heading=0.0)
SIZE = 6 + 2


def covariance(state: Any, n: int = 6) -> np.ndarray:
    """P (n, n) of a state or its row."""
    P = np.zeros((n, n))
    lower = np.tril_indices(n)
    P[lower] = np.array(state)[SIZE : SIZE + len(lower[0])]
    return P + np.tril(P, -1).T


def state_of(mean: Any, P: np.ndarray) -> State:
    """State with mean (6,) and covariance (6, 6), the measured point at the centre."""
    row = np.zeros(len(State._fields))
    row[:6] = mean
    row[SIZE : SIZE + 21] = P[np.tril_indices(6)]
    return kernel.from_row(State, row)


def measured(
    p: np.ndarray, yaw: Any = 0.0, sigma: float = 0.0, sigma_yaw: float = math.inf, seed: int = 0
) -> np.ndarray:
    """Measurements (n, 9) at p (n, 2) and yaw (n,), with noise and the deviations that it has."""
    rng = np.random.default_rng(seed)
    y = np.zeros((len(p), 9))
    y[:, :2] = p + rng.normal(0.0, 1.0, p.shape) * sigma
    y[:, 5] = yaw
    if sigma_yaw < math.inf:
        y[:, 5] += rng.normal(0.0, sigma_yaw, len(p))
    y[:, 2] = y[:, 4] = sigma**2
    y[:, 6] = sigma_yaw**2
    return y


def drive(n: int = 120, dt: float = 0.1, seed: int = 1) -> np.ndarray:
    """Rows (n, 6) of a bicycle that accelerates, brakes and turns at random."""
    rng = np.random.default_rng(seed)
    s, rows = bicycle.State(0.0, 0.0, 8.0, 0.0, 0.4, 0.0), []
    for _ in range(n):
        rows.append(s)
        A = 0.95 * s.A - 0.05 * (s.V - 9.0) + rng.normal(0.0, 0.3)
        beta = 0.97 * s.beta + rng.normal(0.0, 0.01)
        s = bicycle.arc(s._replace(A=A, beta=beta), dt)
    return np.array(rows)


def run(y: np.ndarray, dt: Any, gains: Gains) -> np.ndarray:
    """States (n, 44), rows before the start NaN."""
    return observers.batch(ekf, y[None], np.broadcast_to(dt, (1, len(y))), gains)[0]


def velocity(states: np.ndarray) -> np.ndarray:
    course = states[:, 4] + states[:, 5]
    return states[:, 2:3] * np.column_stack([np.cos(course), np.sin(course)])


def rms(e: Any) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(e), axis=-1))))


def jacobian(x: np.ndarray, dt: float, l_r: float) -> np.ndarray:
    """d arc / d x by complex steps, exact to rounding."""
    columns = []
    for i in range(6):
        z = x.astype(complex)
        z[i] += 1e-30j
        columns.append(np.imag(np.array(bicycle.arc(bicycle.State(*z), dt, l_r))) / 1e-30)
    return np.array(columns).T


def process_noise(x: np.ndarray, dt: float, g: Gains) -> np.ndarray:
    """Integral of responses to white noise at the mean speed, along and across the chord; A stays."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    V = x[2] + 0.5 * x[3] * dt
    course = x[4] + x[5] + 0.5 * (x[2] * dt + 0.5 * x[3] * dt**2) * np.sin(x[5]) / g.l_r
    c, s, B = np.cos(course), np.sin(course), V * np.cos(x[5]) / g.l_r
    Q = np.zeros((6, 6))
    for t, w in zip(0.5 * dt * (nodes + 1.0), 0.5 * dt * weights, strict=True):
        across = V * t + 0.5 * V * B * t * t
        jerk = np.array([c * t * t / 2, s * t * t / 2, t, 1.0, 0.0, 0.0])
        slip = np.array([-s * across, c * across, 0.0, 0.0, B * t, 1.0])
        yaw = np.array([-s * V * t, c * V * t, 0.0, 0.0, 1.0, 0.0])
        for q, column in ((g.jerk, jerk), (g.slip, slip), (g.yaw, yaw)):
            Q += w * q**2 * np.outer(column, column)
    return Q


@pytest.mark.parametrize("heading", [0.0, 1.0])
def test_it_is_the_filter_of_filterpy(heading: float) -> None:
    g = PLAIN._replace(heading=heading)
    truth, rng = drive(), np.random.default_rng(5)
    y = measured(truth[:, :2], truth[:, 4], 0.1, 0.03)
    y[:, 2:5] = 0.012, 0.003, 0.008
    dt = rng.uniform(0.05, 0.15, len(y))
    states = run(y, dt, g)
    theirs = ExtendedKalmanFilter(dim_x=6, dim_z=3 if heading else 2)
    theirs.x, theirs.P = states[1, :6].copy(), covariance(states[1])
    H = np.eye(6)[[0, 1, 4][: theirs.dim_z]]
    R = np.diag([0.012 + g.noise**2, 0.008 + g.noise**2, 0.03**2 + g.heading_noise**2])
    R[0, 1] = R[1, 0] = 0.003
    for k in range(2, len(y)):
        F, Q = jacobian(theirs.x, dt[k], g.l_r), process_noise(theirs.x, dt[k], g)
        theirs.x = np.array(bicycle.arc(bicycle.State(*theirs.x), dt[k], g.l_r))
        theirs.P = F @ theirs.P @ F.T + Q
        z = y[k, [0, 1, 5]][: theirs.dim_z]
        theirs.update(z, lambda x: H, lambda x: H @ x, R[: theirs.dim_z, : theirs.dim_z], residual=_residual)
        ours = states[k, :6].copy()
        ours[4] += math.tau * round((theirs.x[4] - ours[4]) / math.tau)
        np.testing.assert_allclose(ours, theirs.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(covariance(states[k]), theirs.P, rtol=1e-9, atol=1e-9)


def _residual(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    e = a - b
    e[2:] = np.remainder(e[2:] + np.pi, math.tau) - np.pi
    return e


def along(u: np.ndarray, dt: np.ndarray, g: Gains, first: State) -> tuple[KalmanFilter, Any, Any, Any, Any]:
    """FilterPy's filter of way, speed, acceleration on positions u (n,) along a line, from sample 1."""
    theirs = KalmanFilter(dim_x=3, dim_z=1)
    x, P = np.array([first.x, first.V, first.A]), covariance(first)[np.ix_([0, 2, 3], [0, 2, 3])]
    theirs.x, theirs.P, theirs.H, theirs.R = x, P, np.eye(3)[:1], np.array([[g.noise**2]])
    means, Ps, Fs, Qs = [theirs.x.copy()], [theirs.P.copy()], [np.eye(3)], [np.zeros((3, 3))]
    for k in range(2, len(u)):
        F, Q = _chain(dt[k], g)
        theirs.predict(F=F, Q=Q)
        theirs.update(u[k : k + 1])
        for kept, value in ((means, theirs.x), (Ps, theirs.P), (Fs, F), (Qs, Q)):
            kept.append(value.copy())
    return theirs, np.array(means), np.array(Ps), Fs, Qs


def _chain(t: float, g: Gains) -> tuple[np.ndarray, np.ndarray]:
    """Transition and noise over t [s] of way, speed, and acceleration that fades, by Van Loan's integral."""
    M = np.zeros((6, 6))
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / g.coast if g.coast else 0.0]])
    M[:3, :3], M[3:, 3:], M[2, 5] = -A, A.T, g.jerk**2
    E = expm(M * t)
    F = E[3:, 3:].T
    return F, F @ E[:3, 3:]


@pytest.mark.parametrize("coast", [0.0, 0.7])
def test_on_a_straight_road_it_is_the_kalman_filter_and_looks_back_as_rts(coast: float) -> None:
    g, rng = POSITION_ONLY._replace(coast=coast, jerk=3.0), np.random.default_rng(2)
    dt = rng.uniform(0.05, 0.3, 80)
    u = np.cumsum(10.0 * dt) + rng.normal(0.0, 0.15, 80)
    states = run(measured(np.column_stack([u, np.zeros(80)])), dt, g)
    keep = np.ix_([0, 2, 3], [0, 2, 3])
    first = kernel.from_row(State, states[1])
    theirs, means, Ps, Fs, Qs = along(u, dt, g, first)
    np.testing.assert_allclose(states[1:, [0, 2, 3]], means, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose([covariance(s)[keep] for s in states[1:]], Ps, rtol=1e-9, atol=1e-9)
    assert np.abs(states[1:, [1, 4, 5]]).max() < 1e-12
    back, P_back, *_ = theirs.rts_smoother(means, Ps, Fs, Qs)
    s = kernel.from_row(State, states[-1])
    for k in range(len(u) - 2, 0, -1):
        s = ekf.smooth(kernel.from_row(State, states[k]), s, float(dt[k + 1]), g)
        np.testing.assert_allclose([s.x, s.V, s.A], back[k - 1], rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(covariance(s)[keep], P_back[k - 1], rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("t", [1e-4, 0.08, 0.69, 0.71, 5.0, 60.0])
@pytest.mark.parametrize("coast", [0.0, 0.7, 200.0])
def test_noise_is_the_integral_over_any_time(t: float, coast: float) -> None:
    """Van Loan's integral of the linear system that the model is on a straight road."""
    g, V = Gains(coast=coast, jerk=2.0, slip=0.3, yaw=0.1), 1.5
    A = np.zeros((6, 6))
    A[0, 2] = A[2, 3] = 1.0
    A[1, 4] = A[1, 5] = V
    A[4, 5] = V / g.l_r
    A[3, 3] = -1.0 / coast if coast else 0.0
    M = np.block([[-A, np.diag([0.0, 0.0, 0.0, g.jerk**2, g.yaw**2, g.slip**2])], [np.zeros((6, 6)), A.T]])
    E, P = expm(M * t), np.zeros((6, 6))
    exact = E[6:, 6:].T @ E[:6, 6:] if t < 10.0 else None
    _bicycle.disturb(P, t, V, 1.0 / g.l_r, 1.0, 0.0, g)
    assert np.linalg.eigvalsh(P / np.sqrt(np.outer(P.diagonal(), P.diagonal()))).min() > 1e-4
    if exact is not None:
        np.testing.assert_allclose(P, exact, rtol=1e-5, atol=1e-12 * np.abs(exact).max())
    if coast == 0.7 and t == 60.0:
        assert P[3, 3] == pytest.approx(0.5 * coast * g.jerk**2)


def test_a_turning_world_and_an_arc_of_noise() -> None:
    """On a bend the noise is that of the chord's course: right to the square of the turn."""
    g, x = PLAIN, np.array([1.0, 2.0, 9.0, 1.0, 0.3, 0.1])
    s = ekf.predict(state_of(x, 1e-9 * np.eye(6)), 0.2, g)
    steps = state_of(x, 1e-9 * np.eye(6))
    for _ in range(50):
        steps = ekf.predict(steps, 0.004, g)
    assert np.array(s)[:6] == pytest.approx(np.array(steps)[:6], abs=1e-9)
    P, fine = covariance(s), covariance(steps)
    assert np.linalg.norm(P - fine) < 0.05 * np.linalg.norm(fine)


def test_a_braking_vehicle_stops_and_does_not_roll_back() -> None:
    for coast, way in ((0.0, 4.0), (2.0, None)):
        g = PLAIN._replace(coast=coast)
        s = ekf.predict(state_of([0.0, 0.0, 4.0, -2.0, 0.0, 0.0], 0.01 * np.eye(6)), 8.0, g)
        back = ekf.predict(state_of([0.0, 0.0, -4.0, 2.0, 0.0, 0.0], 0.01 * np.eye(6)), 8.0, g)
        if way:
            assert s.x == pytest.approx(way)
            assert (s.V, s.A) == (0.0, 0.0)
        assert s.V >= 0.0
        assert (back.x, back.V) == (-s.x, -s.V)
    far = ekf.predict(state_of([0.0, 0.0, 4.0, 2.0, 0.0, 0.0], 0.01 * np.eye(6)), 30.0, Gains(coast=2.0))
    assert pytest.approx(8.0, abs=1e-5) == far.V  # 4 + 2 * 2: the acceleration has faded


wild = st.one_of(st.floats(-1e3, 1e3), st.sampled_from([0.0, NAN, math.inf, 1e300, -1e300]))


@settings(max_examples=12)
@given(
    seed=st.integers(0, 2**32 - 1),
    hop=st.sampled_from([0.0, 0.3]),
    heading=st.sampled_from([0.0, 1.0]),
    noise=st.sampled_from([0.0, 0.02, 1.0]),
    odd=st.lists(st.tuples(*[wild] * 7), min_size=1, max_size=8),
)
def test_the_covariance_stays_positive_through_ten_thousand_samples(
    seed: int, hop: float, heading: float, noise: float, odd: Any
) -> None:
    rng, n = np.random.default_rng(seed), 10_000
    dt = np.exp(rng.uniform(np.log(1e-4), np.log(5.0), n))
    p = np.cumsum(rng.normal(0.0, 8.0, (n, 2)) * dt[:, None], axis=0)
    y = measured(p, rng.uniform(-np.pi, np.pi, n), 0.05, 0.1, seed)
    y[rng.random(n) < 0.05, :2] += rng.normal(0.0, 20.0, 2)
    y[rng.random(n) < 0.3, 6] = np.inf
    y[rng.random(n) < 0.3, 0] = np.nan
    at = rng.integers(10, n, (len(odd), 20))
    y[at, :7] = np.array(odd)[:, None]
    y[:10, :2] = p[:10]
    states = run(y, dt, Gains(hop=hop, heading=heading, noise=noise))
    assert np.isfinite(states[2:]).all()
    size = 8 if hop else 6
    P = np.array([covariance(s, size) for s in states[2:]])
    d = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    assert (d[:, :6] > 0.0).all()
    d[d == 0.0] = 1.0
    correlation = P / (d[:, :, None] * d[:, None, :])
    assert np.linalg.eigvalsh(correlation).min() > 0.0


def test_its_errors_are_as_large_as_it_says() -> None:
    """NEES of position and velocity, in a world like the model that never stops: 4 on average."""
    g, rng, runs, n, dt = PLAIN, np.random.default_rng(11), 60, 80, 0.1
    fine = 10
    y, truth = np.zeros((runs, n, 9)), np.zeros((runs, n, 6))
    for i in range(runs):
        s = bicycle.State(0.0, 0.0, 30.0, 0.0, rng.uniform(-3, 3), 0.0)
        for k in range(n):
            truth[i, k] = s
            for _ in range(fine):
                q = np.sqrt(dt / fine) * rng.normal(0.0, [g.jerk, g.slip, g.yaw])
                s = s._replace(A=s.A + q[0], beta=s.beta + q[1], psi=s.psi + q[2])
                s = bicycle.arc(s, dt / fine, g.l_r)
        y[i] = measured(truth[i, :, :2], truth[i, :, 4], 0.1, 0.05, seed=i)
        y[i, :, :2] += rng.normal(0.0, g.noise, (n, 2))
        y[i, :, 5] += rng.normal(0.0, g.heading_noise, n)
    states = observers.batch(ekf, y, np.full((runs, n), dt), g)
    nees = []
    for i in range(runs):
        e = np.hstack(
            [states[i, 20:, :2] - truth[i, 20:, :2], velocity(states[i, 20:]) - velocity(truth[i, 20:])]
        )
        for error, s in zip(e, states[i, 20:], strict=True):
            c = ekf.spread(kernel.from_row(State, s), g)
            P = np.array(
                [
                    [c.xx, c.xy, c.xu, c.xv],
                    [c.xy, c.yy, c.yu, c.yv],
                    [c.xu, c.yu, c.uu, c.uv],
                    [c.xv, c.yv, c.uv, c.vv],
                ]
            )
            nees.append(error @ np.linalg.solve(P, error))
    assert np.mean(nees) == pytest.approx(4.0, abs=0.5)


def test_the_spread_is_the_covariance_through_the_jacobian() -> None:
    rng = np.random.default_rng(3)
    B = rng.normal(size=(6, 6))
    P, x = B @ B.T, np.array([1.0, 2.0, 7.0, 1.0, 0.5, 0.1])
    J = np.zeros((4, 6))
    J[:2, :2] = np.eye(2)
    c, s = np.cos(0.6), np.sin(0.6)
    J[2], J[3] = [0, 0, c, 0, -7 * s, -7 * s], [0, 0, s, 0, 7 * c, 7 * c]
    chi = P[4:, 4:].sum()
    J2 = np.outer([0, 0, -s, c], [0, 0, -s, c]) * P[2, 2] * min(chi, 1.0)
    Q, got = J @ P @ J.T + J2, ekf.spread(state_of(x, P), PLAIN)
    want = [Q[0, 0], Q[0, 1], Q[1, 1], Q[0, 2], Q[1, 2], Q[2, 2], Q[0, 3], Q[1, 3], Q[2, 3], Q[3, 3]]
    assert np.array(got) == pytest.approx(np.array(want), rel=1e-12)
    i = ekf.innovation(state_of(x, P), Measurement(2.0, 4.0, 0.3, 0.1, 0.2), PLAIN)
    least = PLAIN.noise**2
    assert i == pytest.approx((1.0, 2.0, P[0, 0] + 0.3 + least, P[0, 1] + 0.1, P[1, 1] + 0.2 + least))


# ------------------------------------------------------------------ Huber, heading, beginnings


def test_huber_limits_what_an_outlier_does_and_says_so() -> None:
    truth = drive()
    y = measured(truth[:, :2], truth[:, 4], 0.1, 0.03)
    g = PLAIN._replace(huber=2.0)
    state = kernel.from_row(State, run(y[:60], 0.1, g)[-1])
    ahead = ekf.predict(state, 0.1, g)
    i = ekf.innovation(ahead, Measurement(*y[60]), g)
    S = np.array([[i.xx, i.xy], [i.xy, i.yy]])
    bad = y[60].copy()
    bad[:2] += 20.0
    shifted = ekf.step(state, Measurement(*y[59]), Measurement(*bad), 0.1, g._replace(heading=0.0))
    moved = np.array([shifted.x - ahead.x, shifted.y - ahead.y])
    P = covariance(ahead)[:2, :2]
    assert moved @ np.linalg.solve(P @ np.linalg.solve(S, P), moved) == pytest.approx(
        2.0**2
    )  # K of two deviations
    good = ekf.step(state, Measurement(*y[59]), Measurement(*y[60]), 0.1, g._replace(heading=0.0))
    assert good.xx < shifted.xx < ahead.xx
    assert np.array(good) == pytest.approx(
        np.array(ekf.step(state, Measurement(*y[59]), Measurement(*y[60]), 0.1, POSITION_ONLY))
    )
    flipped = y[60].copy()
    flipped[5] += np.pi
    turned = ekf.step(state, Measurement(*y[59]), Measurement(*flipped), 0.1, g)
    assert abs(turned.psi - ahead.psi) < 2.0 * math.sqrt(ahead.psi_psi)


def test_what_stood_is_followed_whichever_way_it_drives_off() -> None:
    """Position only: nothing tells the front of a standing car, so the first movement does."""
    still, go = np.zeros((50, 2)), np.cumsum(np.linspace(0.0, 0.8, 60))[:, None]
    for angle in np.linspace(-np.pi, np.pi, 16, endpoint=False):
        p = np.vstack([still, go * [np.cos(angle), np.sin(angle)]])
        m = ekf.motion(
            kernel.from_row(State, run(measured(p, 0.0, 0.05), 0.1, POSITION_ONLY)[-1]), POSITION_ONLY
        )
        assert math.remainder(m.yaw - angle, math.tau) == pytest.approx(0.0, abs=0.1)
        assert m.speed == pytest.approx(8.0, abs=0.5)
        assert (m.x, m.y) == pytest.approx(p[-1], abs=0.3)


def test_the_heading_tells_a_car_that_reverses() -> None:
    p = np.cumsum(np.full((60, 2), [-0.6, 0.0]), axis=0)
    with_heading = kernel.from_row(State, run(measured(p, 0.0, 0.02, 0.03), 0.1, Gains())[-1])
    assert pytest.approx(-6.0, abs=0.2) == with_heading.V
    assert with_heading.psi == pytest.approx(0.0, abs=0.05)
    without = kernel.from_row(State, run(measured(p, 0.0, 0.02, 0.03), 0.1, Gains(heading=0.0))[-1])
    assert pytest.approx(6.0, abs=0.2) == without.V


def test_turning_round_changes_the_front_and_no_motion() -> None:
    s = state_of([1.0, 2.0, -5.0, -1.0, 0.3, 0.1], np.diag([0.1, 0.1, 0.2, 0.3, 0.1, 0.01]))
    x, P = np.array([s[:6]]), covariance(s)
    _bicycle.turn_round(x, P)
    a, b = ekf.motion(s, PLAIN), ekf.motion(state_of(x[0], P), PLAIN)
    assert a.speed * np.exp(1j * a.course) == pytest.approx(b.speed * np.exp(1j * b.course))
    assert (b.speed, b.slip, b.yaw_rate) == pytest.approx((5.0, -0.1, a.yaw_rate))
    assert np.array(ekf.spread(state_of(x[0], P), PLAIN)) == pytest.approx(np.array(ekf.spread(s, PLAIN)))


def test_looking_back_lowers_the_error() -> None:
    truth = np.stack([drive(seed=k) for k in range(10)])
    y = np.stack([measured(t[:, :2], t[:, 4], 0.1, 0.03, seed=k) for k, t in enumerate(truth)])
    dt, g = np.full(y.shape[:2], 0.1), Gains(noise=0.02, jerk=1.5, heading_noise=0.01)
    states, errors = observers.batch(ekf, y, dt, g), []
    for lag in (0, 1, 2, 5):
        back = observers.lagged(ekf, states, dt, lag, g)[:, 20:100]
        errors.append(
            rms(np.stack([velocity(b) - velocity(t) for b, t in zip(back, truth[:, 20:100], strict=True)]))
        )
    assert errors[1] < 0.9 * errors[0]
    assert errors[2] < 0.9 * errors[1]
    assert errors[3] < errors[2]


# ------------------------------------------------------------------ hops

HOPS = Gains(noise=0.05, jerk=1.5, hop=0.25, hop_threshold=2.75)


def hopping(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Truth (n, 6), measurements of the centre (n, 9), and of a point that hops about the body."""
    truth, rng = drive(200, seed=seed), np.random.default_rng(seed)
    y = measured(truth[:, :2], truth[:, 4], 0.05, 0.03, seed)
    offset, z = np.zeros(2), y.copy()
    for k in range(len(z)):
        if rng.random() < 0.08:
            offset = rng.uniform(-1.0, 1.0, 2) * [0.8, 0.3]
        c, s = np.cos(truth[k, 4]), np.sin(truth[k, 4])
        z[k, :2] += [c * offset[0] - s * offset[1], s * offset[0] + c * offset[1]]
    return truth, y, z


def test_a_hop_of_the_measured_point_is_no_motion() -> None:
    plain, hop, clean, clean_hop, place, place_hop = [], [], [], [], [], []
    for seed in range(12):
        truth, y, z = hopping(seed)
        v = velocity(truth)[20:]
        a, b = run(z, 0.1, HOPS._replace(hop=0.0, huber=2.0)), run(z, 0.1, HOPS)
        c, d = run(y, 0.1, HOPS._replace(hop=0.0)), run(y, 0.1, HOPS)
        plain.append(rms(velocity(a)[20:] - v))
        hop.append(rms(velocity(b)[20:] - v))
        clean.append(rms(velocity(c)[20:] - v))
        clean_hop.append(rms(velocity(d)[20:] - v))
        place.append(rms(a[20:, :2] - truth[20:, :2]))
        place_hop.append(rms(b[20:, :2] - truth[20:, :2]))
        assert np.abs(b[1:, 6:8]).max() <= 3.0 * HOPS.hop
    assert np.mean(hop) < 0.6 * np.mean(plain)
    assert np.mean(clean_hop) < 1.1 * np.mean(clean)
    assert np.mean(place_hop) < np.mean(place)


def test_an_offset_is_forgotten_and_the_motion_kept_when_it_is_drawn_again() -> None:
    g = HOPS._replace(heading=0.0, huber=0.0)
    s = state_of([0.0, 0.0, 8.0, 0.0, 0.0, 0.0], np.diag([0.001, 0.001, 0.01, 0.01, 1e-4, 1e-4]))
    ahead, y = ekf.predict(s, 0.1, g), Measurement(0.8 + 0.6, 0.0, 1e-6, 0.0, 1e-6)
    hopped = ekf.step(s, y, y, 0.1, g)
    share = g.hop**2 / (g.hop**2 + ahead.xx + g.noise**2 + 1e-6)
    assert hopped.u == pytest.approx(0.6 * share)
    assert hopped.x == pytest.approx(ahead.x + 0.6 * ahead.xx * share / g.hop**2)
    assert abs(hopped.V - ahead.V) < 0.1
    later = ekf.predict(hopped, g.hop_time, g)
    assert (later.u, later.v) == pytest.approx((hopped.u / math.e, hopped.v / math.e))
    assert later.uu == pytest.approx(hopped.uu / math.e**2)


def test_without_hops_the_offset_is_not_there() -> None:
    truth = drive()
    states = run(measured(truth[:, :2], truth[:, 4], 0.1, 0.03), 0.1, Gains())
    assert not states[1:, 6:8].any()
    assert not states[1:, SIZE + 21 :].any()


# ------------------------------------------------------------------ the settings of the source


def test_a_low_noise_follows_the_sensor_and_a_high_one_the_model() -> None:
    truth, dt = drive(200, seed=4), 0.1
    y = measured(truth[:, :2], truth[:, 4], 0.2, 0.03)
    y[:, 2:5] = 0.0  # the settings alone say how good the sensor is
    low, high = run(y, dt, LOW_NOISE), run(y, dt, HIGH_NOISE)
    assert rms(low[50:, :2] - y[50:, :2]) < 0.6 * rms(high[50:, :2] - y[50:, :2])
    roughness = [rms(np.diff(velocity(s[50:]), axis=0)) for s in (low, high)]
    assert roughness[1] < 0.5 * roughness[0]
