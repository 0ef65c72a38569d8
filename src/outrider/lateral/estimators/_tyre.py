"""What the estimators with a saturating tyre share: forces, the model along their tangent, one correction.

    F = D tanh((1 - RESIDUAL) C a / D) + RESIDUAL C a        D = friction * grip * load at rest
    a_f = delta - (vy + lf r) / vx            a_r = -(vy - lr r) / vx

C stiffness of an axle [N/rad], D its most force [N], a slip angle [rad]; the rest: `models.single_track`.
"""

from __future__ import annotations

from math import exp, tanh
from typing import Any, NamedTuple

from outrider.cars import Car
from outrider.kernel import kernel, matrix
from outrider.models.single_track import Linear, linear, sampled

G = 9.81  # [m/s2]
RESIDUAL = 0.03  # slope left where a tyre slides, over its stiffness: the slip stays visible in the force [-]
MOST = 100.0  # a lateral velocity beyond is none; the filter starts anew [m/s]


class Limits(NamedTuple):
    """Most lateral force of each axle."""

    front: float  # [N]
    rear: float  # [N]


class Tangent(NamedTuple):
    """A car as `single_track.linear` takes it, its stiffness that at the slip angles of the moment."""

    mass: float
    inertia: float
    front: float
    rear: float
    front_stiffness: float
    rear_stiffness: float


class Forces(NamedTuple):
    """Of both axles, and what they change by with the slip angle."""

    front: float  # [N]
    rear: float  # [N]
    front_slope: float  # [N/rad]
    rear_slope: float  # [N/rad]


@kernel
def limits(car: Car, friction: float) -> Limits:
    """From the load at rest, on a road of this friction."""
    load = friction * car.mass * G / (car.front + car.rear)
    return Limits(load * car.rear * car.front_grip, load * car.front * car.rear_grip)


@kernel
def axle(slip: float, stiffness: float, limit: float) -> tuple[float, float]:
    """Lateral force [N] of an axle at a slip angle [rad], and its slope [N/rad]."""
    bent, straight = (1.0 - RESIDUAL) * stiffness, RESIDUAL * stiffness
    share = tanh(bent * slip / limit)
    return limit * share + straight * slip, bent * (1.0 - share * share) + straight


@kernel
def forces(vy: float, r: float, delta: float, vx: float, car: Car, most: Limits) -> Forces:
    """Of both axles; in reverse the tyres resist sideways motion all the same."""
    pace = abs(vx)
    front, a = axle((vx * delta - vy - car.front * r) / pace, car.front_stiffness, most.front)
    rear, b = axle((car.rear * r - vy) / pace, car.rear_stiffness, most.rear)
    return Forces(front, rear, a, b)


@kernel
def tangent(f: Forces, vx: float, car: Car) -> Linear:
    """The linear single track with the stiffness that the tyres have at the moment; b is not used."""
    return linear(vx, Tangent(car.mass, car.inertia, car.front, car.rear, f.front_slope, f.rear_slope))


@kernel
def carried(m: Linear, vy_rate: float, r_rate: float, dt: float) -> Linear:
    """Over a step: how errors grow (a), how far the state moves (b); exact where the tangent is the tyre."""
    return sampled(Linear(m.a11, m.a12, m.a21, m.a22, vy_rate, r_rate), dt)


@kernel
def correct(x: Any, P: Any, H: Any, e: float, variance: float) -> tuple[float, float]:
    """Kalman correction of x (1, n), P (n, n) by one output: innovation e, row H (1, n), its variance.

    Returns the square of the innovation in standard deviations, and the variance it was expected to have.
    """
    n = P.shape[0]
    g, s = matrix(1, 4), variance
    for i in range(n):
        for j in range(n):
            g[0, i] += P[i, j] * H[0, j]
        s += H[0, i] * g[0, i]
    for i in range(n):
        x[0, i] += g[0, i] / s * e
        for j in range(i + 1):
            P[i, j] -= g[0, i] * g[0, j] / s
            P[j, i] = P[i, j]
    return e * e / s, s


@kernel
def keep(time: float, dt: float) -> float:
    """What is left of something that fades with a time constant [s], dt [s] later."""
    return exp(-dt / time)
