"""The tracker's own short-term prediction: where a body will be one scan on, and how sure that is.

Position: constant velocity with white acceleration held over a step; heading: constant rate with white acceleration. It serves the
gate and the fit only; the published estimate is the observer's. Source: Bar-Shalom, Li and Kirubarajan,
Estimation with Applications to Tracking and Navigation, 2001, section 6.2.
"""

from __future__ import annotations

import numpy as np

from outrider.kernel import compiled
from outrider.records import Array

X, Y, VX, VY, H, W = range(6)  # columns of the state


@compiled
def predict(x: Array, P: Array, dt: Array, q: Array, qh: float) -> tuple[Array, Array]:
    """State (n, 6) [x, y, vx, vy, heading, yaw rate] and covariance (n, 6, 6) dt (n,) later; inputs are kept.

    q (n,): standard deviation of the acceleration [m/s2]; qh: of the yaw acceleration [rad/s2].
    """
    n = x.shape[0]
    out, C = x.copy(), P.copy()
    F = np.eye(6)
    for i in range(n):
        d = dt[i]
        F[0, 2] = F[1, 3] = F[4, 5] = d
        out[i] = F @ x[i]
        C[i] = F @ P[i] @ F.T
        for a, b, noise in ((0, 2, q[i]), (1, 3, q[i]), (4, 5, qh)):
            C[i, a, a] += noise**2 * d**4 / 4.0
            C[i, a, b] += noise**2 * d**3 / 2.0
            C[i, b, a] += noise**2 * d**3 / 2.0
            C[i, b, b] += noise**2 * d**2
    return out, C


@compiled
def correct(
    x: Array, P: Array, z: Array, R: Array, course_sigma: float, course_speed: float, least: float
) -> None:
    """Correct rows of x (n, 6), P (n, 6, 6) in place with poses z (n, 3) of covariance R (n, 3, 3).

    Heading innovations are wrapped. Above `course_speed` [m/s] the heading is also drawn to the course, with
    standard deviation `course_sigma` [rad]. `least`: floor of the heading's standard deviation [rad].
    """
    for i in range(x.shape[0]):
        S = np.empty((3, 3))
        idx = (0, 1, 4)
        for a in range(3):
            for b in range(3):
                S[a, b] = P[i, idx[a], idx[b]] + R[i, a, b]
        S[2, 2] += least * least
        e = np.empty(3)
        e[0], e[1] = z[i, 0] - x[i, 0], z[i, 1] - x[i, 1]
        e[2] = (z[i, 2] - x[i, 4] + np.pi) % (2.0 * np.pi) - np.pi
        PH = np.empty((6, 3))
        for a in range(6):
            for b in range(3):
                PH[a, b] = P[i, a, idx[b]]
        K = np.linalg.solve(S, PH.T).T
        x[i] += K @ e
        P[i] -= K @ S @ K.T
        speed = np.hypot(x[i, 2], x[i, 3])
        if speed > course_speed:
            course = np.arctan2(x[i, 3], x[i, 2])
            turn = (course - x[i, 4] + np.pi) % (2.0 * np.pi) - np.pi
            if abs(turn) < 0.5 * np.pi:
                k = P[i, :, 4] / (P[i, 4, 4] + course_sigma**2)
                x[i] += k * turn
                P[i] -= np.outer(k, P[i, 4].copy())
        x[i, 4] = (x[i, 4] + np.pi) % (2.0 * np.pi) - np.pi
        P[i] = 0.5 * (P[i] + P[i].T)


@compiled
def mahalanobis2(x: Array, P: Array, z: Array, R: Array) -> Array:
    """(n,) squared Mahalanobis distance of position innovations, z (n, 3) against x (n, 6)."""
    out = np.empty(x.shape[0])
    for i in range(x.shape[0]):
        a, b = P[i, 0, 0] + R[i, 0, 0], P[i, 1, 1] + R[i, 1, 1]
        c = P[i, 0, 1] + R[i, 0, 1]
        dx, dy = z[i, 0] - x[i, 0], z[i, 1] - x[i, 1]
        out[i] = (b * dx * dx - 2.0 * c * dx * dy + a * dy * dy) / max(a * b - c * c, 1e-12)
    return out
