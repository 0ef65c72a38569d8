"""The contract of observers/, for every file in it."""

import inspect
import math
import re
from typing import Any, get_type_hints

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from outrider import compiler, kernel, observers
from outrider.errors import InputError
from outrider.observers import Measurement, Motion

NAMES = observers.names()
NAN = float("nan")
N_Y = len(Measurement._fields)
every_observer = pytest.mark.parametrize("name", NAMES)


def measurements(p: Any, sigma: float = 0.0) -> np.ndarray:
    """Rows (..., 9) of positions p (..., 2) [m] with standard deviation sigma [m], no heading."""
    y = np.zeros((*np.shape(p)[:-1], N_Y))
    y[..., :2] = p
    y[..., 2] = y[..., 4] = sigma**2
    y[..., 6] = np.inf
    return y


def plain(observer: Any, y: np.ndarray, dt: np.ndarray, gains: Any) -> list[Any]:
    """States from sample 1 on, in plain Python."""
    rows = [Measurement(*map(float, row)) for row in y]
    states = [observer.start(rows[0], rows[1], float(dt[1]), gains)]
    for k in range(2, len(rows)):
        states.append(observer.step(states[-1], rows[k - 1], rows[k], float(dt[k]), gains))
    return states


def wander(seed: int, n: int, sigma: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """Noisy positions (n, 2) [m] of a vehicle on a winding road, irregular time steps (n,) [s]."""
    rng = np.random.default_rng(seed)
    dt = rng.uniform(0.05, 0.2, n)
    course = np.cumsum(rng.normal(0.0, 0.05, n)) + rng.uniform(-np.pi, np.pi)
    way = rng.uniform(3.0, 15.0) * dt
    p = np.cumsum(way[:, None] * np.column_stack([np.cos(course), np.sin(course)]), axis=0)
    return p + rng.normal(0.0, sigma, (n, 2)), dt


def straight(n: int, speed: float = 8.0, course: float = 0.7, dt: float = 0.1) -> np.ndarray:
    """Exact positions (n, 2) at constant speed."""
    return np.arange(n)[:, None] * speed * dt * np.array([np.cos(course), np.sin(course)])


@every_observer
def test_says_what_it_is(name: str) -> None:
    observer = observers.get(name)
    assert len(observer.reference) > 20
    assert set(get_type_hints(observer.State).values()) == {float}
    gains = observer.Gains()
    assert all(np.isfinite(np.asarray(value, float)).all() for value in gains)
    source = inspect.getsource(observer.Gains)
    for field in gains._fields:
        assert re.search(rf"^ +{field}: .*#.*\[.+\]", source, re.M), f"{field}: unit missing"
    certificate = observer.certificate()
    assert certificate is None or certificate.margin() > certificate.tolerance()


@every_observer
def test_constant_speed_is_found_exactly(name: str) -> None:
    observer, p, dt = observers.get(name), straight(100), np.full(100, 0.1)
    gains = observer.Gains()
    m = observer.motion(plain(observer, measurements(p), dt, gains)[-1], gains)
    assert isinstance(m, Motion)
    assert m == pytest.approx(Motion(*p[-1], 8.0, 0.0, 0.7, 0.7, 0.0, 0.0), abs=1e-3)


@every_observer
@settings(deadline=None, max_examples=15)
@given(angle=st.floats(-3.0, 3.0), shift=st.floats(-100.0, 100.0), seed=st.integers(0, 1000))
def test_turning_the_world_changes_nothing(name: str, angle: float, shift: float, seed: int) -> None:
    observer = observers.get(name)
    p, dt = wander(seed, 25)
    y = measurements(p)
    y[:, 2:5] = [0.0009, 0.0002, 0.0004]
    y[:, 5], y[:, 6] = 0.3, 0.01
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = y.copy()
    turned[:, :2] = p @ R.T + shift
    C = R @ np.array([[0.0009, 0.0002], [0.0002, 0.0004]]) @ R.T
    turned[:, 2:5] = C[0, 0], C[0, 1], C[1, 1]
    turned[:, 5] += angle
    gains = observer.Gains()
    m = observer.motion(plain(observer, y, dt, gains)[-1], gains)
    w = observer.motion(plain(observer, turned, dt, gains)[-1], gains)
    assert np.array([w.x, w.y]) == pytest.approx(R @ np.array([m.x, m.y]) + shift, abs=1e-6)
    assert (w.speed, w.acceleration) == pytest.approx((m.speed, m.acceleration), abs=1e-6)
    assert (w.slip, w.yaw_rate) == pytest.approx((m.slip, m.yaw_rate), abs=1e-6)
    for a, b in ((w.course, m.course), (w.yaw, m.yaw)):
        assert math.remainder(a - b - angle, math.tau) == pytest.approx(0.0, abs=1e-6)


@every_observer
def test_stream_is_batch_bit_for_bit_and_plain_python_to_rounding(name: str) -> None:
    observer = observers.get(name)
    gains, run = observer.Gains(), observers.stream(observer)
    paths, times = zip(*(wander(seed, 40) for seed in range(4)), strict=True)
    y, dt = measurements(np.array(paths), 0.02), np.array(times)
    y[1, 20:23, 0] = NAN
    dt[2, 15] = 0.0
    states = observers.batch(observer, y, dt, gains)
    assert np.isnan(states[:, 0]).all()
    now, index = np.empty(states[:, 0].shape), np.arange(4)
    by_time, steps = np.ascontiguousarray(y.swapaxes(0, 1)), np.ascontiguousarray(dt.T)
    run.start_all(by_time[0], by_time[1], steps[1], gains, index, now)
    for k in range(2, 40):
        run.step_all(now, by_time[k - 1], by_time[k], steps[k], gains, index, now)
        np.testing.assert_array_equal(now, states[:, k])
    for i in range(4):
        python = np.array(plain(observer, y[i], dt[i], gains))
        np.testing.assert_allclose(states[i, 1:], python, rtol=1e-12, atol=1e-12)
    predicted, motions = np.empty_like(now), np.empty((4, len(Motion._fields)))
    run.predict_all(now, steps[0], gains, index, predicted)
    run.motion_all(now, gains, index, motions)
    for i in range(4):
        s = observer.State(*map(float, now[i]))
        assert predicted[i] == pytest.approx(observer.predict(s, dt[i, 0], gains), rel=1e-12, abs=1e-12)
        assert motions[i] == pytest.approx(observer.motion(s, gains), rel=1e-12, abs=1e-12)


@every_observer
def test_only_the_rows_named_are_touched(name: str) -> None:
    observer = observers.get(name)
    gains, run = observer.Gains(), observers.stream(observer)
    y0, y1 = measurements(np.zeros((3, 2))), measurements(np.ones((3, 2)))
    states = np.full((3, len(observer.State._fields)), 7.0)
    dt, index = np.full(3, 0.1), np.array([1])
    run.start_all(y0, y1, dt, gains, index, states)
    run.step_all(states, y0, y1, dt, gains, index, states)
    assert (states[[0, 2]] == 7.0).all()
    assert not (states[1] == 7.0).all()


@every_observer
def test_time_that_does_not_pass_changes_nothing(name: str) -> None:
    observer = observers.get(name)
    gains, p = observer.Gains(), straight(10)
    s = plain(observer, measurements(p), np.full(10, 0.1), gains)[-1]
    y = [Measurement(*row) for row in measurements(p)]
    for dt in (0.0, -0.1, NAN, math.inf):
        assert observer.step(s, y[8], y[9], dt, gains) == s
        assert observer.predict(s, dt, gains) == s


@every_observer
def test_a_missing_sample_is_predicted_and_the_next_one_taken(name: str) -> None:
    observer = observers.get(name)
    gains, p = observer.Gains(), straight(60)
    y, dt = measurements(p), np.full(60, 0.1)
    y[30:33, :2] = NAN
    states = plain(observer, y, dt, gains)
    assert states[29] == observer.predict(states[28], 0.1, gains)
    last = observer.motion(states[-1], gains)
    assert last == pytest.approx(Motion(*p[-1], 8.0, 0.0, 0.7, 0.7, 0.0, 0.0), abs=2e-2)
    kept = np.r_[0:30, 33:60]  # the other way to miss samples: a longer step
    dt[33] = 0.4
    m = observer.motion(plain(observer, y[kept], dt[kept], gains)[-1], gains)
    assert m == pytest.approx(Motion(*p[-1], 8.0, 0.0, 0.7, 0.7, 0.0, 0.0), abs=2e-2)


@every_observer
def test_coasting_in_two_steps_is_coasting_in_one(name: str) -> None:
    observer = observers.get(name)
    gains, (p, dt) = observer.Gains(), wander(3, 30)
    s = plain(observer, measurements(p, 0.02), dt, gains)[-1]
    once = observer.motion(observer.predict(s, 0.5, gains), gains)
    twice = observer.motion(observer.predict(observer.predict(s, 0.2, gains), 0.3, gains), gains)
    assert twice == pytest.approx(once, abs=1e-3)


@every_observer
@pytest.mark.parametrize("size", [1.0, 5.0, 20.0])
def test_no_observer_is_lost_for_good_by_one_bad_sample(name: str, size: float) -> None:
    observer = observers.get(name)
    gains = observer.Gains()
    p, dt = straight(150), np.full(150, 0.1)
    y = measurements(p, 0.02)
    for direction in range(8):
        bad = y.copy()
        angle = direction * np.pi / 4.0
        bad[50, :2] += size * np.array([np.cos(angle), np.sin(angle)])
        s = observers.batch(observer, bad[None], dt[None], gains)[0, -1]
        m = observer.motion(observer.State(*map(float, s)), gains)
        assert (m.x, m.y) == pytest.approx(p[-1], abs=0.05)
        assert m.speed * np.cos(m.course - 0.7) == pytest.approx(8.0, abs=0.2)
        assert m.speed * np.sin(m.course - 0.7) == pytest.approx(0.0, abs=0.2)


wild = st.one_of(st.floats(-1e3, 1e3), st.sampled_from([0.0, NAN, math.inf, -math.inf, 1e300, -1e300]))


@every_observer
@settings(deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow])
@given(
    rows=st.lists(st.tuples(*[wild] * 7), min_size=3, max_size=6), dts=st.lists(wild, min_size=6, max_size=6)
)
def test_a_state_stays_finite_whatever_is_measured(name: str, rows: Any, dts: Any) -> None:
    observer = observers.get(name)
    y = measurements(straight(12 + len(rows)), 0.02)
    y[10 : 10 + len(rows), :7] = rows
    dt = np.full(len(y), 0.1)
    dt[10 : 10 + len(rows)] = dts[: len(rows)]
    states = observers.batch(observer, y[None], dt[None], observer.Gains())
    assert np.isfinite(states[:, 1:]).all()


ALPHA_BETA = '''
"""A filter as simple as can be, to see that one file is enough."""
from typing import NamedTuple
from math import atan2, hypot, inf
import numpy as np
from outrider.kernel import kernel
from outrider.observers import Motion

reference = "none, made for a test"

class State(NamedTuple):
    x: float
    y: float
    u: float
    v: float

class Gains(NamedTuple):
    alpha: float = 0.5
    rates: np.ndarray = np.array([0.3])

@kernel
def start(y0, y1, dt, gains):
    return State(y1.x, y1.y, (y1.x - y0.x) / dt, (y1.y - y0.y) / dt)

@kernel
def predict(s, dt, gains):
    return State(s.x + dt * s.u, s.y + dt * s.v, s.u, s.v)

@kernel
def step(s, previous, measurement, dt, gains):
    p = predict(s, dt, gains)
    ex, ey, b = measurement.x - p.x, measurement.y - p.y, gains.rates[0] / dt
    return State(p.x + gains.alpha * ex, p.y + gains.alpha * ey, p.u + b * ex, p.v + b * ey)

@kernel
def motion(s, gains):
    course = atan2(s.v, s.u)
    return Motion(s.x, s.y, hypot(s.u, s.v), 0.0, course, course, 0.0, 0.0)

def certificate():
    return None
'''


def test_a_new_observer_is_one_file(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    name = "alpha_beta"
    (tmp_path / f"{name}.py").write_text(ALPHA_BETA)
    monkeypatch.setattr(compiler.numba.config, "CACHE_DIR", str(tmp_path))  # the file will be gone
    monkeypatch.setattr(observers, "__path__", [*observers.__path__, str(tmp_path)])
    assert observers.names() == sorted([*NAMES, name])
    observer = observers.get(name)
    gains = observers.gains_from(observer, {"alpha": 0.6})
    states = observers.batch(observer, measurements(straight(50))[None], np.full((1, 50), 0.1), gains)
    assert states[0, -1, 2:] == pytest.approx([8 * np.cos(0.7), 8 * np.sin(0.7)])


def test_unknown_names_are_refused_with_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean multi_stage"):
        observers.get("multistage")
    observer = observers.get("multi_stage")
    with pytest.raises(
        InputError, match=r"observer\.gains\.multi_stage: 'orientaton' is not known; did you mean orientation"
    ):
        observers.gains_from(observer, {"orientaton": 1.0})
    with pytest.raises(InputError, match="want one of L_S"):
        observers.gains_from(observer, {"qqq": 1.0})
    with pytest.raises(InputError, match="speed = nan; want a finite number"):
        observers.gains_from(observer, {"speed": NAN})
    assert observers.gains_from(observer, {"speed": 3}).speed == 3.0
    assert observers.gains_from(observer, {}) == observer.Gains()


def test_shapes_that_do_not_fit_are_refused() -> None:
    observer = observers.get("multi_stage")
    with pytest.raises(InputError, match=r"want \(N, T, 9\) and \(N, T\)"):
        observers.batch(observer, np.zeros((2, 5, 8)), np.zeros((2, 5)), observer.Gains())
    with pytest.raises(InputError, match=r"dt \(2, 4\)"):
        observers.batch(observer, np.zeros((2, 5, 9)), np.zeros((2, 4)), observer.Gains())


def test_rk4_converges_with_order_four() -> None:
    """x' = -x + t, x(0) = 1: x(t) = t - 1 + 2 exp(-t)."""
    State, Input = observers.get("multi_stage").Output, observers.get("multi_stage").Output

    def rhs(s: Any, y: Any, c: float) -> Any:
        return State(*(c * a + b for a, b in zip(s, y, strict=True)))

    s, y, dy = State(*[1.0] * 5), Input(*[0.0] * 5), Input(*[1.0] * 5)
    exact = 1.0 + 2.0 * math.exp(-2.0)
    errors = [abs(kernel.rk4(rhs, s, y, dy, -1.0, 2.0, n).S - exact) for n in (8, 16, 32)]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.15)
    assert errors[1] / errors[2] == pytest.approx(16.0, rel=0.1)


@given(st.floats(-1e4, 1e4))
def test_wrap_is_the_wrap_of_geometry(angle: float) -> None:
    from outrider import geometry

    w = kernel.wrap(angle)
    assert -np.pi - 1e-11 <= w <= np.pi + 1e-11
    assert math.remainder(w - geometry.wrap(angle), math.tau) == pytest.approx(0.0, abs=1e-11)
