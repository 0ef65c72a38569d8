"""The multi-stage observer: the paper's cases, its errata, and what a road asks of it."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from outrider import kernel, observers
from outrider.models import bicycle
from outrider.observers import Measurement, multi_stage
from outrider.observers.multi_stage import SLIP_MAX, Gains, Output, State

NAN = float("nan")
X, Y, V, A, PSI, BETA = range(6)  # columns of the truth


def rms(e: Any) -> float:
    return float(np.sqrt(np.mean(np.square(e))))


def wrap(angle: Any) -> Any:
    return np.remainder(angle + np.pi, 2 * np.pi) - np.pi


def truth(speed: float, acceleration: float, steer: Any, dt: float, n: int, sub: int = 1) -> np.ndarray:
    """Rows (n, 6) of the bicycle, steer(t) [rad], starting at the origin with yaw 0."""
    s, h = bicycle.State(0.0, 0.0, speed, acceleration, 0.0, float(bicycle.slip(steer(0.0)))), dt / sub
    rows = [s]
    for k in range(1, (n - 1) * sub + 1):
        beta = float(bicycle.slip(steer(k * h)))
        s = bicycle.rk4(s, h, 0.0, (beta - s.beta) / h)
        if k % sub == 0:
            rows.append(s)
    return np.array(rows)


def measured(p: np.ndarray, sigma: float, rng: Any, runs: int = 1) -> np.ndarray:
    """Measurements (runs, n, 9) of positions p (n, 2) with noise sigma [m], no heading."""
    y = np.zeros((runs, len(p), 9))
    y[..., :2] = p + rng.normal(0.0, sigma, (runs, len(p), 2))
    y[..., 2] = y[..., 4] = sigma**2
    y[..., 6] = np.inf
    return y


def observe(y: np.ndarray, dt: float, gains: Gains = Gains()) -> np.ndarray:  # noqa: B008
    return observers.batch(multi_stage, y, np.full(y.shape[:2], dt), gains)


def follow(first: State, y: np.ndarray, dt: float, gains: Gains) -> np.ndarray:
    """States (n, 8) from measurements (n, 9), from a given first state."""
    run, now, index = observers.stream(multi_stage), np.array([first], float), np.array([0])
    states = [now[0].copy()]
    for k in range(1, len(y)):
        run.step_all(now, y[k - 1 : k], y[k : k + 1], np.array([dt]), gains, index, now)
        states.append(now[0].copy())
    return np.array(states)


def velocity_error(s: np.ndarray, t: np.ndarray) -> np.ndarray:
    chi, true = s[..., 4] + s[..., 5], t[..., PSI] + t[..., BETA]
    return np.stack(
        [
            s[..., 1] * np.cos(chi) - t[..., V] * np.cos(true),
            s[..., 1] * np.sin(chi) - t[..., V] * np.sin(true),
        ],
        axis=-1,
    )


# ---------------------------------------------------------------- the published cases


@pytest.mark.parametrize(
    ("speed", "acceleration", "steering_rate", "expected"),
    [
        (10.0, 0.0, 0.0, (0.02, 0.05, 0.43, 0.05)),
        (10.0, 0.0, 10.0, (0.06, 0.78, 0.89, 0.06)),
        (15.0, -1.0, -5.0, (0.04, 0.38, 0.63, 0.04)),
    ],
)
def test_published_cases(speed: float, acceleration: float, steering_rate: float, expected: Any) -> None:
    """5 s at 1 kHz from an initial heading error of 0.36 rad: RMSE of position, V_x, V_y, psi."""
    dt = 0.001
    t = truth(speed, acceleration, lambda at: math.radians(steering_rate) * at, dt, 5001)
    y = measured(t[:, :2], 0.0, np.random.default_rng(0))[0]
    s = follow(State(0.0, speed, acceleration, 0.0, 0.36, 0.0, 0.0, 0.0), y, dt, Gains(noise=0.0))
    dv = velocity_error(s, t)
    got = (rms(np.linalg.norm(s[:, 6:] - t[:, :2], axis=1)), rms(dv[:, 0]), rms(dv[:, 1]))
    assert (*got, rms(wrap(s[:, 4] - t[:, PSI]))) == pytest.approx(expected, rel=0.15, abs=0.02)


# ---------------------------------------------------------------- errata


def test_measurement_must_be_interpolated_not_held() -> None:
    """10 Hz, 2 cm noise, a car that speeds up: with held outputs the position lags by a third of a metre."""
    dt = 0.1
    t = truth(2.0, 0.5, lambda at: 0.0, dt, 100)
    y = measured(t[:, :2], 0.02, np.random.default_rng(0), runs=20)
    good = observe(y, dt)[:, 30:]
    c = multi_stage.Coefficients(4.61, 12.24, 9.83, 4.16, 6.08, 0.68, 0.0, 20.0, 2.0)
    errors = []
    for run in y[:5]:
        s = State(0.0, 2.0, 0.0, 0.0, 0.0, 0.0, *run[1, :2])
        for k in range(2, 100):
            dp = run[k, :2] - run[k - 1, :2]
            held = Output(0.0, math.atan2(dp[1], dp[0]), 0.0, *run[k - 1, :2])
            s = kernel.rk4(multi_stage.rhs, s, held, Output(0.0, 0.0, 0.0, 0.0, 0.0), c, dt, 4)
            s = s._replace(S=s.S - float(dp[0]))
            if k >= 30:
                errors.append(s.x - t[k, X])
    assert rms(np.linalg.norm(good[..., 6:] - t[30:, :2], axis=-1)) < 0.05
    assert rms(good[..., 1] - t[30:, V]) < 0.1
    assert rms(errors) == pytest.approx(0.31, rel=0.15)


@pytest.mark.parametrize(("sigma", "rectified"), [(0.02, 0.35), (0.05, 0.88), (0.10, 1.77)])
def test_a_parked_car_does_not_drive(sigma: float, rectified: float) -> None:
    """Summed norms of increments turn noise into speed; increments projected on the course do not."""
    dt = 0.1
    y = measured(np.zeros((400, 2)), sigma, np.random.default_rng(1), runs=20)
    way = np.linalg.norm(np.diff(y[..., :2], axis=1), axis=-1)
    S_V_A_J = np.zeros((20, 4))
    F = np.diag(np.ones(3), 1)
    L = np.array([4.61, 12.24, 9.83, 4.16])
    speeds = []
    for k in range(way.shape[1]):  # the chain of eq. 27, path coordinate relative to the last sample
        for i in range(100):
            e = way[:, k] * (i + 0.5) / 100 - S_V_A_J[:, 0]
            S_V_A_J = S_V_A_J + dt / 100 * (S_V_A_J @ F.T + e[:, None] * L)
        S_V_A_J[:, 0] -= way[:, k]
        speeds.append(S_V_A_J[:, 1])
    assert np.mean(speeds[100:]) == pytest.approx(rectified, rel=0.03)
    s = observe(y, dt)[:, 100:]
    assert abs(s[..., 1].mean()) < 0.01 * rectified + 0.005
    assert np.abs(s[..., 1]).mean() < 0.07 * rectified
    assert np.abs(s[..., 1]).max() < 0.5 * rectified


def test_course_is_held_while_the_way_is_shorter_than_the_noise() -> None:
    dt = 0.1
    y = measured(np.zeros((300, 2)), 0.05, np.random.default_rng(2), runs=50)
    y[..., 5], y[..., 6] = 0.5, 0.01  # the heading of the rectangle tells where it points at the start
    drift = [
        np.abs(wrap(observe(y, dt, Gains(gate=gate))[:, 1:, 4] - 0.5)).mean() for gate in (0.0, 2.0, 4.0)
    ]
    assert drift[0] > 1.5 * drift[1] > 3.0 * drift[2]
    assert drift[2] < 0.15


def test_noise_along_the_way_does_not_hold_the_course() -> None:
    """Only the noise across the way makes its direction uncertain."""
    y0, y1 = Measurement(0.0, 0.0, xx=1.0), Measurement(1.0, 0.1, xx=1.0)
    s = State(0.0, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert multi_stage.step(s, y0, y1, 0.1, Gains()).psi > 0.01
    y0, y1 = y0._replace(yy=1.0), y1._replace(yy=1.0)
    assert multi_stage.step(s, y0, y1, 0.1, Gains()).psi == 0.0


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_innovation_goes_the_short_way_round(course: float, error: float) -> None:
    """A course beyond +-pi is the course; the estimate comes nearer, at once."""
    g, error = Gains(), 0.45 * error
    s = State(0.0, 10.0, 0.0, 0.0, course + error, 0.0, 0.0, 0.0)
    y0, y1 = Measurement(0.0, 0.0), Measurement(math.cos(course), math.sin(course))
    after = multi_stage.step(s, y0, y1, 0.1, g)
    assert abs(wrap(after.psi + after.beta - course)) <= abs(error) * 0.6 + 1e-9


def test_published_signs_are_unstable_in_reverse_and_the_mirrored_are_not() -> None:
    """Error of [psi beta]: [[-L1, V/l - L1], [-L2, -L2]] for small slip."""
    for i, nominal in enumerate(multi_stage.NOMINAL):
        forward, L2 = multi_stage.L_PSI[i], multi_stage.L_BETA[i]

        def poles(speed: float, a: float, b: float) -> np.ndarray:
            return np.sort_complex(np.linalg.eigvals([[-a, speed / 2.0 - a], [-b, -b]]))

        c = multi_stage._coefficients(
            State(0.0, -nominal, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), Measurement(0.0, 0.0), True, True, Gains()
        )
        assert poles(-nominal, forward, L2).real.max() > 0.0
        assert poles(-nominal, c.L_psi, c.L_beta) == pytest.approx(poles(nominal, forward, L2))
        assert poles(nominal, forward, L2).real.max() < 0.0


def test_table_is_read_at_the_nearest_nominal_speed() -> None:
    """The paper's example: at 6.7 m/s the gains are 8.05 and 0.99."""
    for speed, gains in (
        (6.7, (8.05, 0.99)),
        (0.0, (0.89, 0.25)),
        (1.3, (0.98, 0.27)),
        (60.0, (11.44, 0.92)),
    ):
        s = State(0.0, speed, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        c = multi_stage._coefficients(s, Measurement(0.0, 0.0), True, True, Gains())
        assert (c.L_psi, c.L_beta) == gains


# ---------------------------------------------------------------- on the road


def test_constant_jerk_is_followed_with_an_error_of_second_order() -> None:
    """The chain holds a constant jerk; what is left is the sagitta between two samples."""
    errors = []
    for dt in (0.1, 0.05):
        at = np.arange(0.0, 12.0, dt)
        p = np.column_stack([2.0 * at + 0.2 * at**2 / 2 + 0.3 * at**3 / 6, 0.0 * at])
        s = observe(measured(p, 0.0, np.random.default_rng(0)), dt)[0, -1]
        exact = (2.0 + 0.2 * at[-1] + 0.15 * at[-1] ** 2, 0.2 + 0.3 * at[-1], 0.3, at[-1])
        assert s[1:4] == pytest.approx(exact[:3], abs=0.02)
        assert s[6] == pytest.approx(p[-1, 0], abs=0.02)
        errors.append(abs(s[6] - p[-1, 0]))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.3)


def test_a_circle_gives_yaw_slip_and_yaw_rate() -> None:
    t = truth(8.0, 0.0, lambda at: 0.2, 0.1, 200, sub=20)
    s = observe(measured(t[:, :2], 0.0, np.random.default_rng(0)), 0.1)[0, -1]
    m = multi_stage.motion(State(*s), Gains())
    assert m.speed == pytest.approx(8.0, abs=0.05)
    assert m.slip == pytest.approx(t[-1, BETA], abs=0.01)
    assert wrap(m.yaw - t[-1, PSI]) == pytest.approx(0.0, abs=0.02)
    assert m.yaw_rate == pytest.approx(8.0 * math.sin(t[-1, BETA]) / 2.0, abs=0.05)


def test_a_reversing_car_has_negative_speed_and_keeps_its_heading() -> None:
    """Forward, stop, back in a bend: 25 s."""
    dt, at = 0.1, np.arange(0.0, 25.0, 0.1)
    speed = np.clip(4.0 - 0.7 * np.maximum(at - 5.0, 0.0), -2.0, 4.0)
    s, rows = bicycle.State(0.0, 0.0, 4.0, 0.0, 0.0, 0.0), []
    for k in range(len(at)):
        rows.append(s)
        s = bicycle.arc(s._replace(V=speed[k], beta=0.1 if at[k] > 12.0 else 0.0), dt)
    t = np.array(rows)
    e = observe(measured(t[:, :2], 0.01, np.random.default_rng(3), runs=10), dt)
    assert e[:, -50:, 1] == pytest.approx(-2.0, abs=0.15)
    assert np.abs(wrap(e[:, 20:, 4] - t[20:, PSI])).max() < 0.35
    assert np.abs(wrap(e[:, -50:, 4] + e[:, -50:, 5] - t[-50:, PSI] - 0.1)).mean() < 0.1
    assert e[:, -50:, 5].mean() == pytest.approx(0.1, abs=0.05)


def test_what_reverses_too_fast_was_started_the_wrong_way_round() -> None:
    """A parked car whose rectangle pointed backwards drives off: turned round, its path unbroken."""
    dt, at = 0.1, np.arange(0.0, 12.0, 0.1)
    p = np.column_stack([1.0 * np.maximum(at - 2.0, 0.0) ** 2, 0.0 * at])
    y = measured(p, 0.0, np.random.default_rng(0))
    y[..., 5], y[..., 6] = np.pi, 0.01
    s = observe(y, dt, Gains(heading=0.0))[0]
    assert s[:, 1][1:].min() >= -4.0
    assert s[-1, 1] == pytest.approx(2.0 * (at[-1] - 2.0), abs=0.3)
    assert np.abs(wrap(s[-1, 4] + s[-1, 5])) < 1e-6
    trusting = observe(y, dt, Gains(heading=30.0))[0, -1]  # a heading that is used says where the front is
    assert trusting[1] == pytest.approx(-s[-1, 1], abs=0.01)
    assert abs(wrap(trusting[4] - np.pi)) < 0.01
    before = State(0.0, -4.1, 0.5, 0.0, 0.3, 0.2, 1.0, 2.0)
    after = multi_stage._limited(before, 0.0, 4.0)
    m, w = multi_stage.motion(before, Gains()), multi_stage.motion(after, Gains())
    assert (w.yaw_rate, w.speed) == pytest.approx((m.yaw_rate, -m.speed))
    assert abs(wrap(w.course - m.course)) == pytest.approx(np.pi)


def test_stop_and_go() -> None:
    dt, at = 0.1, np.arange(0.0, 30.0, 0.1)
    speed = np.interp(at, [0, 5, 8, 14, 18, 30], [8, 8, 0, 0, 6, 6])
    p = np.column_stack([np.cumsum(speed) * dt, 0.0 * at])
    s = observe(measured(p, 0.02, np.random.default_rng(4), runs=20), dt)
    assert rms(s[:, 110:138, 1]) < 0.3  # standing, three seconds after the stop
    assert rms(s[:, 250:, 1] - 6.0) < 0.2
    assert rms(wrap(s[:, 20:, 4])) < 0.15
    assert np.abs(wrap(s[:, 20:, 4])).max() < 0.8


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.floats(0.0, 2.0))
def test_slip_and_speed_stay_within_their_limits(seed: int, sigma: float) -> None:
    rng = np.random.default_rng(seed)
    s = observe(measured(np.cumsum(rng.normal(0.0, 1.5, (60, 2)), axis=0), sigma, rng), 0.1)[0, 1:]
    assert np.abs(s[:, 5]).max() <= SLIP_MAX
    assert s[:, 1].min() >= -4.0
    assert s[:, 1].max() <= multi_stage.V_MAX


def test_a_jump_of_the_point_moves_the_position_alone() -> None:
    """20 m in one sample is no movement: speed and course coast over it."""
    g = Gains()
    s = State(0.0, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    after = multi_stage.step(s, Measurement(0.0, 0.0), Measurement(1.0, 20.0), 0.1, g)
    assert (after.V, after.A, after.psi) == (10.0, 0.0, 0.0)
    assert after.y > 5.0


@pytest.mark.parametrize("dt", [0.3, 1.0, 4.9, 5.1, 1e3, 1e9])
def test_long_steps_are_stable(dt: float) -> None:
    p = np.arange(30)[:, None] * np.array([[8.0, 0.0]])
    s = observe(measured(p, 0.0, np.random.default_rng(0)), dt)[0, -1]
    assert np.isfinite(s).all()
    if dt <= multi_stage.GAP_MAX:
        assert s[1] == pytest.approx(8.0 / dt, abs=1e-6)


def test_coasting_fades_the_acceleration_and_stops_a_braking_car() -> None:
    g = Gains(coast=0.8)
    go = multi_stage.predict(State(0.0, 5.0, 2.0, 9.0, 0.0, 0.0, 0.0, 0.0), 0.5, g)
    fade = math.exp(-0.5 / 0.8)
    assert go[1:4] == pytest.approx((5.0 + 2.0 * 0.8 * (1.0 - fade), 2.0 * fade, 0.0))
    at = np.linspace(0.0, 0.5, 20001)
    assert go.x == pytest.approx(np.trapezoid(5.0 + 1.6 * (1.0 - np.exp(-at / 0.8)), at))
    stop = multi_stage.predict(State(0.0, 3.0, -8.0, 0.0, 0.0, 0.0, 0.0, 0.0), 5.0, g)
    assert (stop.V, stop.A) == (0.0, 0.0)
    at = np.linspace(0.0, -0.8 * math.log1p(-3.0 / 6.4), 20001)
    assert stop.x == pytest.approx(np.trapezoid(3.0 - 6.4 * (1.0 - np.exp(-at / 0.8)), at))
    turn = multi_stage.predict(State(0.0, 6.0, 0.0, 0.0, 0.1, 0.2, 1.0, 2.0), 1.5, g)
    arc = bicycle.arc(bicycle.State(1.0, 2.0, 6.0, 0.0, 0.1, 0.2), 1.5)
    assert (turn.x, turn.y, turn.psi) == pytest.approx((arc.X, arc.Y, arc.psi))


def test_start_takes_the_heading_of_the_rectangle_where_nothing_moved() -> None:
    g = Gains()
    still = [
        Measurement(0.0, 0.0, 1e-4, 0.0, 1e-4, 2.0, 0.01),
        Measurement(0.01, 0.0, 1e-4, 0.0, 1e-4, 2.1, 0.01),
    ]
    assert multi_stage.start(*still, 0.1, g)[:6] == pytest.approx((0.0, 0.0, 0.0, 0.0, 2.1, 0.0))
    unseen = still[1]._replace(x=NAN)
    assert multi_stage.start(still[0], unseen, 0.1, g)[4:] == pytest.approx((2.0, 0.0, 0.0, 0.0))
    moving = still[1]._replace(x=1.0, y=1.0)
    s = multi_stage.start(still[0], moving, 0.1, g)
    assert (s.V, s.psi) == pytest.approx((10.0 * math.sqrt(2.0), math.pi / 4.0))


# ---------------------------------------------------------------- what the paper leaves open


def test_speed_scale_moves_the_poles() -> None:
    s, m = State(0.0, 8.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), Measurement(0.0, 0.0)

    def poles(scale: float) -> np.ndarray:
        c = multi_stage._coefficients(s, m, True, True, Gains(speed=scale))
        F = np.diag(np.ones(3), 1)
        F[:, 0] -= [c.L_S, c.L_V, c.L_A, c.L_J]
        return np.sort_complex(np.linalg.eigvals(F))

    assert poles(3.0) == pytest.approx(3.0 * poles(1.0))
    assert poles(1.0).real.max() < 0.0


def test_heading_of_the_rectangle_improves_the_yaw() -> None:
    """A slalom seen with 10 cm noise: the published gains alone, a known heading, an unknown one."""
    dt, rng = 0.1, np.random.default_rng(5)
    t = truth(6.0, 0.0, lambda at: 0.3 * math.sin(at), dt, 150, sub=10)
    y = measured(t[:, :2], 0.1, rng, runs=30)
    alone = observe(y, dt)
    y[..., 5] = t[:, PSI] + rng.normal(0.0, 0.05, (30, 150))
    y[..., 6] = 0.05**2
    known = observe(y, dt, Gains(heading=30.0))
    error = [rms(wrap(s[:, 20:, 4] - t[20:, PSI])) for s in (alone, known)]
    assert error[1] < 0.65 * error[0]
    y[..., 6] = np.inf
    np.testing.assert_array_equal(observe(y, dt, Gains(heading=30.0)), alone)


@pytest.mark.parametrize("speed", [1.0, 5.0, 14.0])
def test_the_designed_table_turns_with_the_car(speed: float) -> None:
    """On a circle yaw, slip and speed are found with our own gains, each entry of the table in use."""
    t = truth(speed, 0.0, lambda t: 0.2, 0.1, 400)
    y = measured(t[:, :2], 0.0, np.random.default_rng(0))
    s = observe(y, 0.1, multi_stage.DESIGNED._replace(heading=0.0))[0, -1]
    assert s[1] == pytest.approx(speed, rel=0.02)
    assert wrap(s[4] - t[-1, PSI]) == pytest.approx(0.0, abs=0.02 + 0.001 * speed)
    assert s[5] == pytest.approx(t[-1, BETA], abs=0.02)


def test_the_shortest_of_all_steps_leaves_the_state_finite() -> None:
    p = np.column_stack([np.linspace(0.0, 8.0, 11), np.zeros(11)])
    dt = np.full((1, 11), 0.1)
    dt[0, 5] = 5e-324
    y = measured(p, 0.0, np.random.default_rng(0))
    assert np.isfinite(observers.batch(multi_stage, y, dt, Gains())[0, 1:]).all()
