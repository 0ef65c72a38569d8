"""What the estimators on the linear single track share: the step of the model, and Riccati's gains.

x+ = Phi(vx, dt) x + Gamma(vx, dt) delta,  r measured;  x = (vy, r)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from outrider.cars import Car
from outrider.errors import InputError
from outrider.kernel import kernel
from outrider.models.single_track import linear, sampled

Array = npt.NDArray[np.float64]

C = np.array([[0.0, 1.0]])  # of x the yaw rate is measured
SLOWEST, PITCH, POINTS = 1.0, 0.5, 159  # of a table over speed: 1 to 80 m/s; then the same in reverse


@kernel
def predicted(vy: float, r: float, delta: float, vx: float, dt: float, car: Any) -> tuple[float, float]:
    """Lateral velocity [m/s] and yaw rate [rad/s] dt [s] later, steering and speed as given all the time."""
    m = sampled(linear(vx, car), dt)
    return m.a11 * vy + m.a12 * r + m.b1 * delta, m.a21 * vy + m.a22 * r + m.b2 * delta


@kernel
def steady(r: float, vx: float, car: Any) -> float:
    """Lateral velocity in a steady turn at yaw rate r: the rear axle carries its share of m vx r [m/s]."""
    share = car.mass * car.front / ((car.front + car.rear) * car.rear_stiffness)
    vy: float = r * (car.rear - share * vx * abs(vx))
    return vy


@kernel
def midway(a: float, b: float) -> float:
    """Mean of a speed at both ends of a step; the later one where the car has turned back between."""
    return 0.5 * (a + b) if a * b > 0.0 else b


def table() -> Array:
    """Speeds (2 POINTS,) of a table: forward from the slowest, then in reverse from the slowest [m/s]."""
    forward = SLOWEST + PITCH * np.arange(POINTS)
    return np.concatenate([forward, -forward])


@kernel
def tabled(vx: float) -> tuple[int, float]:
    """Row i of a table and weight w: the value at vx [m/s] is w row i + (1 - w) row i + 1; ends are kept."""
    place = min(max((abs(vx) - SLOWEST) / PITCH, 0.0), POINTS - 1.0)
    i = min(int(place), POINTS - 2)
    return (i if vx > 0.0 else i + POINTS), 1.0 - (place - i)


def phi(speeds: Sequence[float] | Array, car: Car, dt: float) -> Array:
    """Phi (m, 2, 2) at each speed [m/s], over dt [s]."""
    return np.array([sampled(linear(float(v), car), dt)[:4] for v in speeds]).reshape(-1, 2, 2)


def riccati(F: Array, Q: Array, R: Array, H: Array = C) -> Array:
    """P (m, n, n) = F P F' - F P H' (H P H' + R)^-1 H P F' + Q: covariance of a steady prediction.

    F (m, n, n), Q (n, n) a step, H (m, k, n) or (k, n), R (k, k), all at once by doubling: each turn covers
    twice as many steps as the last. Anderson 1978, Second-order convergent algorithms for the steady-state
    Riccati equation.
    """
    one = np.eye(F.shape[-1])
    A, G, P = F.mT, H.mT @ np.linalg.solve(R, H), np.broadcast_to(Q, F.shape)
    for _ in range(60):
        W = np.linalg.inv(one + G @ P)
        grown = A.mT @ P @ W @ A
        G, P, A = G + A @ W @ G @ A.mT, P + grown, A @ W @ A
        if (np.abs(grown) <= 1e-15 * np.abs(P).max(axis=(-2, -1), keepdims=True)).all():
            break
    return 0.5 * (P + P.mT)


def correction(P: Array, R: Array, H: Array = C) -> Array:
    """K (m, n, k) = P H' (H P H' + R)^-1 of a filter, at the sample itself; of a predictor F K."""
    K: Array = P @ H.mT @ np.linalg.inv(H @ P @ H.mT + R)
    return K


def positive(where: str, **values: float) -> None:
    """InputError for the first value that is not a positive, finite number."""
    for name, value in values.items():
        if not 0.0 < value < np.inf:
            raise InputError(f"{where}: {name} = {value:g}; want a positive number")
