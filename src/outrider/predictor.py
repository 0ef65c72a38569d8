"""The tracker's own short-term prediction: where a body will be one scan on, and how sure that is.

Position: constant velocity with white acceleration held over a step; heading: constant rate, likewise. It
serves the gate and the fit only; the published estimate is the observer's. Source: Bar-Shalom, Li and
Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 6.3.
"""

from __future__ import annotations

import numpy as np

from outrider.geometry import wrap
from outrider.records import Array

MEASURED = [0, 1, 4]  # x, y, heading among x, y, vx, vy, heading, yaw rate
CHAINS = ((0, 2), (1, 3), (4, 5))


def predict(x: Array, P: Array, dt: Array, q: Array, qh: float) -> tuple[Array, Array]:
    """State (n, 6) [x, y, vx, vy, heading, yaw rate] and covariance (n, 6, 6) dt (n,) [s] later.

    q (n,): standard deviation of the acceleration [m/s2]; qh: of the yaw acceleration [rad/s2].
    """
    x, P = x.copy(), P.copy()
    for (a, b), noise in zip(CHAINS, (q, q, np.full(len(x), qh)), strict=True):
        x[:, a] += dt * x[:, b]
        P[:, a] += dt[:, None] * P[:, b]  # F P
        P[:, :, a] += dt[:, None] * P[:, :, b]  # F P F'
        spread = (noise * dt) ** 2
        P[:, a, a] += spread * dt**2 / 4.0
        P[:, a, b] += spread * dt / 2.0
        P[:, b, a] += spread * dt / 2.0
        P[:, b, b] += spread
    return x, P


def correct(
    x: Array, P: Array, z: Array, R: Array, course_sigma: float, course_speed: float, least: float
) -> tuple[Array, Array]:
    """x (n, 6), P (n, 6, 6) corrected with poses z (n, 3) [x, y, heading] of covariance R (n, 3, 3).

    Heading innovations are wrapped. Above `course_speed` [m/s] the heading is also drawn to the course, with
    standard deviation `course_sigma` [rad]. `least`: floor of the heading's standard deviation [rad].
    """
    innovation = z - x[:, MEASURED]
    innovation[:, 2] = wrap(innovation[:, 2])
    PH = P[:, :, MEASURED]
    S = PH[:, MEASURED] + R
    S[:, 2, 2] += least**2
    K = np.linalg.solve(S, PH.transpose(0, 2, 1)).transpose(0, 2, 1)
    x = x + (K @ innovation[:, :, None])[:, :, 0]
    P = P - K @ S @ K.transpose(0, 2, 1)
    turn = wrap(np.arctan2(x[:, 3], x[:, 2]) - x[:, 4])
    drawn = (np.hypot(x[:, 2], x[:, 3]) > course_speed) & (np.abs(turn) < 0.5 * np.pi)
    k = np.where(drawn[:, None], P[:, :, 4] / (P[:, 4, 4] + course_sigma**2)[:, None], 0.0)
    x = x + k * turn[:, None]
    P = P - k[:, :, None] * P[:, None, 4, :]
    x[:, 4] = wrap(x[:, 4])
    return x, 0.5 * (P + P.transpose(0, 2, 1))


def mahalanobis2(x: Array, P: Array, z: Array, R: Array) -> Array:
    """(n,) squared Mahalanobis distance of position innovations, z (n, 3) against x (n, 6)."""
    a, b, c = P[:, 0, 0] + R[:, 0, 0], P[:, 1, 1] + R[:, 1, 1], P[:, 0, 1] + R[:, 0, 1]
    dx, dy = (z[:, :2] - x[:, :2]).T
    distance: Array = (b * dx * dx - 2.0 * c * dx * dy + a * dy * dy) / np.maximum(a * b - c * c, 1e-12)
    return distance
