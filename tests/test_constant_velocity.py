"""The constant-velocity observer: the poles it is given, its proof, the source's cases, and the road."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from outrider import observers
from outrider.geometry import wrap
from outrider.models import bicycle
from outrider.observers import Measurement, _constant_velocity_proof, constant_velocity
from outrider.observers.constant_velocity import DESIGNED, SECTOR, SLIP_MAX, SOURCE, Gains, State

TURNED = SOURCE._replace(switched=0.0)  # speed as given, gain that turns with the course


def rms(error: Any) -> float:
    return float(np.sqrt(np.mean(np.square(error))))


def rows(p: np.ndarray, sigma: float = 0.0) -> np.ndarray:
    """Measurements (..., 9) at positions (..., 2) [m]."""
    y = np.zeros((*p.shape[:-1], 9))
    y[..., :2], y[..., 2], y[..., 4], y[..., 6] = p, sigma**2, sigma**2, np.inf
    return y


def observe(y: np.ndarray, dt: float, gains: Gains) -> np.ndarray:
    """Motions (N, T, 8) from measurements (N, T, 9)."""
    s = observers.batch(constant_velocity, y, np.full(y.shape[:2], dt), gains)
    return observers.described(constant_velocity, s.reshape(-1, 7), gains).reshape(*y.shape[:2], 8)


def drive(V: float, A: float, steer: Any, dt: float, n: int, yaw: float = 0.0) -> np.ndarray:
    """Rows (n, 6) of the bicycle; slip at most 20 deg."""
    v, out = bicycle.State(0.0, 0.0, V, A, yaw, 0.0), []
    for k in range(n):
        v = v._replace(beta=min(float(bicycle.slip(steer((k + 0.5) * dt))), SLIP_MAX))
        out.append(v)
        v = bicycle.arc(v, dt)
    return np.array(out)


# ---------------------------------------------------------------- gains


@pytest.mark.parametrize("dt", [0.001, 0.05, 0.1, 0.25, 0.5])
@pytest.mark.parametrize("course", [0.0, 1.0, -2.5])
def test_a_step_has_the_poles_of_the_continuous_design(dt: float, course: float) -> None:
    """Of the whole step, by central differences about the truth, at the centre of the window."""
    g, h = TURNED, 1e-6
    A = np.zeros((4, 4))
    A[1, 2:], A[2, 3] = g.speed, g.speed / g.l_r
    L = np.array([[g.L_x, 0.0], [0.0, g.L_y], [0.0, g.L_psi], [0.0, g.L_beta]])
    wanted = np.exp(dt * np.linalg.eigvals(A - L @ np.eye(2, 4)))
    first = np.array([0.0, 0.0, course, 0.0])
    y = Measurement(g.speed * dt * math.cos(course), g.speed * dt * math.sin(course))

    def after(x: np.ndarray) -> np.ndarray:
        s = State(x[0], x[1], g.speed, 0.0, x[2], x[3], 0.0)
        s = constant_velocity.step(s, y, y, dt, g)
        return np.array([s.X, s.Y, s.psi, s.beta])

    J = np.column_stack([(after(first + h * e) - after(first - h * e)) / (2.0 * h) for e in np.eye(4)])
    assert np.poly(J) == pytest.approx(np.poly(wanted).real, abs=1e-6)
    assert np.abs(np.linalg.eigvals(J)).max() < 1.0


def test_design_gives_the_gain_that_is_kept() -> None:
    pytest.importorskip("clarabel")
    from outrider import design

    made = design.constant_velocity([10.0], math.radians(36.0), 0.5, rate=1.5, fastest=10.0)
    assert made.gain[:4] == pytest.approx(DESIGNED[:4], rel=1e-3)
    assert made.certificate.proven()


def one_step(course: float, ey: float, g: Gains) -> np.ndarray:
    """Correction (4,) of x, y, yaw, slip for an innovation of ey [m] across the y axis of W."""
    s, dt = State(0.0, 0.0, g.speed, 0.0, course, 0.0, 0.0), 0.1
    p = constant_velocity.predict(s, dt, g)
    y = Measurement(p.X, p.Y + ey)
    c = constant_velocity.step(s, y, y, dt, g)
    return np.array([c.X - p.X, c.Y - p.Y, c.psi - p.psi, c.beta - p.beta])


def test_switched_gain_is_constant_within_a_sector_and_the_turned_one_is_not() -> None:
    for middle in (0.0, SECTOR, -2.0 * SECTOR):
        courses = middle + SECTOR * np.array([-0.49, 0.0, 0.49])
        a, b, c = (one_step(v, 0.01, SOURCE) for v in courses)
        assert a == pytest.approx(b, abs=1e-12)
        assert c == pytest.approx(b, abs=1e-12)
        assert one_step(middle, 0.01, TURNED) == pytest.approx(b, abs=1e-12)
        assert np.abs(one_step(courses[0], 0.01, TURNED) - b).max() > 1e-4
        beyond = one_step(middle + 0.51 * SECTOR, 0.01, SOURCE)
        assert np.abs(beyond - b).max() > 1e-4


@settings(max_examples=30)
@given(st.floats(-3.0, 3.0), st.floats(-0.02, 0.02), st.floats(-3.0, 3.0))
def test_one_gain_serves_all_headings(course: float, ey: float, turn: float) -> None:
    """L(chi) = diag(R(chi), I) L0 R(chi)': in the frame of the course the correction is always the same."""
    g = TURNED
    s, dt = State(0.0, 0.0, g.speed, 0.0, course, 0.05, 0.0), 0.1
    p = constant_velocity.predict(s, dt, g)
    n = (-math.sin(p.psi + p.beta), math.cos(p.psi + p.beta))
    y = Measurement(p.X + ey * n[0], p.Y + ey * n[1])
    a = constant_velocity.step(s, y, y, dt, g)
    k = constant_velocity.sampled(dt, g)
    assert (a.X - p.X) * n[0] + (a.Y - p.Y) * n[1] == pytest.approx(k.y * ey, abs=1e-12)
    chi = wrap(a.psi + a.beta - p.psi - p.beta)
    assert chi == pytest.approx(k.chi * ey / g.speed, abs=1e-12)
    assert a.beta - p.beta == pytest.approx(k.beta * ey * g.l_r / g.speed**2, abs=1e-12)


# ---------------------------------------------------------------- proof


CERTIFICATE = constant_velocity.certificate()


@settings(max_examples=150)
@given(
    course=st.floats(-3.0, 3.0),
    slips=st.tuples(st.floats(-0.06, 0.06), st.floats(-0.06, 0.06)),
    error=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.9, 0.9)),
    dt=st.sampled_from((0.05, 0.1, 0.15, 0.2, 0.25)),
)
def test_the_true_error_decays_as_certified(
    course: float, slips: tuple[float, float], error: tuple[float, float, float], dt: float
) -> None:
    """A bicycle and the observer, course up to 50 deg wrong: e'Pe falls in each step, nothing linearised."""
    c, g, (window, turn) = CERTIFICATE, TURNED, (math.pi / 3.0, 1.0)
    V, pace = g.speed, _constant_velocity_proof.PACE
    S = np.array([1.0, 1.0, V * pace, (V * pace) ** 2 / g.l_r])
    true = bicycle.State(0.0, 0.0, V, 0.0, course - slips[0], slips[0])
    s = State(error[0], error[1], V, 0.0, course + error[2] - slips[1], slips[1], 0.0)

    def size(true: bicycle.State, s: State, frame: float) -> float:
        d, n = math.cos(frame), math.sin(frame)
        x, y = true.X - s.X, true.Y - s.Y
        chi = wrap(true.psi + true.beta - s.psi - s.beta)
        e = S * np.array([d * x + n * y, d * y - n * x, chi, true.beta - s.beta])
        return float(e @ c.P @ e)

    frame = s.psi + s.beta  # as if the last correction had not turned it
    for _ in range(4):
        moved = bicycle.arc(true, dt, g.l_r)
        p = constant_velocity.predict(s, dt, g)
        turned = wrap(p.psi + p.beta - frame)
        y = Measurement(moved.X, moved.Y)
        after = constant_velocity.step(s, y, y, dt, g)
        wrong = wrap(true.psi + true.beta - s.psi - s.beta)
        later = wrap(moved.psi + moved.beta - p.psi - p.beta)
        inside = max(abs(wrong), abs(later)) < window
        inside &= abs(turned) < turn * dt and abs(after.beta) < SLIP_MAX
        if not inside:
            break
        assert size(moved, after, p.psi + p.beta) <= c.rate**2 * size(true, s, frame) + 1e-15
        frame, true, s = p.psi + p.beta, moved, after


def test_a_wrong_proof_is_refused() -> None:
    c = constant_velocity.certificate()
    assert c.proven()
    assert not replace(c, rate=0.8).proven()
    assert not replace(c, P=np.eye(4)).proven()
    worse = DESIGNED._replace(L_psi=30.0)
    assert not constant_velocity.certificate(worse).proven()


# ---------------------------------------------------------------- the published cases


@pytest.mark.parametrize(
    ("V", "A", "steering_rate", "expected"),
    [
        (10.0, 0.0, 0.0, (0.04, 0.09, 0.64, 0.07)),
        (10.0, 0.0, 10.0, (0.07, 0.47, 0.86, 0.07)),
        (15.0, -1.0, -5.0, (0.36, 2.56, 1.55, 0.07)),
    ],
)
def test_published_cases(V: float, A: float, steering_rate: float, expected: Any) -> None:
    """5 s at 1 kHz from a heading 0.36 rad wrong, speed taken as 10 m/s: RMSE of position, V_x, V_y, psi."""
    dt = 0.001
    t = drive(V, A, lambda at: math.radians(steering_rate) * at, dt, 5001)
    y, run = rows(t[:, :2]), observers.stream(constant_velocity)
    now, index = np.array([[0.0, 0.0, 10.0, 0.0, 0.36, 0.0, 0.0]]), np.array([0])
    states = [now[0].copy()]
    for k in range(1, len(y)):
        run.step_all(now, y[k - 1 : k], y[k : k + 1], np.array([dt]), TURNED, index, now)
        states.append(now[0].copy())
    s, chi = np.array(states), t[:, 4] + t[:, 5]
    got = (
        rms(np.hypot(s[:, 0] - t[:, 0], s[:, 1] - t[:, 1])),
        rms(s[:, 2] * np.cos(s[:, 4] + s[:, 5]) - t[:, 2] * np.cos(chi)),
        rms(s[:, 2] * np.sin(s[:, 4] + s[:, 5]) - t[:, 2] * np.sin(chi)),
        rms(wrap(s[:, 4] - t[:, 4])),
    )
    assert got == pytest.approx(expected, rel=0.1, abs=0.02)


# ---------------------------------------------------------------- on the road


@pytest.mark.parametrize("gains", [SOURCE, TURNED, DESIGNED])
@pytest.mark.parametrize("dt", [0.02, 0.1, 0.25, 0.5])
def test_stable_at_any_heading_and_step(gains: Gains, dt: float) -> None:
    courses = np.linspace(-3.1, 3.1, 12)
    t = np.stack([drive(10.0, 0.0, lambda at: 0.0, dt, 400, c) for c in courses])
    m = observe(rows(t[..., :2]), dt, gains)[:, -1]
    assert m[:, :2] == pytest.approx(t[:, -1, :2], abs=1e-3)
    assert m[:, 2] == pytest.approx(10.0, abs=1e-2)
    assert np.abs(wrap(m[:, 5] - courses)).max() < 1e-3


def test_the_speed_is_as_given_or_estimated() -> None:
    dt = 0.1
    t = drive(4.0, 0.5, lambda at: 0.0, dt, 150)
    y = rows(t[None, :, :2])
    given, found = observe(y, dt, TURNED)[0, -1], observe(y, dt, DESIGNED)[0, -1]
    assert given[2:4] == pytest.approx((10.0, 0.0))
    assert found[2:4] == pytest.approx((t[-1, 2], 0.5), abs=0.01)
    assert found[0] == pytest.approx(t[-1, 0], abs=0.01)


@pytest.mark.parametrize("V", [6.0, -4.0])
def test_a_bend_forwards_and_backwards(V: float) -> None:
    """Slip, yaw and yaw rate on a circle, with and without the heading of the rectangle."""
    dt = 0.1
    t = drive(V, 0.0, lambda at: 0.25, dt, 200)
    y = rows(t[None, :, :2], 0.01)
    y[0, :, 5], y[0, :, 6] = t[:, 4], 0.02**2
    m = observe(y, dt, DESIGNED)[0, -1]
    beta = t[-1, 5]
    assert m[2] == pytest.approx(V, abs=0.1)
    assert wrap(m[5] - t[-1, 4]) == pytest.approx(0.0, abs=0.05)
    assert m[6] == pytest.approx(beta, abs=0.05)
    if V > 0.0:
        y[..., 6] = np.inf
        m = observe(y, dt, DESIGNED)[0, -1]
        assert wrap(m[5] - t[-1, 4]) == pytest.approx(0.0, abs=0.05)
        assert m[7] == pytest.approx(V * math.sin(beta) / 2.0, abs=0.05)


def test_stop_and_go() -> None:
    dt, at = 0.1, np.arange(0.0, 30.0, 0.1)
    speed = np.interp(at, [0, 5, 8, 14, 18, 30], [8, 8, 0, 0, 6, 6])
    p = np.column_stack([np.cumsum(speed) * dt, 0.0 * at])
    y = rows(p + np.random.default_rng(4).normal(0.0, 0.02, (20, len(at), 2)), 0.02)
    m = observe(y, dt, DESIGNED)
    assert rms(m[:, 110:138, 2]) < 0.3
    assert rms(m[:, 250:, 2] - 6.0) < 0.2
    assert np.abs(wrap(m[:, 20:, 5])).max() < 0.3


def test_one_wild_sample_moves_little_and_a_new_place_is_found() -> None:
    dt = 0.1
    p = np.arange(100)[:, None] * np.array([[0.8, 0.0]])
    once, moved = rows(p, 0.02), rows(p, 0.02)
    once[50, 1] += 20.0
    moved[50:, 1] += 20.0
    m = observe(np.stack([once, moved]), dt, DESIGNED)
    assert abs(m[0, 50, 1]) < 2.0
    assert np.hypot(m[0, 65:, 0] - p[65:, 0], m[0, 65:, 1]).max() < 0.6
    assert np.abs(m[1, 85:, 1] - 20.0).max() < 1.0


def test_coasting_is_the_arc_of_the_bicycle_with_fading_acceleration() -> None:
    g = Gains(coast=1e9)
    v = bicycle.State(1.0, 2.0, 6.0, 0.8, 0.1, 0.2)
    s = constant_velocity.predict(State(*v, 0.0), 1.5, g)
    arc = bicycle.arc(v, 1.5)
    assert (s.X, s.Y, s.V, s.psi) == pytest.approx((arc.X, arc.Y, arc.V, arc.psi), abs=1e-6)
    stop = constant_velocity.predict(State(0.0, 0.0, 3.0, -8.0, 0.0, 0.0, 0.0), 5.0, Gains())
    assert (stop.V, stop.A) == (0.0, 0.0)


def test_what_reverses_too_fast_is_turned_round() -> None:
    g = Gains()
    before = State(0.0, 0.0, -4.5, -0.5, 0.3, 0.1, 0.0)
    after = constant_velocity._limited(before, g, g.reverse)
    m, w = constant_velocity.motion(before, g), constant_velocity.motion(after, g)
    assert (w.speed, w.acceleration, w.yaw_rate) == pytest.approx((-m.speed, -m.acceleration, m.yaw_rate))
    assert abs(wrap(w.course - m.course)) == pytest.approx(math.pi)
    assert constant_velocity._limited(before, g, math.inf).V == -4.5


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 10_000), st.floats(0.0, 2.0))
def test_slip_and_speed_stay_within_their_limits(seed: int, sigma: float) -> None:
    rng = np.random.default_rng(seed)
    y = rows(np.cumsum(rng.normal(0.0, 1.5, (1, 60, 2)), axis=1), sigma)
    s = observers.batch(constant_velocity, y, np.full((1, 60), 0.1), DESIGNED)[0, 1:]
    assert np.abs(s[:, 5]).max() <= SLIP_MAX
    assert s[:, 2].min() >= -4.0
    assert s[:, 2].max() <= constant_velocity.V_MAX
