"""Gaussian knowledge of a bicycle: how it begins, what disturbs it, what bounds it; for Kalman filters.

Mean x (1, n) and covariance P (n, n) of [X, Y, V, A, psi, beta] as in models/bicycle.py, and of more after
these if n > 6. `gains` has noise, jerk, slip, yaw, heading, heading_noise, coast.
"""

from __future__ import annotations

from math import atan2, cos, hypot, inf, pi, sin, sqrt
from typing import Any

from outrider.kernel import kernel, wrap
from outrider.observers import Measurement, Spread
from outrider.observers._gaussian import correct_one, limit
from outrider.observers._measured import directed, pointed, seen
from outrider.observers._path import fade

SLIP_MAX = pi / 9.0  # Alai & Rajamani 2023, eq. 8 [rad]
V_MAX, A_MAX = 70.0, 100.0  # far beyond any vehicle: only keep numbers finite [m/s, m/s2]
WIDEST = (1e6, 1e6, V_MAX**2, 1e3, 3.0, 0.04)  # variances at most
LEAST, MOST = 1e-6, 1e6  # variance of a measured position [m2], of a heading [rad2]
V_START, A_START, BETA_START = 10.0, 3.0, 0.1  # deviations of a new track, if unmeasured [m/s, m/s2, rad]
PSI_START, PSI_KNOWN = 1.0, 0.5  # of a yaw that nothing tells, that the first way tells [rad]
GATE = 2.0  # standard deviations a way must be long to have a direction [-]
NODES = ((0.1127016653792583, 5 / 18), (0.5, 8 / 18), (0.8872983346207417, 5 / 18))  # Gauss


# ------------------------------------------------------------------ what is measured


@kernel
def scatter(y: Measurement, gains: Any) -> tuple[float, float, float]:
    """Covariance (xx, xy, yy) of a measured position [m2]; one that is none is made one."""
    xx = min(y.xx, MOST) if y.xx > 0.0 else 0.0
    yy = min(y.yy, MOST) if y.yy > 0.0 else 0.0
    most = sqrt(xx * yy)
    xy = min(max(y.xy, -most), most) if abs(y.xy) < inf else 0.0
    least = max(gains.noise**2, LEAST)
    return xx + least, xy, yy + least


@kernel
def heading_scatter(y: Measurement, gains: Any) -> float:
    """Variance of a measured heading [rad2]."""
    variance: float = min(y.heading_variance, MOST) + max(gains.heading_noise**2, LEAST)
    return variance


@kernel
def correct_heading(x: Any, P: Any, y: Measurement, gains: Any) -> None:
    """x, P by the heading of the rectangle; what is beyond Huber's limit is doubted, as a position is."""
    e, r = wrap(y.heading - x[0, 4]), heading_scatter(y, gains)
    s = P[4, 4] + r
    if gains.huber > 0.0 and e * e > gains.huber**2 * s:
        r = sqrt(s) * abs(e) / gains.huber - P[4, 4]
    correct_one(x, P, 4, e, r)


# ------------------------------------------------------------------ beginning


@kernel
def begin(x: Any, P: Any, y0: Measurement, y1: Measurement, dt: float, gains: Any) -> None:
    """x, P from two samples dt [s] apart; yaw: the heading if it is used, else that of their way if clear."""
    y = y1 if seen(y1) else y0
    h = y1 if pointed(y1) else y0
    told = gains.heading > 0.0 and pointed(h)
    x[0, 0], x[0, 1] = y.x, y.y
    P[0, 0], P[1, 0], P[1, 1] = scatter(y, gains)
    P[2, 2], P[3, 3], P[4, 4], P[5, 5] = V_START**2, A_START**2, PSI_START**2, BETA_START**2
    if told:
        x[0, 4] = wrap(h.heading)
        P[4, 4] = min(heading_scatter(h, gains), PSI_START**2)
    if seen(y0) and seen(y1) and 0.0 < dt < inf:
        _begin_moving(x, P, y0, y1, max(dt, 1e-6), told, gains)
    mirror(P)


@kernel
def _begin_moving(
    x: Any, P: Any, y0: Measurement, y1: Measurement, dt: float, told: bool, gains: Any
) -> None:
    """Speed and yaw, and how they hang together with the position at y1, from the way (dx, dy)."""
    dx, dy = y1.x - y0.x, y1.y - y0.y
    d = hypot(dx, dy)
    clear = directed(dx, dy, y0, y1, gains.noise, GATE)
    if clear and not told:
        x[0, 4] = atan2(dy, dx)
    c, s = cos(x[0, 4]), sin(x[0, 4])
    xx, xy, yy = P[0, 0], P[1, 0], P[1, 1]
    xx0, xy0, yy0 = scatter(y0, gains)
    xx2, xy2, yy2 = xx + xx0, xy + xy0, yy + yy0  # of the way
    P[2, 2] = (xx2 * c * c + 2.0 * xy2 * c * s + yy2 * s * s) / dt**2 + (0.5 * A_START * dt) ** 2
    P[2, 0], P[2, 1] = (xx * c + xy * s) / dt, (xy * c + yy * s) / dt
    P[3, 2] = 0.5 * A_START**2 * dt
    if clear or told:
        x[0, 2] = (dx * c + dy * s) / dt
    else:
        P[2, 2] += (d / dt) ** 2
    if clear and not told:  # the course is measured, and the slip is part of it
        P[4, 0], P[4, 1] = (xy * c - xx * s) / d, (yy * c - xy * s) / d
        P[4, 2] = ((yy2 - xx2) * c * s + xy2 * (c * c - s * s)) / (d * dt)
        P[4, 4] = (xx2 * s * s - 2.0 * xy2 * c * s + yy2 * c * c) / d**2 + BETA_START**2
        P[5, 4] = -(BETA_START**2)


# ------------------------------------------------------------------ in between


@kernel
def disturb(P: Any, t: float, V: float, twist: float, c: float, s: float, gains: Any) -> None:
    """Add what white noise on jerk, slip rate and yaw rate makes of t [s] at speed V, course (c, s).

    twist: change of the curvature by the slip [1/m]. Integrals of the responses' products: along the course
    those of `fade`, for which d' = v, v' = a; across it polynomials, exact where the course does not turn.
    """
    dd, dV, dA, VV, VA, AA = _along(t, gains)
    q, r, B, D = t * gains.slip**2, t * gains.yaw**2, V * twist * t, V * t
    nn = D * D * (q * (1 / 3 + B / 4.0 + B * B / 20.0) + r / 3.0)
    n_psi = D * (q * B * (1 / 3 + B / 8.0) + 0.5 * r)
    n_beta = D * q * (0.5 + B / 6.0)
    P[0, 0] += c * c * dd + s * s * nn
    P[1, 0] += c * s * (dd - nn)
    P[1, 1] += s * s * dd + c * c * nn
    P[2, 0] += c * dV
    P[2, 1] += s * dV
    P[2, 2] += VV
    P[3, 0] += c * dA
    P[3, 1] += s * dA
    P[3, 2] += VA
    P[3, 3] += AA
    P[4, 0] -= s * n_psi
    P[4, 1] += c * n_psi
    P[4, 4] += q * B * B / 3.0 + r
    P[5, 0] -= s * n_beta
    P[5, 1] += c * n_beta
    P[5, 4] += 0.5 * q * B
    P[5, 5] += q
    mirror(P)


@kernel
def _along(t: float, gains: Any) -> tuple[float, float, float, float, float, float]:
    """Covariances dd dV dA VV VA AA of way, speed, acceleration after t [s] of white noise on the jerk."""
    T = gains.coast
    q, (a, v, d) = gains.jerk**2, fade(t, T)
    vv, dd = 0.0, 0.0
    if t < 0.1 * T or not T > 0.0:  # by three Gauss points, exact for T = 0: the closed form cancels
        for node, weight in NODES:
            _, v1, d1 = fade(node * t, T)
            vv += weight * t * v1 * v1
            dd += weight * t * d1 * d1
    else:
        vv = T * (d - 0.5 * v * v)
        dd = T * T * (t * t * t / 3.0 - 2.0 * (t * d - T * (0.5 * t * t - d)) + vv)
    aa = 0.5 * T * (1.0 - a * a) if T > 0.0 else t
    return q * dd, 0.5 * q * d * d, q * (d * v - vv), q * vv, 0.5 * q * v * v, q * aa


# ------------------------------------------------------------------ what is done to an estimate


@kernel
def aim(x: Any, P: Any, course: float) -> None:
    """The yaw of what stood until now, its front unknown: the way it begins to move.

    Position and the rest lose what they knew of each other, which was along the old yaw.
    """
    x[0, 4] = course - x[0, 5]
    for i in range(P.shape[0]):
        for j in range(i):
            if (i >= 2 and j < 2) or i == 4 or j == 4:
                P[i, j] = 0.0
                P[j, i] = 0.0
    P[4, 4] = PSI_KNOWN**2


@kernel
def turn_round(x: Any, P: Any) -> None:
    """The same motion, front and rear exchanged: psi + 2 beta + pi; all but X, Y, psi change sign."""
    n = P.shape[0]
    x[0, 4] += 2.0 * x[0, 5] + pi
    for i in range(n):
        P[4, i] += 2.0 * P[5, i]
    for i in range(n):
        P[i, 4] += 2.0 * P[i, 5]
    for i in range(n):
        if i == 2 or i == 3 or i > 4:
            x[0, i] = -x[0, i]
            for j in range(n):
                P[i, j] = -P[i, j]
                P[j, i] = -P[j, i]


@kernel
def bound(x: Any, P: Any) -> None:
    """Mean and variances within their limits, the yaw in [-pi, pi)."""
    x[0, 2], x[0, 3] = min(max(x[0, 2], -V_MAX), V_MAX), min(max(x[0, 3], -A_MAX), A_MAX)
    x[0, 4], x[0, 5] = wrap(x[0, 4]), min(max(x[0, 5], -SLIP_MAX), SLIP_MAX)
    for i in range(6):
        limit(P, i, WIDEST[i])


@kernel
def mirror(P: Any) -> None:
    """Upper half of P as the lower."""
    for i in range(P.shape[0]):
        for j in range(i):
            P[j, i] = P[i, j]


@kernel
def spread_of(s: Any) -> Spread:
    """Covariance of position and velocity (V cos chi, V sin chi), linearised; entries of s by name.

    Across the course to second order: aside, the velocity of what stands is not better known than along.
    """
    c, d = cos(s.psi + s.beta), sin(s.psi + s.beta)
    a, b = -s.V * d, s.V * c  # by the course
    chi_x, chi_y, chi_V = s.psi_x + s.beta_x, s.psi_y + s.beta_y, s.psi_V + s.beta_V
    chi = s.psi_psi + 2.0 * s.beta_psi + s.beta_beta
    aside = s.VV * min(chi, 1.0)
    return Spread(
        s.xx,
        s.yx,
        s.yy,
        c * s.Vx + a * chi_x,
        c * s.Vy + a * chi_y,
        c * c * s.VV + 2.0 * a * c * chi_V + a * a * chi + d * d * aside,
        d * s.Vx + b * chi_x,
        d * s.Vy + b * chi_y,
        c * d * s.VV + (a * d + b * c) * chi_V + a * b * chi - c * d * aside,
        d * d * s.VV + 2.0 * b * d * chi_V + b * b * chi + c * c * aside,
    )
