"""Kalman filter on the single track that knows where its tyres are straight lines no more: the default.

    vy' = A11 vy + A12 r + B1 delta + w      w' = -w / fade + noise
    r'  = A21 vy + A22 r + B2 delta + noise
    yaw rate measured = r + b
    ay measured       = A11 vy + (A12 + vx) r + B1 delta + w + a

w: acceleration that the linear tyres miss, expected to be larger the harder the car turns: on a straight the
tyres say what the lateral velocity is, in a fast corner the accelerometer says how it changes. b, a: constant
errors of the sensors, a road's bank among them, told apart by their share at different speeds; a standing car
shows b alone. Steering and speed of a step are the means of both its ends; without ay the yaw rate is used.
"""

from __future__ import annotations

from math import exp, isfinite
from typing import Any, NamedTuple

from outrider.cars import Car
from outrider.kernel import from_row, kernel, matrix, to_row
from outrider.lateral import LEAST_SPEED, Estimate, Sample
from outrider.lateral.estimators._linear import midway, positive, steady
from outrider.models.single_track import Linear, linear, sampled
from outrider.observers._gaussian import pack, unpack

reference = (
    "R. E. Kalman 1960, A New Approach to Linear Filtering and Prediction Problems; single track of Fenyes, "
    "Hegedus, Van Tan and Gaspar, ICINCO 2023, eq. 11; the missed acceleration w is our own choice"
)

STANDING = 0.1  # slower, a car counts as standing: its yaw rate is 0 [m/s]
START = 0.3  # standard deviation of vy at a start [m/s]


class State(NamedTuple):
    """Estimate at the time of the last sample and that sample's inputs, then the covariance's lower half."""

    vy: float  # [m/s]
    yaw_rate: float  # [rad/s]
    w: float  # [m/s2]
    b: float  # [rad/s]
    a: float  # [m/s2]
    steering: float  # [rad]
    vx: float  # [m/s]
    vy_vy: float
    r_vy: float
    r_r: float
    w_vy: float
    w_r: float
    w_w: float
    b_vy: float
    b_r: float
    b_w: float
    b_b: float
    a_vy: float
    a_r: float
    a_w: float
    a_b: float
    a_a: float


class Gains(NamedTuple):
    """Noise of model and sensors."""

    noise_yaw: float = 0.02  # standard deviation of a measured yaw rate [rad/s]
    noise_ay: float = 0.2  # of a measured lateral acceleration [m/s2]
    walk_vy: float = 0.02  # white noise on vy' [m/s2/sqrt(Hz)]
    walk_yaw: float = 3.0  # white noise on r' [rad/s2/sqrt(Hz)]
    missed: float = 0.003  # standard deviation of w / A11, what the tyres get wrong of vy, at no ay [m/s]
    missed_ay: float = 0.0005  # and what it grows by with the square of ay [s3/m]
    fade: float = 1.0  # time constant of w [s]
    bias_yaw: float = 0.005  # standard deviation of b at the start [rad/s]
    bias_ay: float = 0.2  # of a [m/s2]
    forget: float = 600.0  # sensors have other errors after this time [s]


Design = Gains  # nothing is computed beforehand


def prepare(car: Car, gains: Gains, dt: float) -> Gains:
    """The gains themselves; InputError for a noise or time that is not positive."""
    g = gains
    positive("kalman", noise_yaw=g.noise_yaw, noise_ay=g.noise_ay, fade=g.fade, forget=g.forget)
    return gains


@kernel
def start(sample: Sample, car: Car, design: Gains) -> State:
    """In a steady turn at the measured yaw rate."""
    x, P = matrix(1, 5), matrix(5, 5)
    x[0, 0], x[0, 1] = steady(sample.yaw_rate, sample.vx, car), sample.yaw_rate
    P[3, 3], P[4, 4] = design.bias_yaw**2, design.bias_ay**2
    _begin(P, sample, car, design)
    return _state(x, P, sample)


@kernel
def step(state: State, sample: Sample, car: Car, design: Gains) -> State:
    """Prediction with the mean inputs of the step, then the corrections by yaw rate and, if there, by ay."""
    x, P, H = matrix(1, 5), matrix(5, 5), matrix(1, 5)
    _load(state, x, P)
    delta, v = 0.5 * (state.steering + sample.steering), midway(state.vx, sample.vx)
    _predict(x, P, delta, linear(v, car), sample.dt, v, design)
    H[0, 1], H[0, 3] = 1.0, 1.0
    _correct(x, P, H, sample.yaw_rate - x[0, 1] - x[0, 3], design.noise_yaw**2)
    if isfinite(sample.ay):
        m = linear(sample.vx, car)
        H[0, 0], H[0, 1], H[0, 2], H[0, 3], H[0, 4] = m.a11, m.a12 + sample.vx, 1.0, 0.0, 1.0
        e = sample.ay - m.b1 * sample.steering
        for i in range(5):
            e -= H[0, i] * x[0, i]
        _correct(x, P, H, e, design.noise_ay**2)
    return _state(x, P, sample)


@kernel
def still(state: State, sample: Sample, car: Car, design: Gains) -> State:
    """Slow: a drive will begin anew, knowing the sensors; standing: what the yaw rate says is its error."""
    x, P, H = matrix(1, 5), matrix(5, 5), matrix(1, 5)
    _load(state, x, P)
    if abs(sample.vx) < STANDING and abs(sample.yaw_rate - x[0, 3]) < 3.0 * design.noise_yaw:
        H[0, 3] = 1.0
        _correct(x, P, H, sample.yaw_rate - x[0, 3], design.noise_yaw**2)
    r = sample.yaw_rate - x[0, 3]
    x[0, 0], x[0, 1], x[0, 2] = steady(r, sample.vx, car), r, 0.0
    _begin(P, sample, car, design)
    return _state(x, P, sample)


@kernel
def output(state: State, sample: Sample, car: Car, design: Gains) -> Estimate:
    """The first components of the state."""
    return Estimate(state.vy, state.yaw_rate, state.b)


@kernel
def _begin(P: Any, sample: Sample, car: Car, design: Gains) -> None:
    """Covariance P (5, 5) of lateral velocity, yaw rate and w at a start; the sensors' errors keep theirs."""
    for i in range(3):
        for j in range(5):
            P[i, j] = 0.0
            P[j, i] = 0.0
    vx = max(abs(sample.vx), LEAST_SPEED)
    s = _missed(vx * sample.yaw_rate, linear(vx, car), design)
    P[0, 0], P[1, 1], P[2, 2] = START**2, design.noise_yaw**2, s * s


@kernel
def _missed(ay: float, m: Linear, design: Gains) -> float:
    """Standard deviation of w at a lateral acceleration ay [m/s2]."""
    return -m.a11 * (design.missed + design.missed_ay * ay * ay)


@kernel
def _predict(x: Any, P: Any, delta: float, m: Linear, dt: float, vx: float, design: Gains) -> None:
    """x (1, 5), P (5, 5) after dt [s]; exact for what is constant over the step."""
    n = sampled(Linear(m.a11, m.a12, m.a21, m.a22, 1.0, 0.0), dt)  # n.b1, n.b2: what an acceleration 1 does
    k, h = (n.a12 - m.a12 * n.b1) / m.a22, (n.a22 - 1.0 - m.a12 * n.b2) / m.a22  # and a yaw acceleration 1
    s, left = _missed(vx * x[0, 1], m, design), exp(-dt / design.fade)
    vy, r, w = x[0, 0], x[0, 1], x[0, 2] + m.b1 * delta
    x[0, 0] = n.a11 * vy + n.a12 * r + n.b1 * w + k * m.b2 * delta
    x[0, 1] = n.a21 * vy + n.a22 * r + n.b2 * w + h * m.b2 * delta
    x[0, 2] *= left
    _carry(P, n, left)
    _disturb(P, k / h, 1, design.walk_yaw**2 * dt)
    _disturb(P, 0.5 * n.b1, 2, s * s * (1.0 - left * left))
    P[0, 0] += design.walk_vy**2 * dt
    P[3, 3] += design.bias_yaw**2 * dt / design.forget
    P[4, 4] += design.bias_ay**2 * dt / design.forget


@kernel
def _carry(P: Any, n: Linear, left: float) -> None:
    """P <- F P F', F = [[n.a11, n.a12, n.b1, 0, 0], [n.a21, n.a22, n.b2, 0, 0], [0, 0, left, 0, 0], ...]."""
    for j in range(5):
        v, r, w = P[0, j], P[1, j], P[2, j]
        P[0, j] = n.a11 * v + n.a12 * r + n.b1 * w
        P[1, j] = n.a21 * v + n.a22 * r + n.b2 * w
        P[2, j] = left * w
    for i in range(5):
        v, r, w = P[i, 0], P[i, 1], P[i, 2]
        P[i, 0] = n.a11 * v + n.a12 * r + n.b1 * w
        P[i, 1] = n.a21 * v + n.a22 * r + n.b2 * w
        P[i, 2] = left * w


@kernel
def _disturb(P: Any, side: float, at: int, q: float) -> None:
    """P by a disturbance of component `at`, variance q, that moves vy `side` times as far in the step."""
    P[at, at] += q
    P[0, at] += side * q
    P[at, 0] += side * q
    P[0, 0] += side * side * q


@kernel
def _correct(x: Any, P: Any, H: Any, e: float, r: float) -> None:
    """x (1, 5), P (5, 5) by one output H x, H (1, 5): innovation e, variance r."""
    g, s = matrix(1, 5), r
    for i in range(5):
        for j in range(5):
            g[0, i] += P[i, j] * H[0, j]
        s += H[0, i] * g[0, i]
    s = 1.0 / s
    for i in range(5):
        k = g[0, i] * s
        x[0, i] += k * e
        for j in range(i + 1):
            P[i, j] -= k * g[0, j]
            P[j, i] = P[i, j]


@kernel
def _load(state: State, x: Any, P: Any) -> None:
    """Mean (1, 5) and covariance (5, 5)."""
    row = matrix(1, 22)[0]
    to_row(state, row)
    for i in range(5):
        x[0, i] = row[i]
    unpack(row, 7, P)


@kernel
def _state(x: Any, P: Any, sample: Sample) -> State:
    """State of mean, covariance and the sample's inputs."""
    row = matrix(1, 22)[0]
    for i in range(5):
        row[i] = x[0, i]
    row[5], row[6] = sample.steering, sample.vx
    pack(P, row, 7)
    state: State = from_row(State, row)
    return state
