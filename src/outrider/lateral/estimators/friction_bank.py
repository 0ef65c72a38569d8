"""Several extended Kalman filters, each for a road of its own friction, weighted by how well they predict.

Each has the saturating tyres of `_tyre`, x = (vy, r), and yaw rate and ay as outputs. Their weights w follow

    log w+ = (1 - dt / memory) log w + eagerness dt log p(outputs),    vy = sum w vy / sum w

For a car that is known, with `identify` if need be: an unknown car is mistaken for another road.
"""

from __future__ import annotations

from math import exp, inf, isfinite, log
from typing import Any, NamedTuple

import numpy as np

from outrider.cars import Car
from outrider.kernel import from_row, kernel, matrix, to_row
from outrider.lateral import Estimate, Sample
from outrider.lateral.estimators._linear import midway, positive, steady
from outrider.lateral.estimators._tyre import MOST, Limits, carried, correct, forces, limits, tangent
from outrider.observers._gaussian import congruence

reference = (
    "D. T. Magill 1965, IEEE Trans. Automatic Control 10(4), 434-439 (filters in a bank); single track of "
    "Fenyes, Hegedus, Van Tan and Gaspar, ICINCO 2023, eq. 11; tyre and forgetting: own choice"
)

FRICTIONS = (0.3, 0.4, 0.5, 0.65, 0.8, 1.0, 1.4, 3.0)  # of the roads; on the last one tyres hardly saturate
PART = ("vy", "yaw_rate", "p00", "p10", "p11", "log_weight")  # of the state, of each filter
LEAST = 1e-4  # no weight is less: a change of the road is noticed [-]

# Estimate and covariance of every filter and its weight; then the inputs of the last sample.
FIELDS = [f"{name}_{i}" for i in range(len(FRICTIONS)) for name in PART] + ["steering", "vx"]
State: Any = NamedTuple("State", [(name, float) for name in FIELDS])  # type: ignore[misc]


class Gains(NamedTuple):
    """Noise of model and sensors, and how the weights move."""

    noise_yaw: float = 0.01  # standard deviation of a measured yaw rate [rad/s]
    noise_ay: float = 0.2  # of a measured lateral acceleration [m/s2]
    walk_vy: float = 0.03  # white noise on vy' [m/s2/sqrt(Hz)]
    walk_yaw: float = 0.1  # white noise on r' [rad/s2/sqrt(Hz)]
    memory: float = 10.0  # time constant with which weights fade towards equal ones [s]
    eagerness: float = 1.0  # rate at which the outputs move them [1/s]


class Design(NamedTuple):
    """What is computed once."""

    gains: Gains
    most: Any  # (roads, 2) as `_tyre.Limits` [N]


def prepare(car: Car, gains: Gains, dt: float) -> Design:
    """Limits of the axles on each road; InputError for a noise or time that is not positive."""
    g = gains
    positive("friction_bank", noise_yaw=g.noise_yaw, noise_ay=g.noise_ay, memory=g.memory)
    positive("friction_bank", eagerness=g.eagerness)
    return Design(gains, np.array([limits(car, friction) for friction in FRICTIONS]))


@kernel
def start(sample: Sample, car: Car, design: Design) -> State:
    """All filters in the same steady turn, their weights equal."""
    row = matrix(1, 50)[0]
    for i in range(0, 48, 6):
        _begin(row, i, sample, car, design.gains)
    row[48], row[49] = sample.steering, sample.vx
    state: State = from_row(State, row)
    return state


@kernel
def step(state: State, sample: Sample, car: Car, design: Design) -> State:
    """Every filter by the mean inputs of the step and by the sensors, then the weights."""
    row, x, P, H, g = matrix(1, 50)[0], matrix(1, 2), matrix(2, 2), matrix(1, 2), design.gains
    to_row(state, row)
    delta, vx = 0.5 * (row[48] + sample.steering), midway(row[49], sample.vx)
    fade, best = exp(-sample.dt / g.memory), -inf
    for i in range(0, 48, 6):
        most = Limits(design.most[i // 6, 0], design.most[i // 6, 1])
        x[0, 0], x[0, 1], P[0, 0], P[1, 1] = row[i], row[i + 1], row[i + 2], row[i + 4]
        P[0, 1], P[1, 0] = row[i + 3], row[i + 3]
        _predict(x, P, delta, vx, sample.dt, car, most, g)
        likely = _correct(x, P, H, sample, car, most, g)
        row[i], row[i + 1], row[i + 2], row[i + 3], row[i + 4] = x[0, 0], x[0, 1], P[0, 0], P[1, 0], P[1, 1]
        if not abs(x[0, 0]) < MOST or not isfinite(x[0, 1] + P[0, 0] + likely):
            _begin(row, i, sample, car, g)
            row[i + 5] = log(LEAST)
        else:
            row[i + 5] = fade * row[i + 5] + g.eagerness * sample.dt * likely
        best = max(best, row[i + 5])
    for i in range(5, 48, 6):
        row[i] = max(row[i] - best, -700.0)
    row[48], row[49] = sample.steering, sample.vx
    after: State = from_row(State, row)
    return after


@kernel
def output(state: State, sample: Sample, car: Car, design: Design) -> Estimate:
    """Weighted mean of all filters; the yaw-rate sensor's bias is not estimated."""
    row = matrix(1, 50)[0]
    to_row(state, row)
    vy, r, total = 0.0, 0.0, 0.0
    for i in range(0, 48, 6):
        weight = exp(row[i + 5]) + LEAST
        vy, r, total = vy + weight * row[i], r + weight * row[i + 1], total + weight
    return Estimate(vy / total, r / total, 0.0)


@kernel
def _begin(row: Any, i: int, sample: Sample, car: Car, g: Gains) -> None:
    """One filter, at row[i:], in a steady turn at the measured yaw rate."""
    row[i], row[i + 1] = steady(sample.yaw_rate, sample.vx, car), sample.yaw_rate
    row[i + 2], row[i + 3], row[i + 4], row[i + 5] = 0.5**2, 0.0, g.noise_yaw**2, 0.0


@kernel
def _predict(x: Any, P: Any, delta: float, vx: float, dt: float, car: Car, most: Limits, g: Gains) -> None:
    """x (1, 2), P (2, 2) after dt [s]: along the tangent of the tyres, exactly."""
    F, M = matrix(2, 2), matrix(2, 2)
    f = forces(x[0, 0], x[0, 1], delta, vx, car, most)
    across = (f.front + f.rear) / car.mass - vx * x[0, 1]
    n = carried(tangent(f, vx, car), across, (car.front * f.front - car.rear * f.rear) / car.inertia, dt)
    F[0, 0], F[0, 1], F[1, 0], F[1, 1] = n.a11, n.a12, n.a21, n.a22
    x[0, 0] += n.b1
    x[0, 1] += n.b2
    congruence(F, P, M)
    P[0, 0] += g.walk_vy**2 * dt
    P[1, 1] += g.walk_yaw**2 * dt


@kernel
def _correct(x: Any, P: Any, H: Any, sample: Sample, car: Car, most: Limits, g: Gains) -> float:
    """x (1, 2), P (2, 2) by yaw rate and, if there, by ay; log-likelihood of what was measured."""
    H[0, 0], H[0, 1] = 0.0, 1.0
    square, s = correct(x, P, H, sample.yaw_rate - x[0, 1], g.noise_yaw**2)
    likely = -0.5 * (square + log(s))
    if isfinite(sample.ay):
        f = forces(x[0, 0], x[0, 1], sample.steering, sample.vx, car, most)
        m = tangent(f, sample.vx, car)
        H[0, 0], H[0, 1] = m.a11, m.a12 + sample.vx
        square, s = correct(x, P, H, sample.ay - (f.front + f.rear) / car.mass, g.noise_ay**2)
        likely -= 0.5 * (square + log(s))
    return likely
