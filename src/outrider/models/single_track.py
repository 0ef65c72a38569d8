"""Dynamic single track: lateral velocity and yaw rate of a car under steering, at a given speed.

    vy' = A11 vy + A12 r + B1 delta     A11 = -(Cf + Cr) / (m vx)         A12 = -(Cf lf - Cr lr) / (m vx) - vx
    r'  = A21 vy + A22 r + B2 delta     A21 = -(Cf lf - Cr lr) / (Iz vx)  A22 = -(Cf lf^2 + Cr lr^2) / (Iz vx)
    B1 = Cf / m                         B2 = Cf lf / Iz

vy lateral velocity of the centre of gravity, y left [m/s], r yaw rate [rad/s], delta angle of the front
wheels [rad], vx speed [m/s]. Source: Fenyes, Hegedus, Van Tan and Gaspar 2023, eq. 11, signs restored.
Functions take numbers, and compile as they stand.
"""

from __future__ import annotations

from math import cos, cosh, exp, sin, sinh, sqrt
from typing import Any, NamedTuple

from outrider.kernel import kernel


class Linear(NamedTuple):
    """x' = A x + B delta, or x+ = A x + B delta over a step; x = (vy, r)."""

    a11: float
    a12: float
    a21: float
    a22: float
    b1: float
    b2: float


@kernel
def linear(vx: float, car: Any) -> Linear:
    """The model at speed vx [m/s], not zero; negative in reverse. car: `cars.Car`.

    A tyre resists sideways motion whichever way it rolls, so the slip counts by |vx|; steering turns round.
    """
    f, r = car.front_stiffness, car.rear_stiffness
    moment, pace, way = f * car.front - r * car.rear, abs(vx), 1.0 if vx > 0.0 else -1.0
    return Linear(
        -(f + r) / (car.mass * pace),
        -moment / (car.mass * pace) - vx,
        -moment / (car.inertia * pace),
        -(f * car.front * car.front + r * car.rear * car.rear) / (car.inertia * pace),
        way * f / car.mass,
        way * f * car.front / car.inertia,
    )


@kernel
def sampled(m: Linear, dt: float) -> Linear:
    """The model over a step of dt [s] with constant steering and speed: exact."""
    s = 0.5 * (m.a11 + m.a22) * dt
    d = 0.5 * (m.a11 - m.a22) * dt
    q2 = d * d + m.a12 * m.a21 * dt * dt
    q = sqrt(abs(q2))
    grown = exp(s)
    if q < 1e-6:
        c, k = grown, grown
    elif q2 > 0.0:
        c, k = grown * cosh(q), grown * sinh(q) / q
    else:
        c, k = grown * cos(q), grown * sin(q) / q
    p11, p12, p21, p22 = c + k * d, k * m.a12 * dt, k * m.a21 * dt, c - k * d
    det = m.a11 * m.a22 - m.a12 * m.a21
    if abs(det) * dt * dt < 1e-9:  # an integral over the step by its middle
        u1 = m.b1 + 0.5 * dt * (m.a11 * m.b1 + m.a12 * m.b2)
        u2 = m.b2 + 0.5 * dt * (m.a21 * m.b1 + m.a22 * m.b2)
        return Linear(p11, p12, p21, p22, dt * u1, dt * u2)
    v1 = (p11 - 1.0) * m.b1 + p12 * m.b2
    v2 = p21 * m.b1 + (p22 - 1.0) * m.b2
    return Linear(p11, p12, p21, p22, (m.a22 * v1 - m.a12 * v2) / det, (m.a11 * v2 - m.a21 * v1) / det)


@kernel
def lateral_acceleration(vy: float, r: float, delta: float, vx: float, car: Any) -> float:
    """Acceleration of the centre of gravity to the left [m/s2]: what a level sensor reads there."""
    m = linear(vx, car)
    a: float = m.a11 * vy + (m.a12 + vx) * r + m.b1 * delta
    return a
