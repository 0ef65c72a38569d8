"""Interacting multiple models: against FilterPy, each motion alone, closed forms, and what a road asks."""

import math
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from outrider import kernel, observers
from outrider.observers import Measurement, _turning, imm
from outrider.observers.imm import Gains, State

pytestmark = pytest.mark.once

NAN = float("nan")
PLAIN = Gains(huber=0.0, heading=0.0)
AT = {name: i for i, name in enumerate(State._fields)}


def modes(state: Any, turn: float = 0.0) -> list[tuple[np.ndarray, np.ndarray]]:
    """Mean (5,) and covariance (5, 5) of both motions; straight: turn rate 0 of deviation `turn`."""
    s, out = np.array(state), []
    for first, n in ((0, 4), (14, 5)):
        x, P = np.zeros(5), np.zeros((5, 5))
        x[:n] = s[first : first + n]
        lower = np.tril_indices(n)
        P[lower] = s[first + n : first + n + len(lower[0])]
        P += np.tril(P, -1).T
        if n == 4:
            P[4, 4] = turn**2
        out.append((x, P))
    return out


def measured(p: np.ndarray, yaw: Any = 0.0, sigma: float = 0.0, sigma_yaw: float = math.inf) -> np.ndarray:
    """Measurements (n, 9) at p (n, 2) and yaw (n,), with noise and the deviations that it has."""
    rng = np.random.default_rng(5)
    y = np.zeros((len(p), 9))
    y[:, :2] = p + rng.normal(0.0, 1.0, p.shape) * sigma
    y[:, 5] = yaw + (rng.normal(0.0, sigma_yaw, len(p)) if sigma_yaw < math.inf else 0.0)
    y[:, 2] = y[:, 4] = sigma**2
    y[:, 6] = sigma_yaw**2
    return y


def drive(n: int = 120, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (n, 2), headings (n,) of what goes straight and turns by turns, time steps (n,) [s]."""
    rng = np.random.default_rng(seed)
    dt = rng.uniform(0.05, 0.15, n)
    w = np.where(np.arange(n) // 30 % 2, 0.5, 0.0)
    course = 2.5 + np.cumsum(w * dt)
    speed = 9.0 + np.cumsum(rng.normal(0.0, 0.1, n))
    step = (speed * dt)[:, None] * np.column_stack([np.cos(course), np.sin(course)])
    return np.cumsum(step, axis=0), course, dt


def circle(n: int = 150, V: float = 8.0, w: float = 0.4, l_r: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 2) of a bicycle's centre on a circle at 10 Hz, yaws (n,)."""
    course = w * 0.1 * np.arange(n)
    p = V / w * np.column_stack([np.sin(course), -np.cos(course)])
    return p, course - math.asin(l_r * w / V)


def run(y: np.ndarray, dt: Any, gains: Gains) -> np.ndarray:
    """States (n, 39), rows before the start NaN."""
    return observers.batch(imm, y[None], np.broadcast_to(dt, (1, len(y))), gains)[0]


def told(states: np.ndarray, gains: Gains) -> Any:
    """Motion as columns."""
    return observers.Motion(*observers.described(imm, states, gains).T)


def rms(e: Any) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(e), axis=-1))))


# ------------------------------------------------------------------ the two motions


def straight(t: float) -> np.ndarray:
    F = np.diag([1.0, 1.0, 1.0, 1.0, 0.0])
    F[0, 2] = F[1, 3] = t
    return F


def turned(x: Any, t: float) -> Any:
    """Coordinated turn of [x, y, u, v, w], which may be complex."""
    (S, C), c, s = chords(x[4], t), np.cos(x[4] * t), np.sin(x[4] * t)
    x1, y1 = x[0] + S * x[2] - C * x[3], x[1] + C * x[2] + S * x[3]
    return np.array([x1, y1, c * x[2] - s * x[3], s * x[2] + c * x[3], x[4]])


def chords(w: Any, t: float) -> tuple[Any, Any]:
    """sin(w t) / w and (1 - cos(w t)) / w."""
    return t * np.sinc(w * t / np.pi), 0.5 * w * t**2 * np.sinc(0.5 * w * t / np.pi) ** 2


def jacobian(x: np.ndarray, t: float) -> np.ndarray:
    """d turned / d x by complex steps, exact to rounding."""
    columns = []
    for i in range(5):
        z = x.astype(complex)
        z[i] += 1e-30j
        columns.append(np.imag(turned(z, t)) / 1e-30)
    return np.array(columns).T


def straight_noise(t: float, g: Gains) -> np.ndarray:
    Q = np.kron(g.straight**2 * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]]), np.eye(2))
    return np.block([[Q, np.zeros((4, 1))], [np.zeros((1, 4)), np.array([[g.turn**2]])]])


def turning_noise(x: np.ndarray, t: float, q: float, q_w: float) -> np.ndarray:
    """Integrals of the responses, `left` [s] before the end; that of the turn rate does not turn."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    Q, end, w = np.zeros((5, 5)), turned(x, t), x[4]
    mean = (end[:2] - x[:2]) / t
    for left, weight in zip(0.5 * t * (nodes + 1.0), 0.5 * t * weights, strict=True):
        (S, C), s, c = chords(w, left), np.sin(w * left), np.cos(w * left)
        A = np.array([[S, -C], [C, S], [c, -s], [s, c], [0, 0]])
        swerve = [-(left**2) / 2 * mean[1], left**2 / 2 * mean[0], -left * end[3], left * end[2], 1.0]
        Q += weight * (q**2 * A @ A.T + q_w**2 * np.outer(swerve, swerve))
    return Q


@pytest.mark.parametrize("w", [-1.3, 0.02, 0.0999, 0.4, 3.0])
def test_the_turn_is_exact(w: float) -> None:
    x, t = np.array([3.0, -2.0, 7.0, 4.0, w]), 0.7
    mean, P, F = x[None].copy(), np.zeros((5, 5)), np.zeros((5, 5))
    _turning.go_round(mean, P, F, t, 1.5, 0.6)
    np.testing.assert_allclose(mean[0], turned(x, t), rtol=1e-13)
    np.testing.assert_allclose(F, jacobian(x, t), rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(P, turning_noise(x, t, 1.5, 0.6), rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(P, P.T)


def test_the_turn_has_a_limit_at_turn_rate_zero() -> None:
    results = []
    for w in (0.0, 1e-9):
        mean, P, F = np.array([[3.0, -2.0, 7.0, 4.0, w]]), np.zeros((5, 5)), np.zeros((5, 5))
        _turning.go_round(mean, P, F, 0.3, 1.5, 0.6)
        results.append((mean, P, F))
    for a, b in zip(*results, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7)
    assert results[0][2][:2, 2:4] == pytest.approx(0.3 * np.eye(2))


def test_noise_of_two_halves_is_that_of_the_whole() -> None:
    x, t = np.array([0.0, 0.0, 7.0, 4.0, 0.8]), 0.6
    P, F, mean = np.zeros((5, 5)), np.zeros((5, 5)), x[None].copy()
    for _ in range(2):
        _turning.go_round(mean, P, F, t / 2, 1.5, 0.0)
    once = np.zeros((5, 5))
    _turning.go_round(x[None].copy(), once, F, t, 1.5, 0.0)
    np.testing.assert_allclose(P, once, rtol=1e-12, atol=1e-14)


# ------------------------------------------------------------------ the same as others


class Straight(KalmanFilter):  # type: ignore[misc]
    """FilterPy's linear filter with our gains; `t` [s], `heading` set from outside."""

    def predict(self, u: Any = None) -> None:
        self.x, self.P = self.go()
        seen_across(self, 0.0)

    def go(self) -> Any:
        F = straight(self.t)
        return F @ self.x, F @ self.P @ F.T + straight_noise(self.t, self.g)


class Turning(Straight):
    """An extended one."""

    def predict(self, u: Any = None) -> None:
        self.x, self.P = self.go()
        seen_across(self, self.g.l_r)

    def go(self) -> Any:
        F, g = jacobian(self.x, self.t), self.g
        Q = turning_noise(self.x, self.t, g.turning, g.turn_rate)
        return turned(self.x, self.t), F @ self.P @ F.T + Q


def seen_across(f: Any, l_r: float) -> None:
    """H and R of the position and, with a heading, of the velocity across the rear axle."""
    f.H = np.eye(5)[:2]
    f.R = f.R_p
    if f.g.heading:
        c, s = np.cos(f.heading), np.sin(f.heading)
        f.H = np.vstack([f.H, [0.0, 0.0, -s, c, -l_r]])
        ahead = f.x[2:4] @ [c, s]
        r = (ahead**2 + [c, s] @ f.P[2:4, 2:4] @ [c, s]) * (0.03**2 + f.g.heading_noise**2)
        f.R = np.block([[f.R_p, np.zeros((2, 1))], [np.zeros((1, 2)), np.array([[max(r, 0.01)]])]])


def filters(state: np.ndarray, g: Gains, outputs: int) -> list[Any]:
    out = []
    for kind, (x, P) in zip((Straight, Turning), modes(state, g.turn), strict=True):
        f = kind(dim_x=5, dim_z=outputs)
        f.x, f.P, f.g = x, P, g
        f.R_p = np.array([[0.012, 0.003], [0.003, 0.008]]) + g.noise**2 * np.eye(2)
        out.append(f)
    return out


def transition(t: float, g: Gains) -> np.ndarray:
    return expm(t * np.array([[-g.begin, g.begin], [g.end, -g.end]]))


@pytest.mark.parametrize("heading", [0.0, 1.0])
def test_it_is_the_estimator_of_filterpy(heading: float) -> None:
    g = PLAIN._replace(heading=heading, begin=0.8, end=0.5)
    p, course, dt = drive()
    y = measured(p, course, 0.1, 0.03)
    y[:, 2:5] = 0.012, 0.003, 0.008
    states = run(y, dt, g)
    fs = filters(states[1], g, 3 if heading else 2)
    p_turning = states[1, AT["turning"]]
    theirs = IMMEstimator(fs, [1.0 - p_turning, p_turning], np.eye(2))
    for k in range(2, len(y)):
        for f in fs:
            f.t, f.heading = dt[k], y[k, 5]
        theirs.M = transition(dt[k], g)
        theirs._compute_mixing_probabilities()
        theirs.predict()
        theirs.update(np.r_[y[k, :2], 0.0][: fs[0].dim_z])
        s = states[k]
        assert s[AT["turning"]] == pytest.approx(theirs.mu[1], rel=1e-9, abs=1e-12)
        for f, (x, P) in zip(fs, modes(s, g.turn), strict=True):
            np.testing.assert_allclose(x, f.x, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(P, f.P, rtol=1e-9, atol=1e-9)
        c = np.array(imm.spread(State(*s), g))
        np.testing.assert_allclose(c, theirs.P[:4, :4][np.tril_indices(4)], rtol=1e-8, atol=1e-9)
        m = told(s[None], g)
        np.testing.assert_allclose([m.x[0], m.y[0]], theirs.x[:2], rtol=1e-9)
        v = m.speed[0] * np.array([np.cos(m.course[0]), np.sin(m.course[0])])
        np.testing.assert_allclose(v, theirs.x[2:4], rtol=1e-9, atol=1e-9)
    turning = states[2:, AT["turning"]]
    assert np.ptp(turning) > 0.2


@pytest.mark.parametrize("motion", [0, 1])
def test_one_certain_motion_is_that_filter_alone(motion: int) -> None:
    g = PLAIN._replace(begin=0.0, end=0.0)
    p, _, dt = drive()
    y = measured(p, 0.0, 0.1)
    y[:, 2:5] = 0.012, 0.003, 0.008
    rows = [Measurement(*row) for row in y]
    s = imm.start(rows[0], rows[1], dt[1], g)._replace(turning=float(motion))
    alone = filters(np.array(s), g, 2)[motion]
    xs, Ps, states = [alone.x], [alone.P], [s]
    for k in range(2, len(y)):
        s = imm.step(s, rows[k - 1], rows[k], dt[k], g)
        alone.t = dt[k]
        alone.predict()
        alone.update(y[k, :2])
        x, P = modes(s, g.turn)[motion]
        np.testing.assert_allclose(x, alone.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(P, alone.P, rtol=1e-9, atol=1e-9)
        assert s.turning == motion
        xs, Ps, states = [*xs, alone.x], [*Ps, alone.P], [*states, s]
    x, P, later = xs[-1], Ps[-1], states[-1]  # and back: Rauch, Tung and Striebel
    for k in range(len(xs) - 2, -1, -1):
        alone.x, alone.P, alone.t = xs[k], Ps[k], dt[k + 2]
        F = jacobian(xs[k], dt[k + 2]) if motion else straight(dt[k + 2])
        n, N = alone.go()
        K = Ps[k] @ F.T @ np.linalg.inv(N)
        x, P = xs[k] + K @ (x - n), Ps[k] + K @ (P - N) @ K.T
        later = imm.smooth(states[k], later, dt[k + 2], g)
        ours = modes(later, g.turn)[motion]
        n = 5 if motion else 4
        np.testing.assert_allclose(ours[0][:n], x[:n], rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(ours[1][:n, :n], P[:n, :n], rtol=1e-7, atol=1e-8)


def test_looking_back_sums_over_all_pairs_of_motions() -> None:
    """Kim 1994, written out: one step back for each pair, weights by Bayes, moments summed."""
    g = PLAIN._replace(begin=0.8, end=0.5)
    p, _, dt = drive(60)
    states = run(measured(p, 0.0, 0.1), dt, g)
    for k in (20, 45):
        now, later, t = states[k], states[k + 1], dt[k + 1]
        mu = np.array([1.0 - now[AT["turning"]], now[AT["turning"]]])
        nu = np.array([1.0 - later[AT["turning"]], later[AT["turning"]]])
        M = transition(t, g)
        joint = mu[:, None] * M / (mu @ M) * nu  # motion now, motion later
        ours = imm.smooth(State(*now), State(*later), t, g)
        assert ours.turning == pytest.approx(joint[1].sum(), rel=1e-9)
        assert joint.sum() == pytest.approx(1.0)
        for i, (x, P) in enumerate(modes(now, g.turn)):
            means, covariances = [], []
            for j, (z, Z) in enumerate(modes(later, g.turn)):
                f = filters(now, g, 2)[j]
                f.x, f.P, f.t = x, P, t
                F = jacobian(x, t) if j else straight(t)
                n, N = f.go()
                K = P @ F.T @ np.linalg.inv(N)
                means.append(x + K @ (z - n))
                covariances.append(P + K @ (Z - N) @ K.T)
            w = joint[i] / joint[i].sum()
            mean = w[0] * means[0] + w[1] * means[1]
            C = sum(w[j] * (covariances[j] + np.outer(means[j] - mean, means[j] - mean)) for j in range(2))
            n = 5 if i else 4
            got = modes(ours, g.turn)[i]
            np.testing.assert_allclose(got[0][:n], mean[:n], rtol=1e-8, atol=1e-8)
            np.testing.assert_allclose(got[1][:n, :n], C[:n, :n], rtol=1e-7, atol=1e-8)


@given(st.floats(0.0, 5.0), st.floats(0.0, 5.0), st.floats(0.0, 3.0), st.floats(0.0, 3.0))
def test_changes_of_motion_do_not_depend_on_how_often_one_looks(
    a: float, b: float, begin: float, end: float
) -> None:
    g = Gains(begin=begin, end=end)

    def M(t: float) -> np.ndarray:
        p, q = imm._changes(t, g)
        return np.array([[1.0 - p, p], [q, 1.0 - q]])

    np.testing.assert_allclose(M(a) @ M(b), M(a + b), atol=1e-12)
    np.testing.assert_allclose(M(a), transition(a, g), atol=1e-9)


# ------------------------------------------------------------------ whatever is measured

wild = st.one_of(st.floats(-1e3, 1e3), st.sampled_from([0.0, NAN, math.inf, -math.inf, 1e300, -1e300]))


@settings(max_examples=150)
@given(
    rows=st.lists(st.tuples(*[wild] * 7), min_size=1, max_size=8),
    dts=st.lists(st.floats(0.0, 100.0), min_size=8, max_size=8),
)
def test_probabilities_and_covariances_stay_what_they_are(rows: Any, dts: Any) -> None:
    p, course, dt = drive(20)
    y = measured(p, course, 0.05, 0.02)
    y[8 : 8 + len(rows), :7] = rows
    dt[8 : 8 + len(rows)] = dts[: len(rows)]
    for state in run(y, dt, Gains())[1:]:
        assert np.isfinite(state).all()
        assert 0.0 <= state[AT["turning"]] <= 1.0
        assert state[AT["psi_psi"]] > 0.0
        for _, P in modes(state, 0.1):
            assert (P.diagonal() > 0.0).all()
            d = np.sqrt(P.diagonal())
            assert np.linalg.eigvalsh(P / np.outer(d, d))[0] > -1e-9


def test_a_sample_of_another_world_decides_nothing() -> None:
    """Both motions find it impossible: what they were is not forgotten."""
    p, _, dt = drive(40)
    y = measured(p, 0.0, 0.05)
    y[35, :2] += 1e6
    states = run(y, dt, PLAIN)
    assert np.isfinite(states[1:]).all()
    assert 0.0 < states[35, AT["turning"]] < 1.0
    holds = run(y, dt, PLAIN._replace(huber=3.0))
    assert rms(holds[39, :2] - p[39]) < 0.01 * rms(states[39, :2] - p[39])


# ------------------------------------------------------------------ on the road


def test_it_knows_a_turn_from_a_straight_road() -> None:
    w = np.repeat([0.0, 0.5, 0.0], 80)
    course = np.cumsum(0.1 * w)
    p = np.cumsum(0.9 * np.column_stack([np.cos(course), np.sin(course)]), axis=0)
    g = Gains(heading=0.0, straight=1.0, turning=1.0, begin=0.1, end=0.3)
    states = run(measured(p, 0.0, 0.02), 0.1, g)
    turning, rate = states[:, AT["turning"]], told(states, g).yaw_rate
    assert turning[50:80].mean() < 0.4
    assert turning[100:160].mean() > 0.9
    assert turning[210:].mean() < 0.5
    assert rate[120:160] == pytest.approx(0.5, abs=0.15)
    assert rate[210:] == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("heading", [0.0, 1.0])
def test_the_yaw_on_a_circle_is_the_course_less_the_slip(heading: float) -> None:
    p, yaw = circle()
    g = Gains(heading=heading)
    m = told(run(measured(p, yaw, 0.01, 0.01), 0.1, g), g)
    error = np.remainder(m.yaw - yaw + np.pi, math.tau) - np.pi
    assert rms(error[50:, None]) < 0.03
    assert m.slip[50:].mean() == pytest.approx(math.asin(2.0 * 0.4 / 8.0), abs=0.02)
    course = told(run(measured(p, yaw, 0.01), 0.1, g._replace(l_r=0.0)), g._replace(l_r=0.0))
    assert abs(course.slip[50:].mean()) < 0.01


def test_the_heading_tells_reversing_and_speed_zero_is_no_border() -> None:
    t = np.arange(0.0, 12.0, 0.1)
    x = 4.0 * t - 0.4 * t * t
    p = np.column_stack([x * np.cos(0.6), x * np.sin(0.6)])
    m = told(run(measured(p, 0.6, 0.02, 0.02), 0.1, Gains()), Gains())
    assert np.abs(m.speed[10:] - (4.0 - 0.8 * t[10:])).max() < 0.6
    assert np.abs(m.yaw[10:] - 0.6).max() < 0.06
    assert m.acceleration[30:].mean() == pytest.approx(-0.8, abs=0.1)


def test_what_reverses_faster_than_any_vehicle_is_turned_round() -> None:
    p = np.column_stack([-np.arange(40) * 0.8, np.zeros(40)])
    y = measured(p, 0.0, 0.02, 0.02)
    y[2:, 6] = math.inf  # the heading is told at first only, and was the wrong end
    m = told(run(y, 0.1, Gains()), Gains())
    assert m.speed[-1] == pytest.approx(8.0, abs=0.2)
    assert abs(m.yaw[-1]) == pytest.approx(math.pi, abs=0.05)


def test_acceleration_is_the_slope_of_the_speed_however_it_is_sampled() -> None:
    t = np.arange(0.0, 8.0, 0.1)
    p = np.column_stack([5.0 * t + t * t, np.zeros_like(t)])
    g = Gains()
    y = measured(p, 0.0, 0.0, 0.02)
    m = told(run(y, 0.1, g), g)
    assert m.acceleration[40:] == pytest.approx(2.0, abs=0.1)
    gappy = y.copy()
    gappy[60:63, 0] = NAN
    kept = np.r_[0:60, 63 : len(t)]
    skipped = told(run(y[kept], np.diff(t[kept], prepend=-0.1), g), g)
    after = told(run(gappy, 0.1, g), g).acceleration[63]
    assert after == pytest.approx(skipped.acceleration[60], abs=0.05)
    assert after == pytest.approx(2.0, abs=0.4)


def test_huber_holds_an_outlier_off() -> None:
    p, course, dt = drive()
    clean = measured(p, course, 0.05, 0.02)
    bad = clean.copy()
    bad[::15, 1] += 3.0

    def off(y: np.ndarray, k: float) -> float:
        g = Gains(huber=k)
        m = told(run(y, dt, g), g)
        return rms(np.column_stack([m.x, m.y])[20:] - p[20:])

    assert off(bad, 2.0) < 0.4 * off(bad, 0.0)
    assert off(clean, 2.0) < 0.06


def test_two_scans_later_more_is_known() -> None:
    p, course, dt = drive(400)
    g = Gains()
    states = run(measured(p, course, 0.05, 0.02), dt, g)
    late = observers.lagged(imm, states[None], dt[None], 2, g)[0]
    v = np.gradient(p[:, 0], np.cumsum(dt)), np.gradient(p[:, 1], np.cumsum(dt))

    def errors(s: np.ndarray) -> tuple[float, float]:
        m = told(s, g)
        e = m.speed * np.cos(m.course) - v[0], m.speed * np.sin(m.course) - v[1]
        yaw = np.remainder(m.yaw - course + np.pi, math.tau) - np.pi
        return rms(np.column_stack(e)[20:-3]), rms(yaw[20:-3, None])

    before, after = errors(states), errors(late)
    assert after[0] < 0.8 * before[0]
    assert after[1] < 1.1 * before[1]


def test_gains_can_be_read_from_the_state() -> None:
    """What is packed is what is told: no field is lost on the way through a row."""
    row = np.arange(1.0, 40.0) / 40.0
    s = kernel.from_row(State, row)
    assert list(s) == pytest.approx(row.tolist())
    assert imm.innovation(s, Measurement(1.0, 2.0), Gains()).xx > 0.0
