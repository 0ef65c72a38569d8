"""The high-gain observer: what the paper claims, what is wrong in it, and what it does on the road."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from outrider import kernel, observers
from outrider.geometry import wrap
from outrider.models import bicycle
from outrider.observers import Measurement, high_gain
from outrider.observers._sampled import chain_gains
from outrider.observers.high_gain import DESIGNED, PUBLISHED, Gains, State

pytestmark = pytest.mark.once

F = np.kron(np.eye(2), np.eye(3, k=1))
H = np.kron(np.eye(2), np.eye(1, 3))
L = np.array([67.20, 823.1, 2818.5])
THETA = 6.7205
FREE = high_gain.Free(0.0)


def rms(error: Any) -> float:
    return float(np.sqrt(np.mean(np.square(error))))


def gain(l: Any) -> np.ndarray:
    return np.kron(np.eye(2), np.reshape(l, (3, 1)))


def rows(p: np.ndarray, sigma: float = 0.0) -> np.ndarray:
    """Measurements (..., 9) at positions (..., 2) [m]."""
    y = np.zeros((*p.shape[:-1], 9))
    y[..., :2], y[..., 2], y[..., 4], y[..., 6] = p, sigma**2, sigma**2, np.inf
    return y


def observe(y: np.ndarray, dt: float, gains: Gains) -> np.ndarray:
    """Motions (N, T, 8) from measurements (N, T, 9)."""
    s = observers.batch(high_gain, y, np.full(y.shape[:2], dt), gains)
    return observers.described(high_gain, s.reshape(-1, s.shape[-1]), gains).reshape(*y.shape[:2], 8)


def f(z: np.ndarray) -> np.ndarray:
    """[HG 58] as printed, for states (..., 6)."""
    c = (z[..., 5] * z[..., 1] - z[..., 2] * z[..., 4]) / (z[..., 1] ** 2 + z[..., 4] ** 2)
    return np.stack(
        [
            -3.0 * z[..., 5] * c + 2.0 * z[..., 1] * c**2,
            3.0 * z[..., 2] * c + 2.0 * z[..., 4] * c**2,
        ],
        axis=-1,
    )


# ---------------------------------------------------------------- errata


def test_the_printed_K_is_unstable_and_the_printed_L_is_not() -> None:
    """E1: L divided by powers of theta is another K."""
    printed = np.linalg.eigvals(F - gain([11.73, 20.25, -7.3]) @ H)
    assert printed.real.max() == pytest.approx(0.305, abs=0.001)
    K = L / THETA ** np.arange(1, 4)
    assert pytest.approx([10.00, 18.22, 9.286], abs=0.01) == K
    assert np.linalg.eigvals(F - gain(K) @ H).real.max() < -0.5
    assert np.linalg.eigvals(F - gain(L) @ H).real.max() == pytest.approx(
        THETA * np.linalg.eigvals(F - gain(K) @ H).real.max()
    )


def closed_form_jacobian(k: float, a: float, V: float) -> np.ndarray:
    """df / d(z2, z3, z5, z6) in the frame of the velocity; k course rate, a acceleration along the course."""
    return np.array(
        [
            [k**2, 0.0, -a * k / V, -2.0 * k],
            [-3.0 * a * k / V, 3.0 * k, 2.0 * k**2 - 3.0 * a**2 / V**2, 3.0 * a / V],
        ]
    )


@settings(max_examples=30)
@given(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0), st.floats(2.5, 20.0))
def test_jacobian_has_terms_in_acceleration_over_speed(k: float, a: float, V: float) -> None:
    """E3: of the model that runs, by central differences, against the closed form."""
    g, z, h = Gains(c_max=100.0), np.array([0.0, V, a, 0.0, 0.0, V * k]), 1e-5

    def jerk(z: np.ndarray) -> np.ndarray:
        d = high_gain.rhs(State(*z, 0.0, 0.0), FREE, g)
        return np.array([d.ddX, d.ddY])

    assert jerk(z) == pytest.approx(f(z), rel=1e-12, abs=1e-12)
    J = np.column_stack([(jerk(z + h * e) - jerk(z - h * e)) / (2.0 * h) for e in np.eye(6)])
    assert J[:, [1, 2, 4, 5]] == pytest.approx(closed_form_jacobian(k, a, V), abs=1e-5)
    assert J[:, [0, 3]] == pytest.approx(0.0, abs=1e-9)


def test_beyond_a_ratio_of_acceleration_to_speed_no_proof_is_possible() -> None:
    """E3: the frozen error matrix of the published gain, going straight."""

    def worst(ratio: float) -> float:
        A = F - gain(L) @ H
        A[np.ix_([2, 5], [1, 2, 4, 5])] += closed_form_jacobian(0.0, ratio, 1.0)
        return float(np.linalg.eigvals(A).real.max())

    assert worst(1.25) < 0.0 < worst(1.29)
    r = min(np.roots([3.0 * L[0], -3.0 * L[1], L[2]]).real)  # 2818.5 - 3 r 823.1 + 3 r^2 67.2 = 0
    assert r == pytest.approx(1.27, abs=0.02)
    assert worst(-2.0) < 0.0  # braking does no harm
    assert worst(1.0 / 0.5) > 0.0  # V >= 0.5 with |A| <= 1


def test_f_as_printed_overflows_and_the_saturated_does_not() -> None:
    """E4: a wrong start, V near 0."""
    g, dt, z = PUBLISHED, 0.1, np.array([0.0, 0.01, 3.0, 0.0, 0.0, 3.0])
    s = State(*z, 0.0, 0.0)
    l = gain(chain_gains(*L, dt))
    printed_is_lost = False
    with np.errstate(all="ignore"):
        for _ in range(100):
            h = dt / 4
            for _ in range(4):
                z = z + h * (F @ z + np.kron(f(z), [0.0, 0.0, 1.0]))
            z = z - l @ (H @ z)
            printed_is_lost |= not bool((np.abs(z) < 1e6).all())
    for _ in range(100):
        s = high_gain.step(s, Measurement(0.0, 0.0), Measurement(0.0, 0.0), dt, g)
    assert printed_is_lost
    assert np.abs(s[:6]).max() < 1e-3


def continuous(y: np.ndarray, dt: float, first: np.ndarray, interpolate: bool) -> np.ndarray:
    """[HG 59] integrated by RK4 in 20 steps a sample; states (n, T, 6), measured y (n, T, 2)."""
    z, out, h, M = np.tile(first, (len(y), 1)), [], dt / 20, gain(L)

    def rhs(z: np.ndarray, m: np.ndarray) -> np.ndarray:
        return z @ F.T + np.kron(f(z), [0.0, 0.0, 1.0]) + (m - z @ H.T) @ M.T

    for k in range(y.shape[1] - 1):
        out.append(z)
        slope = (y[:, k + 1] - y[:, k]) / dt * interpolate
        for i in range(20):
            m = [y[:, k] + slope * h * (i + part) for part in (0.0, 0.5, 1.0)]
            k1 = rhs(z, m[0])
            k2 = rhs(z + 0.5 * h * k1, m[1])
            k3 = rhs(z + 0.5 * h * k2, m[1])
            z = z + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rhs(z + h * k3, m[2]))
    return np.stack([*out, z], axis=1)


def test_held_outputs_ruin_it_and_sampling_does_not() -> None:
    """E10: 10 Hz, 2 cm noise, a car that speeds up; RMSE of the velocity per axis, and of explicit Euler."""
    dt, at = 0.1, np.arange(0.0, 10.0, 0.1)
    v = 4.0 + 0.5 * at
    p = np.column_stack([4.0 * at + 0.25 * at**2, 0.0 * at])
    y = p + np.random.default_rng(0).normal(0.0, 0.02, (10, len(at), 2))
    first = np.array([0.0, 4.0, 0.5, 0.0, 0.0, 0.0])
    kept = slice(20, None)
    error = {}
    for name, line in (("held", False), ("line", True)):
        z = continuous(y, dt, first, line)[:, kept]
        error[name] = rms([z[..., 1] - v[kept], z[..., 4]])
    m = observe(rows(y), dt, PUBLISHED)[:, kept]
    error["sampled"] = rms([m[..., 2] * np.cos(m[..., 4]) - v[kept], m[..., 2] * np.sin(m[..., 4])])
    assert error["held"] > 2.0
    assert error["line"] == pytest.approx(0.19, rel=0.15)
    assert error["sampled"] == pytest.approx(0.22, rel=0.15)
    euler = np.eye(6) + dt * (F - gain(L) @ H)
    assert np.abs(np.linalg.eigvals(euler)).max() == pytest.approx(4.3, abs=0.05)


# ---------------------------------------------------------------- sampled form


def test_sampled_gain_of_the_published_design() -> None:
    assert chain_gains(*L, 0.1) == pytest.approx((0.9988, 9.00, 26.8), rel=1e-3)


poles = st.one_of(
    st.tuples(*[st.floats(0.05, 60.0)] * 3).map(lambda p: [-complex(v) for v in p]),
    st.tuples(*[st.floats(0.05, 40.0)] * 3).map(
        lambda p: [complex(-p[0]), complex(-p[1], p[2]), complex(-p[1], -p[2])]
    ),
    st.floats(0.1, 50.0).map(lambda p: [complex(-p)] * 3),
)


@given(poles, st.floats(1e-3, 1.0))
def test_poles_of_the_sampled_chain_are_those_of_the_continuous_one(p: list[complex], dt: float) -> None:
    l = chain_gains(*np.poly(p).real[1:], dt)
    E = np.array([[1.0, dt, 0.5 * dt**2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    closed = (np.eye(3) - np.outer(l, [1.0, 0.0, 0.0])) @ E
    wanted = np.poly(np.exp(np.array(p) * dt)).real
    assert np.poly(closed) == pytest.approx(wanted, rel=1e-6, abs=1e-9)


def test_sampled_gain_tends_to_the_continuous_one() -> None:
    for l, big in zip(chain_gains(*L, 1e-7), L, strict=True):
        assert l / 1e-7 == pytest.approx(big, rel=1e-4)
    assert all(math.isfinite(l) for l in chain_gains(*L, 1e-300))


# ---------------------------------------------------------------- transformation


@given(st.floats(0.5, 30.0), st.floats(-5.0, 5.0), st.floats(-3.1, 3.1), st.floats(-0.3, 0.3), st.booleans())
def test_vehicle_to_z_and_back(V: float, A: float, psi: float, beta: float, reverse: bool) -> None:
    g = Gains(floor=0.1, c_max=20.0)
    v = bicycle.State(3.0, -4.0, -V if reverse else V, A, psi, beta)
    z = high_gain.from_vehicle(v, g)
    back = high_gain.to_vehicle(z, g)
    assert [*back[:4], back.beta] == pytest.approx([*v[:4], beta], abs=1e-9)
    assert wrap(back.psi - psi) == pytest.approx(0.0, abs=1e-9)
    assert high_gain.course_rate(z, g) == pytest.approx(v.V * math.sin(beta) / g.l_r, abs=1e-9)


@settings(max_examples=20)
@given(st.floats(2.5, 20.0), st.floats(-2.0, 2.0), st.floats(-0.1, 0.1))
def test_companion_form_is_the_bicycle(V: float, A: float, beta: float) -> None:
    """z' = F z + G f(z) moves z of a bicycle as the bicycle's arc does."""
    g, v = Gains(c_max=10.0), bicycle.State(1.0, 2.0, V, A, 0.4, beta)
    z = kernel.rk4(high_gain.rhs, high_gain.from_vehicle(v, g), FREE, FREE, g, 0.2, 20)
    assert z[:6] == pytest.approx(high_gain.from_vehicle(bicycle.arc(v, 0.2), g)[:6], abs=1e-6)


# ---------------------------------------------------------------- the published cases


@pytest.mark.parametrize(
    ("speed", "acceleration", "steering_rate", "expected"),
    [
        (10.0, 0.0, 0.0, (0.01, 0.05, 0.36, 0.05)),
        (10.0, 0.0, 10.0, (0.01, 0.08, 0.37, 0.05)),
        (15.0, -1.0, -5.0, (0.01, 0.10, 0.53, 0.045)),
    ],
)
def test_published_cases(speed: float, acceleration: float, steering_rate: float, expected: Any) -> None:
    """5 s at 1 kHz from an initial heading error of 0.36 rad: RMSE of position, V_x, V_y, psi."""
    dt, g = 0.001, PUBLISHED._replace(noise=0.0)
    v, true = bicycle.State(0.0, 0.0, speed, acceleration, 0.0, 0.0), []
    for k in range(5001):
        steering = math.radians(steering_rate) * dt * (k + 0.5)
        v = v._replace(beta=min(float(bicycle.slip(steering)), high_gain.SLIP_MAX))
        true.append(v)
        v = bicycle.arc(v, dt)
    t = np.array(true)
    y = rows(t[:, :2])
    first = high_gain.from_vehicle(true[0]._replace(psi=0.36, beta=0.0), g)
    run, now, index = observers.stream(high_gain), np.array([first]), np.array([0])
    states = [now[0].copy()]
    for k in range(1, len(y)):
        run.step_all(now, y[k - 1 : k], y[k : k + 1], np.array([dt]), g, index, now)
        states.append(now[0].copy())
    z, chi = np.array(states), t[:, 4] + t[:, 5]
    got = (
        rms(np.hypot(z[:, 0] - t[:, 0], z[:, 3] - t[:, 1])),
        rms(z[:, 1] - t[:, 2] * np.cos(chi)),
        rms(z[:, 4] - t[:, 2] * np.sin(chi)),
        rms(wrap(np.array([high_gain.to_vehicle(State(*s), g).psi for s in z]) - t[:, 4])),
    )
    assert got == pytest.approx(expected, rel=0.15, abs=0.012)


# ---------------------------------------------------------------- proof


def test_errors_decay_step_by_step_as_certified() -> None:
    """Two observers on the same measurements come together in the norm of the certificate."""
    c, g = high_gain.certificate(), Gains(huber=0.0, c_max=100.0, floor=0.1)
    assert c.proven()
    S, rng = np.tile([1.0, 0.3, 0.09], 2), np.random.default_rng(0)

    def size(a: State, b: State) -> float:
        e = S * (np.array(a[:6]) - np.array(b[:6]))
        return float(e @ c.P @ e)

    for _ in range(20):
        v = bicycle.State(0.0, 0.0, 12.0, rng.uniform(-0.5, 0.5), rng.uniform(-3.0, 3.0), 0.02)
        a = high_gain.from_vehicle(v, g)
        b = State(*(np.array(a[:6]) + rng.normal(0.0, 0.1, 6)), a.psi, 0.0)
        for k in range(20):
            dt, before = (0.05, 0.1, 0.15, 0.2)[k % 4], size(a, b)
            y = Measurement(a.X + dt * a.dX, a.Y + dt * a.dY)
            a, b = high_gain.step(a, y, y, dt, g), high_gain.step(b, y, y, dt, g)
            assert size(a, b) <= c.rate**2 * before


def test_design_gives_the_gains_that_are_kept() -> None:
    pytest.importorskip("clarabel")
    from outrider import design

    made = design.high_gain(5.0, 3.0, 0.4, rate=0.5, fastest=8.0)
    assert made.gain[:3] == pytest.approx(DESIGNED[:3], rel=1e-3)
    assert made.certificate.proven()


def test_a_wrong_proof_is_refused() -> None:
    from dataclasses import replace

    c = high_gain.certificate()
    assert not replace(c, rate=0.9).proven()
    assert not replace(c, P=np.eye(6)).proven()


# ---------------------------------------------------------------- on the road


def test_yaw_follows_the_rear_axle() -> None:
    """A circle, forwards and backwards: the yaw is the course less the slip, whatever it was at the start."""
    dt, g = 0.1, Gains(c_max=1.0, floor=0.5)
    for V in (4.0, -3.0):
        v, true = bicycle.State(0.0, 0.0, V, 0.0, 0.3, 0.15), []
        for _ in range(120):
            true.append(v)
            v = bicycle.arc(v, dt)
        t = np.array(true)
        s = high_gain.from_vehicle(true[0]._replace(psi=0.0), g)
        for row in rows(t[:, :2])[1:]:
            s = high_gain.step(s, Measurement(*row), Measurement(*row), dt, g)
        m = high_gain.motion(s, g)
        assert m.speed == pytest.approx(V, abs=0.02)
        assert wrap(m.yaw - t[-1, 4]) == pytest.approx(0.0, abs=0.02)
        assert m.slip == pytest.approx(0.15, abs=0.02)
        assert m.yaw_rate == pytest.approx(V * math.sin(0.15) / g.l_r, abs=0.01)


def test_heading_of_the_rectangle_improves_yaw_and_velocity() -> None:
    """A slalom seen with 10 cm noise."""
    dt, rng, v, true = 0.1, np.random.default_rng(5), bicycle.State(0.0, 0.0, 6.0, 0.0, 0.0, 0.0), []
    for k in range(150):
        v = v._replace(beta=float(bicycle.slip(0.3 * math.sin(0.1 * k))))
        true.append(v)
        v = bicycle.arc(v, dt)
    t = np.array(true)
    y = rows(t[:, :2] + rng.normal(0.0, 0.1, (30, 150, 2)), 0.1)
    alone = observe(y, dt, Gains())
    y[..., 5], y[..., 6] = t[:, 4] + rng.normal(0.0, 0.03, (30, 150)), 0.03**2
    known = observe(y, dt, Gains())
    chi = t[:, 4] + t[:, 5]

    def errors(m: np.ndarray) -> tuple[float, float]:
        v = m[:, 20:, 2] * np.exp(1j * m[:, 20:, 4]) - (t[:, 2] * np.exp(1j * chi))[20:]
        return rms(wrap(m[:, 20:, 5] - t[20:, 4])), rms(np.abs(v))

    (yaw, velocity), (yaw_known, velocity_known) = errors(alone), errors(known)
    assert yaw_known < 0.6 * yaw
    assert velocity_known < 0.95 * velocity
    np.testing.assert_array_equal(observe(y, dt, Gains(heading=0.0))[..., :5], alone[..., :5])


def test_one_wild_sample_moves_little_and_a_new_place_is_found() -> None:
    """20 m off once, and for good: limited innovations double until the vehicle is reached."""
    dt, g = 0.1, Gains()
    p = np.arange(100)[:, None] * np.array([[0.8, 0.0]])
    once, moved = rows(p, 0.02), rows(p, 0.02)
    once[50, 1] += 20.0
    moved[50:, 1] += 20.0
    m = observe(np.stack([once, moved]), dt, g)
    assert abs(m[0, 50, 1]) < 2.0
    assert np.hypot(m[0, 60:, 0] - p[60:, 0], m[0, 60:, 1]).max() < 0.6
    assert np.abs(m[1, 75:, 1] - 20.0).max() < 1.0
    free = observe(once[None], dt, g._replace(huber=0.0))
    assert abs(free[0, 50, 1]) > 10.0


def test_braking_to_a_stop_unseen_stops() -> None:
    g = Gains()
    z = high_gain.from_vehicle(bicycle.State(0.0, 0.0, 3.0, -8.0, 0.7, 0.0), g)
    s = high_gain.predict(z, 5.0, g)
    assert s[1:3] == pytest.approx((0.0, 0.0))
    assert s.psi == pytest.approx(0.7)
    assert high_gain.motion(s, g).speed == 0.0
    assert 0.5 < math.hypot(s.X, s.Y) < 1.0


def test_what_reverses_too_fast_is_turned_round() -> None:
    g = Gains()
    v = bicycle.State(0.0, 0.0, -4.5, -0.5, 0.3, 0.1)
    before = high_gain.from_vehicle(v, g)
    after = high_gain._limited(before, g.reverse)
    m, w = high_gain.motion(before, g), high_gain.motion(after, g)
    assert (w.speed, w.acceleration, w.slip) == pytest.approx((-m.speed, -m.acceleration, -m.slip))
    assert abs(wrap(w.course - m.course)) == pytest.approx(math.pi)
    assert high_gain._limited(before, math.inf).psi == pytest.approx(0.3)


@pytest.mark.parametrize("dt", [0.02, 0.3, 1.0, 4.9, 5.1, 1e9])
def test_long_steps_are_stable(dt: float) -> None:
    p = np.arange(600)[:, None] * np.array([[8.0 * min(dt, 5.0), 0.0]])
    m = observe(rows(p[None]), dt, Gains())[0, -1]
    assert np.isfinite(m).all()
    if dt <= high_gain.GAP_MAX:
        assert m[2] == pytest.approx(8.0, abs=1e-3)
