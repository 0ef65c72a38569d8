"""The invariant observer: its poles, its proof and its bounds, and what it does with bad data."""

import math
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from outrider import observers
from outrider.observers import Measurement
from outrider.observers import _invariant_proof as proof
from outrider.observers import invariant as inv

pytestmark = pytest.mark.once

GAINS = inv.Gains()
LINEAR = GAINS._replace(huber=0.0, ramp=0.0)  # settled, nothing saturated
R = proof.NOMINAL[0] ** 2
OF_HEADING = proof.NOMINAL_HEADING**2


def nominal(x: float, y: float, heading: float | None = None) -> Measurement:
    """A measurement that has the nominal deviations once the observer's own noise is added."""
    v = math.inf if heading is None else OF_HEADING - GAINS.heading_noise**2
    r = R - GAINS.noise**2
    return Measurement(x, y, r, 0.0, r, heading or 0.0, v, 4.5, 1.8)


def rows(p: Any, sigma: float, heading: Any = None) -> np.ndarray:
    """Rows (n, 9) at p (n, 2) [m]; sigma is what they claim [m]."""
    y = np.zeros((len(p), 9))
    y[:, :2], y[:, 2], y[:, 4], y[:, 6] = p, sigma**2, sigma**2, np.inf
    if heading is not None:
        y[:, 5], y[:, 6] = heading, 0.02**2
    return y


def run(y: np.ndarray, dt: float = 0.1, gains: Any = GAINS) -> np.ndarray:
    return observers.batch(inv, y[None], np.full((1, len(y)), dt), gains)[0]


def seen_from(s: Any, true: Any) -> np.ndarray:
    """Error (7,) of s in the frame of the true state."""
    c, n = math.cos(true.chi), math.sin(true.chi)
    dx, dy = s.x - true.x, s.y - true.y
    turn = math.remainder(s.chi - true.chi, math.tau)
    along, across = c * dx + n * dy, c * dy - n * dx
    return np.array([along, s.V - true.V, s.A - true.A, across, turn, s.k - true.k, s.beta - true.beta])


def moved(true: Any, e: np.ndarray) -> Any:
    """The state with the error e (7,)."""
    c, n = math.cos(true.chi), math.sin(true.chi)
    return true._replace(
        x=true.x + c * e[0] - n * e[3],
        y=true.y + n * e[0] + c * e[3],
        V=true.V + e[1],
        A=true.A + e[2],
        chi=true.chi + e[4],
        k=true.k + e[5],
        beta=true.beta + e[6],
    )


def rolling(chi: float, V: float, yaw_rate: float) -> Any:
    """A settled state on its circle."""
    k = yaw_rate / V
    return inv.State(3.0, -4.0, chi, V, 0.0, k, math.asin(GAINS.l_r * k), 100.0, 0.0, 0.0, 0.0)


@settings(max_examples=50, deadline=None)
@given(st.floats(0.01, 2.0), st.sampled_from([0.5, 0.8, 1.0, 1.5]), st.floats(0.0, 0.5))
def test_the_poles_are_where_they_are_said_to_be(d: float, shape: float, fade: float) -> None:
    g = (1.0 - math.exp(-fade)) / fade if fade > 1e-4 else 1.0
    F = np.array(
        [[1.0, 1.0, (1.0 - g) / fade if fade > 1e-4 else 0.5], [0.0, 1.0, g], [0, 0, math.exp(-fade)]]
    )
    closed = F - np.outer(inv.placed(d, shape, fade), F[0])
    pair = complex(shape, math.sqrt(1.0 - shape**2)) if shape < 1.0 else shape + math.sqrt(shape**2 - 1.0)
    other = pair.conjugate() if shape < 1.0 else shape - math.sqrt(shape**2 - 1.0)
    want = np.poly(np.exp(-d * np.array([1.0, pair, other]))).real
    assert np.poly(closed) == pytest.approx(want, abs=1e-6 if 1e-4 >= fade > 0 else 1e-9)


@pytest.mark.parametrize(("speed", "heading"), [(4.0, 0.3), (15.0, -2.0)])
def test_a_free_error_across_decays_in_arc_length_whatever_the_clock(speed: float, heading: float) -> None:
    """The real pole of the chain: started on its eigenvector, the error is exp(-ds / arc) a sample."""
    rng = np.random.default_rng(4)
    gains = LINEAR._replace(v0=1e-6, heading=0.0)
    arc = gains.arc * (speed / inv.NOMINAL[1]) ** (1.0 / 3.0)
    true = rolling(heading, speed, 0.0)
    for dt in rng.uniform(0.05, 0.2, 5):
        L = inv.correction(dt, speed, 100.0, R, R, OF_HEADING, gains)
        A = proof.error_matrix(dt, speed, 0.0, L, 1.0, 0.0, gains)[3:6, 3:6]
        values, vectors = np.linalg.eig(A)
        i = np.argmin(np.abs(values - math.exp(-speed * dt / arc)))
        e = np.zeros(7)
        e[3:6] = 1e-6 * vectors[:, i].real
        after = inv._driven(true, dt, gains)
        s = inv.step(moved(true, e), nominal(0, 0), nominal(after.x, after.y), dt, gains)
        got = seen_from(s, after)[3:6]
        assert got == pytest.approx(math.exp(-speed * dt / arc) * e[3:6], rel=1e-4, abs=1e-11)


@pytest.mark.parametrize(
    ("dt", "V", "w", "chi"), [(0.1, 9.0, 0.4, 1.1), (0.05, 5.0, -0.6, -3.0), (0.15, 25.0, 0.0, 0)]
)
@pytest.mark.parametrize("headed", [True, False])
def test_the_error_matrices_are_the_observers_own(
    dt: float, V: float, w: float, chi: float, headed: bool
) -> None:
    true = rolling(chi, V, w)
    after = inv._driven(true, dt, LINEAR)
    y = nominal(after.x, after.y, after.chi - after.beta if headed else None)
    L = inv.correction(dt, V, 100.0, R, R, OF_HEADING, LINEAR)
    h = 1e-6
    columns = [
        (seen_from(inv.step(moved(true, h * e), y, y, dt, LINEAR), after)
         - seen_from(inv.step(moved(true, -h * e), y, y, dt, LINEAR), after)) / (2.0 * h)
        for e in np.eye(7)
    ]  # fmt: skip
    matrix = proof.error_matrix(dt, V, w, L, 1.0, 1.0 if headed else 0.0, LINEAR)
    np.testing.assert_allclose(np.array(columns).T, matrix, rtol=0.0, atol=2e-6)


@pytest.mark.parametrize("seed", range(8))
def test_the_error_matrices_hold_for_saturated_steps(seed: int) -> None:
    """Both innovations beyond their limits: the step is the matrix of the weights that the limits make."""
    rng, dt, limit = np.random.default_rng(seed), 0.1, 1e-6
    gains = LINEAR._replace(huber=limit)
    true = rolling(rng.uniform(-3.0, 3.0), rng.uniform(6.0, 20.0), rng.uniform(-0.5, 0.5))
    after, e = inv._driven(true, dt, gains), 1e-5 * rng.normal(size=7)
    s = moved(true, e)
    y = nominal(after.x, after.y, after.chi - after.beta)
    before = seen_from(inv._driven(s, dt, gains), after)
    L = inv.correction(dt, true.V, 100.0, R, R, OF_HEADING, gains)
    square = before[0] ** 2 * (1.0 - L.along.p) / R + before[3] ** 2 * (1.0 - L.across.p) / R
    u = min(1.0, limit / math.sqrt(square))
    h = min(1.0, limit * proof.NOMINAL_HEADING / abs(before[4] - before[6]))
    assert min(u, h) < 0.9
    want = proof.error_matrix(dt, true.V, true.V * true.k, L, u, h, gains) @ e
    np.testing.assert_allclose(seen_from(inv.step(s, y, y, dt, gains), after), want, rtol=1e-3, atol=2e-9)


def test_the_certificate_holds_and_fails_for_other_gains() -> None:
    c = inv.certificate()
    assert c.proven()
    assert len(c.matrices) == len(proof.WEIGHTS) * 2 * math.prod(proof.GRID)
    for change in ({"tau": 0.14}, {"arc": 1.2}, {"arc": 4.6}, {"turn": 3.5}, {"relax": 10.0}, {"l_r": 1.0}):
        assert inv.certificate(GAINS._replace(**change)).margin() < 0.0


def test_the_certificate_holds_between_the_grid_points() -> None:
    """A'PA is convex in A: what A differs from interpolation must fit in the margin; it is taken twice."""
    T = np.linalg.cholesky(inv.certificate().P).T
    back = np.linalg.inv(T)
    dts, speeds, rates, accelerations, *_ = proof.REGION.values()
    axes = np.geomspace(*dts, 12), np.geomspace(*speeds, 33), np.linspace(0.0, rates[1], 7)
    middles = [np.sqrt(a[1:] * a[:-1]) for a in axes[:2]] + [0.5 * (axes[2][1:] + axes[2][:-1])]

    def scaled(points: Any, u: float, h: float, a: float) -> np.ndarray:
        out = []
        for dt, V, w in product(*points):
            L = inv.correction(dt, V, np.inf, R, R, OF_HEADING, GAINS)
            A = proof.error_matrix(dt, V, w, L, u, h, GAINS) / proof._size(V, GAINS)
            out.append(math.exp(proof.DECAY * dt) * T @ (proof._size(V + a * dt, GAINS)[:, None] * A) @ back)
        return np.reshape(out, (*map(len, points), 7, 7))

    for u, h in proof.WEIGHTS:
        corners = np.array([scaled(axes, u, h, a) for a in accelerations])
        norms = np.linalg.norm(corners, 2, axis=(-2, -1))
        cells = list(product(*[(slice(0, -1), slice(1, None))] * 3))
        most = np.max([norms[:, *cell] for cell in cells], axis=(0, 1))
        mean = np.mean([corners[:, *cell] for cell in cells], axis=(0, 1))
        off = np.linalg.norm(scaled(middles, u, h, 0.0) - mean, 2, axis=(-2, -1))
        assert (most + 2.0 * off).max() < 1.0


@pytest.mark.parametrize("seed", range(6))
def test_small_errors_shrink_no_slower_than_certified(seed: int) -> None:
    """Any heading, any path of the region, irregular samples, headings that come and go, noise-free."""
    rng = np.random.default_rng(seed)
    dts, _, rates, *_ = proof.REGION.values()
    P = inv.certificate().P
    true = rolling(rng.uniform(-3.0, 3.0), rng.uniform(7.0, 23.0), rng.uniform(*rates) * 0.9)
    e = 1e-5 * rng.normal(size=7)
    s = moved(true, e)
    size = proof._size(true.V, GAINS) * seen_from(s, true)
    V0, t = math.sqrt(size @ P @ size), 0.0
    for _ in range(60):
        dt = rng.uniform(*dts)
        after = inv._driven(true, dt, LINEAR)
        y = nominal(after.x, after.y, after.chi - after.beta if rng.random() < 0.5 else None)
        s, true, t = inv.step(s, y, y, dt, LINEAR), after, t + dt
        size = proof._size(true.V, GAINS) * seen_from(s, true)
        assert math.sqrt(size @ P @ size) <= 1.001 * V0 * math.exp(-proof.DECAY * t) + 1e-9


def test_bounds_hold_under_the_worst_noise_and_are_reached() -> None:
    """Straight on at 10 m/s: noise with the signs of the impulse response, turned round in time."""
    n, dt, bound, small = 300, 0.1, {(b.of, b.by): b for b in inv.certificate().bounds}, 1e-3
    gains = LINEAR._replace(heading=0.0)
    for of, by, i, j in (("speed", "position along", 1, 0), ("position across", "position across", 3, 3)):
        b = bound[of, by]
        x, responses = b.B[0][:, 0], []
        for _ in range(n):
            responses.append(float(b.C[0] @ x))
            x = b.A[0] @ x
        noise = small * np.sign(responses)[::-1]
        true = rolling(0.0, 10.0, 0.0)
        s, worst = true, 0.0
        for d in noise:
            true = inv._driven(true, dt, gains)
            y = nominal(true.x + (d if j == 0 else 0.0), true.y + (d if j == 3 else 0.0))
            s = inv.step(s, y, y, dt, gains)
            worst = max(worst, abs(seen_from(s, true)[i]))
        assert 0.8 * b.gain * small < worst < 1.02 * b.gain * small


@pytest.mark.parametrize("direction", range(4))
def test_an_outlier_of_20_m_leaves_little_behind(direction: int) -> None:
    p = np.column_stack([0.8 * np.arange(120), np.zeros(120)])
    y = rows(p, 0.02)
    y[60, direction // 2] += 20.0 * (-1) ** direction
    s = run(y)
    e = np.hypot(*(s[:, :2] - p).T)
    assert e[60:].max() < 1.0
    assert e[80:].max() < 0.1
    assert np.abs(s[90:, 3] - 8.0).max() < 0.2


@pytest.mark.parametrize(("jump", "samples"), [(1.0, 20), (5.0, 40), (20.0, 60)])
def test_what_really_jumps_is_followed(jump: float, samples: int) -> None:
    """Saturation widens with its run, so a limit that is too tight cannot lose the vehicle."""
    p = np.column_stack([0.8 * np.arange(160), np.where(np.arange(160) < 60, 0.0, jump)])
    s = run(rows(p, 0.02))
    assert np.hypot(*(s[60 + samples :, :2] - p[60 + samples :]).T).max() < 0.1
    assert s[60 + samples :, 9].max() == 0.0


def test_speed_passes_through_zero_with_and_without_a_heading() -> None:
    v = np.r_[np.full(50, 3.0), np.linspace(3.0, -3.0, 30), np.full(60, -3.0)]
    p = np.column_stack([np.cumsum(0.1 * v), np.zeros(len(v))])
    for heading in (None, 0.0):
        s = run(rows(p, 0.02, heading))
        assert s[-1, 3] == pytest.approx(-3.0, abs=0.1)
        assert s[-1, 2] == pytest.approx(0.0, abs=0.1)
        assert np.hypot(*(s[20:, :2] - p[20:]).T).max() < 0.3


@pytest.mark.parametrize("sigma", [0.02, 0.05, 0.1])
def test_a_parked_car_does_not_drive_off(sigma: float) -> None:
    rng = np.random.default_rng(8)
    s = run(rows(rng.normal(0.0, sigma, (600, 2)), sigma))[100:]
    assert np.abs(s[:, 3].mean()) < 0.2 * sigma
    assert np.abs(s[:, 3]).mean() < 3.5 * sigma
    assert np.hypot(s[:, 0], s[:, 1]).max() < 4.0 * sigma


@pytest.mark.parametrize("direction", range(4))
def test_a_car_that_drives_off_sideways_is_caught(direction: int) -> None:
    """It stands, so its course is a guess; then it drives off to any side."""
    rng, t = np.random.default_rng(9), 0.1 * np.arange(140)
    way, a = 0.75 * np.maximum(t - 4.0, 0.0) ** 2, 0.3 + 0.5 * np.pi * direction
    p = way[:, None] * [np.cos(a), np.sin(a)]
    s = run(rows(p + rng.normal(0.0, 0.02, p.shape), 0.02))
    v = s[:, 3:4] * np.column_stack([np.cos(s[:, 2]), np.sin(s[:, 2])])
    true = 1.5 * np.maximum(t - 4.0, 0.0)[:, None] * [np.cos(a), np.sin(a)]
    assert np.hypot(*(v - true)[80:].T).max() < 1.0
    assert np.hypot(*(s[:, :2] - p)[10:].T).max() < 1.0


def test_a_heading_that_flips_once_turns_nothing_and_one_that_stays_turns_the_car() -> None:
    p = np.column_stack([0.8 * np.arange(60), np.zeros(60)])
    heading = np.zeros(60)
    heading[30] = np.pi
    s = run(rows(p, 0.02, heading))
    assert np.abs(s[25:, 2]).max() < 0.02
    heading[30:] = np.pi
    s = run(rows(p, 0.02, heading))
    assert np.cos(s[40, 2]) == pytest.approx(-1.0, abs=1e-2)
    assert s[40, 3] == pytest.approx(-8.0, abs=0.05)


def test_the_start_is_wide() -> None:
    """Gains come down from those of a fit to few samples to the settled ones, and stay there."""
    young = inv.correction(0.1, 10.0, 0.2, R, R, OF_HEADING, GAINS)
    old = inv.correction(0.1, 10.0, 2.0, R, R, OF_HEADING, GAINS)
    assert young.along.p > old.along.p
    assert young.across.p > old.across.p
    assert old == inv.correction(0.1, 10.0, math.inf, R, R, OF_HEADING, GAINS)


@pytest.mark.parametrize("lag", [1, 2, 4])
def test_smoothing_inverts_driving_and_cuts_the_error(lag: int) -> None:
    rng, t = np.random.default_rng(11), 0.1 * np.arange(400)
    speed, rate = 8.0 + 2.0 * np.sin(0.7 * t), 0.4 * np.sin(0.5 * t)
    course = np.cumsum(0.1 * rate)
    v = speed[:, None] * np.column_stack([np.cos(course), np.sin(course)])
    p = np.cumsum(0.1 * v, axis=0) - 0.05 * v
    y, dt = rows(p + rng.normal(0.0, 0.05, p.shape), 0.05), np.full((1, 400), 0.1)
    s = observers.batch(inv, y[None], dt, GAINS)
    smooth = observers.lagged(inv, s, dt, lag, GAINS)

    def error(s: np.ndarray) -> float:
        e = (
            s[0, 30:390, 3:4] * np.column_stack([np.cos(s[0, 30:390, 2]), np.sin(s[0, 30:390, 2])])
            - v[30:390]
        )
        return float(np.sqrt((e**2).sum(1).mean()))

    assert error(smooth) < (0.9, 0.75, 0.75)[(1, 2, 4).index(lag)] * error(s)
    a = inv.State(*map(float, s[0, 50]))
    back = inv.smooth(a, inv._driven(a, 0.1, GAINS), 0.1, GAINS)
    assert back[:6] == pytest.approx(a[:6], abs=1e-9)
