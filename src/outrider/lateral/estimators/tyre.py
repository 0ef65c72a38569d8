"""Extended Kalman filter on a single track whose tyres saturate; the road's friction is given.

    vy' = (Ff + Fr) / m + u + w - vx r        u' = -u / fade + noise
    r'  = (lf (Ff + m u) - lr (Fr + m w)) / Iz     w' = -w / fade + noise
    measured: r and ay = (Ff + Fr) / m + u + w

Ff, Fr of `_tyre`; u, w what these miss at the front and the rear axle, over the mass. With a known tyre the
forces tell the slip angles, so vy is observed, other than by the linear model, also where the car is neutral.
"""

from __future__ import annotations

from math import isfinite
from typing import Any, NamedTuple

from outrider.cars import Car
from outrider.kernel import from_row, kernel, matrix, to_row
from outrider.lateral import Estimate, Sample
from outrider.lateral.estimators._linear import midway, positive, steady
from outrider.lateral.estimators._tyre import MOST, Limits, carried, correct, forces, keep, limits, tangent
from outrider.observers._gaussian import congruence, pack, unpack

reference = (
    "A. H. Jazwinski, Stochastic Processes and Filtering Theory, Academic Press, 1970: section 8.3; single "
    "track of Fenyes, Hegedus, Van Tan and Gaspar, ICINCO 2023, eq. 11; tanh tyre, force errors: own choice"
)


class State(NamedTuple):
    """Estimate at the time of the last sample and that sample's inputs, then the covariance's lower half."""

    vy: float  # [m/s]
    yaw_rate: float  # [rad/s]
    u: float  # [m/s2]
    w: float  # [m/s2]
    steering: float  # [rad]
    vx: float  # [m/s]
    p00: float
    p10: float
    p11: float
    p20: float
    p21: float
    p22: float
    p30: float
    p31: float
    p32: float
    p33: float


class Gains(NamedTuple):
    """The road, and the noise of model and sensors."""

    friction: float = 1.0  # of the road, beside the car's own grip [-]
    noise_yaw: float = 0.02  # standard deviation of a measured yaw rate [rad/s]
    noise_ay: float = 1.0  # of a measured lateral acceleration, vibration included [m/s2]
    walk_vy: float = 0.2  # white noise on vy' [m/s2/sqrt(Hz)]
    walk_yaw: float = 0.3  # white noise on r' [rad/s2/sqrt(Hz)]
    missed: float = 0.1  # standard deviation of u and of w [m/s2]
    fade: float = 1.0  # time constant of both [s]


class Design(NamedTuple):
    """What is computed once."""

    gains: Gains
    most: Limits


def prepare(car: Car, gains: Gains, dt: float) -> Design:
    """Limits of the axles; InputError for a friction, noise or time that is not positive."""
    g = gains
    positive("tyre", friction=g.friction, noise_yaw=g.noise_yaw, noise_ay=g.noise_ay, fade=g.fade)
    return Design(gains, limits(car, gains.friction))


@kernel
def start(sample: Sample, car: Car, design: Design) -> State:
    """In a steady turn at the measured yaw rate."""
    x, P, g = matrix(1, 4), matrix(4, 4), design.gains
    x[0, 0], x[0, 1] = steady(sample.yaw_rate, sample.vx, car), sample.yaw_rate
    P[0, 0], P[1, 1], P[2, 2], P[3, 3] = 0.5**2, g.noise_yaw**2, g.missed**2, g.missed**2
    return _state(x, P, sample)


@kernel
def step(state: State, sample: Sample, car: Car, design: Design) -> State:
    """Prediction with the mean inputs of the step, then the corrections by yaw rate and, if there, by ay."""
    x, P, H, g = matrix(1, 4), matrix(4, 4), matrix(1, 4), design.gains
    _load(state, x, P)
    delta, vx = 0.5 * (state.steering + sample.steering), midway(state.vx, sample.vx)
    _predict(x, P, delta, vx, sample.dt, car, design)
    H[0, 1] = 1.0
    correct(x, P, H, sample.yaw_rate - x[0, 1], g.noise_yaw**2)
    if isfinite(sample.ay):
        f = forces(x[0, 0], x[0, 1], sample.steering, sample.vx, car, design.most)
        m = tangent(f, sample.vx, car)
        H[0, 0], H[0, 1], H[0, 2], H[0, 3] = m.a11, m.a12 + sample.vx, 1.0, 1.0
        e = sample.ay - (f.front + f.rear) / car.mass - x[0, 2] - x[0, 3]
        correct(x, P, H, e, g.noise_ay**2)
    if not abs(x[0, 0]) < MOST or not isfinite(x[0, 1] + x[0, 2] + x[0, 3] + P[0, 0]):
        return start(sample, car, design)
    return _state(x, P, sample)


@kernel
def output(state: State, sample: Sample, car: Car, design: Design) -> Estimate:
    """The first components of the state; the yaw-rate sensor's bias is not estimated."""
    return Estimate(state.vy, state.yaw_rate, 0.0)


@kernel
def _predict(x: Any, P: Any, delta: float, vx: float, dt: float, car: Car, design: Design) -> None:
    """x (1, 4), P (4, 4) after dt [s]: along the tangent of the tyres, exactly."""
    F, M, g = matrix(4, 4), matrix(4, 4), design.gains
    f = forces(x[0, 0], x[0, 1], delta, vx, car, design.most)
    u, w = car.mass * car.front / car.inertia, -car.mass * car.rear / car.inertia  # of r' by u and w
    across = (f.front + f.rear) / car.mass + x[0, 2] + x[0, 3] - vx * x[0, 1]
    about = (car.front * f.front - car.rear * f.rear) / car.inertia + u * x[0, 2] + w * x[0, 3]
    n = carried(tangent(f, vx, car), across, about, dt)
    x[0, 0] += n.b1
    x[0, 1] += n.b2
    left, h = keep(g.fade, dt), 0.5 * dt
    F[0, 0], F[0, 1], F[1, 0], F[1, 1], F[2, 2], F[3, 3] = n.a11, n.a12, n.a21, n.a22, left, left
    F[0, 2], F[0, 3] = h * (1.0 + n.a11 + n.a12 * u), h * (1.0 + n.a11 + n.a12 * w)
    F[1, 2], F[1, 3] = h * (u + n.a21 + n.a22 * u), h * (w + n.a21 + n.a22 * w)
    x[0, 2] *= left
    x[0, 3] *= left
    congruence(F, P, M)
    P[0, 0] += g.walk_vy**2 * dt
    P[1, 1] += g.walk_yaw**2 * dt
    P[2, 2] += g.missed**2 * (1.0 - left * left)
    P[3, 3] += g.missed**2 * (1.0 - left * left)


@kernel
def _load(state: State, x: Any, P: Any) -> None:
    """Mean (1, 4) and covariance (4, 4)."""
    row = matrix(1, 16)[0]
    to_row(state, row)
    for i in range(4):
        x[0, i] = row[i]
    unpack(row, 6, P)


@kernel
def _state(x: Any, P: Any, sample: Sample) -> State:
    """State of mean, covariance and the sample's inputs."""
    row = matrix(1, 16)[0]
    for i in range(4):
        row[i] = x[0, i]
    row[4], row[5] = sample.steering, sample.vx
    pack(P, row, 6)
    state: State = from_row(State, row)
    return state
