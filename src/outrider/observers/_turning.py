"""Two motions of a point for Kalman filters: straight at constant speed, and a coordinated turn.

Mean x (1, 5) and covariance P (5, 5) of [x, y, u, v, w]: position, velocity in W, turn rate.
Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 11.7; the
noise of the turn is integrated over the turn.
"""

from __future__ import annotations

from math import cos, log, sin, sqrt
from typing import Any

from outrider.kernel import kernel, matrix
from outrider.observers import Measurement
from outrider.observers._bicycle import heading_scatter, mirror, scatter
from outrider.observers._gaussian import cholesky, correct_two, look_back, product

SLOWEST = 0.01  # variance of the speed across the rear axle, at least [m2/s2]


@kernel
def go_straight(x: Any, P: Any, F: Any, t: float, q: float, turn: float) -> None:
    """x, P after t [s] at constant velocity, F its Jacobian.

    q: white noise on the acceleration [m/s2/sqrt(Hz)]. The turn rate is 0; that with which a turn would begin
    has the deviation `turn` [rad/s].
    """
    _identity(F)
    F[0, 2], F[1, 3], F[4, 4] = t, t, 0.0
    x[0, 0] += t * x[0, 2]
    x[0, 1] += t * x[0, 3]
    x[0, 4] = 0.0
    _carry(F, P)
    _disturb(P, q * q, t**3 / 3.0, t * t / 2.0, 0.0, t)
    P[4, 4] += turn * turn


@kernel
def go_round(x: Any, P: Any, F: Any, t: float, q: float, q_w: float) -> None:
    """x, P after t [s] at constant speed and turn rate, F its Jacobian.

    q: white noise on the acceleration [m/s2/sqrt(Hz)], q_w: on the turn rate's rate [rad/s2/sqrt(Hz)].
    """
    u, v, w = x[0, 2], x[0, 3], x[0, 4]
    a = w * t
    c, s = cos(a), sin(a)
    g, h = _arcs(a, c, s)
    g, h = g * t * t, h * t**3  # (1 - c) / w^2, (t - s / w) / w^2
    S, C = t - w * w * h, w * g  # position by velocity
    S_w, C_w = _slopes(a, c, s)
    S_w, C_w = S_w * t * t, C_w * t * t
    dx, dy = S * u - C * v, C * u + S * v
    u1, v1 = c * u - s * v, s * u + c * v
    _identity(F)
    F[0, 2], F[0, 3], F[0, 4] = S, -C, S_w * u - C_w * v
    F[1, 2], F[1, 3], F[1, 4] = C, S, C_w * u + S_w * v
    F[2, 2], F[2, 3], F[2, 4] = c, -s, -t * v1
    F[3, 2], F[3, 3], F[3, 4] = s, c, t * u1
    x[0, 0], x[0, 1], x[0, 2], x[0, 3] = x[0, 0] + dx, x[0, 1] + dy, u1, v1
    _carry(F, P)
    _disturb(P, q * q, 2.0 * h, g, w * h, t)
    _swerve(P, q_w * q_w, t, -dy / t, dx / t, -v1, u1)


@kernel
def _carry(F: Any, P: Any) -> None:
    """P <- F P F' for an F that lets x, y be and of w makes nothing but w."""
    for j in range(5):
        u, v, w = P[2, j], P[3, j], P[4, j]
        P[0, j] += F[0, 2] * u + F[0, 3] * v + F[0, 4] * w
        P[1, j] += F[1, 2] * u + F[1, 3] * v + F[1, 4] * w
        P[2, j] = F[2, 2] * u + F[2, 3] * v + F[2, 4] * w
        P[3, j] = F[3, 2] * u + F[3, 3] * v + F[3, 4] * w
        P[4, j] = F[4, 4] * w
    for i in range(5):
        u, v, w = P[i, 2], P[i, 3], P[i, 4]
        P[i, 0] += F[0, 2] * u + F[0, 3] * v + F[0, 4] * w
        P[i, 1] += F[1, 2] * u + F[1, 3] * v + F[1, 4] * w
        P[i, 2] = F[2, 2] * u + F[2, 3] * v + F[2, 4] * w
        P[i, 3] = F[3, 2] * u + F[3, 3] * v + F[3, 4] * w
        P[i, 4] = F[4, 4] * w
    mirror(P)


@kernel
def _arcs(a: float, c: float, s: float) -> tuple[float, float]:
    """(1 - c) / a^2 and (a - s) / a^3 of an angle, its cosine and sine."""
    if abs(a) < 1e-2:
        b = a * a
        return 0.5 - b / 24.0 * (1.0 - b / 30.0), 1 / 6 - b / 120.0 * (1.0 - b / 42.0)
    return (1.0 - c) / a**2, (a - s) / a**3


@kernel
def _slopes(a: float, c: float, s: float) -> tuple[float, float]:
    """Derivatives of s / a and (1 - c) / a by the angle a."""
    if abs(a) < 1e-2:
        b = a * a
        return -a / 3.0 * (1.0 - b / 10.0 * (1.0 - b / 28.0)), 0.5 - b / 8.0 * (1.0 - b / 18.0)
    return (c - s / a) / a, (s - (1.0 - c) / a) / a


@kernel
def _disturb(P: Any, q: float, pp: float, pv: float, aside: float, vv: float) -> None:
    """Add q times the covariance that white noise, alike in all directions, gives position and velocity."""
    for i in range(2):
        P[i, i] += q * pp
        P[i + 2, i + 2] += q * vv
        P[i, i + 2] += q * pv
        P[i + 2, i] += q * pv
    P[0, 3] += q * aside
    P[3, 0] += q * aside
    P[1, 2] -= q * aside
    P[2, 1] -= q * aside


@kernel
def _swerve(P: Any, q: float, t: float, ex: float, ey: float, fx: float, fy: float) -> None:
    """Add what white noise q on the turn rate's rate does in t [s].

    s [s] before the end a change of 1 makes s^2 / 2 (ex, ey) of position, s (fx, fy) of velocity and 1 of w.
    """
    pp, pv, pw = q * t**5 / 20.0, q * t**4 / 8.0, q * t**3 / 6.0
    vv, vw, ww = q * t**3 / 3.0, q * t * t / 2.0, q * t
    P[0, 0] += pp * ex * ex
    P[1, 0] += pp * ex * ey
    P[1, 1] += pp * ey * ey
    P[2, 0] += pv * ex * fx
    P[2, 1] += pv * ey * fx
    P[2, 2] += vv * fx * fx
    P[3, 0] += pv * ex * fy
    P[3, 1] += pv * ey * fy
    P[3, 2] += vv * fx * fy
    P[3, 3] += vv * fy * fy
    P[4, 0] += pw * ex
    P[4, 1] += pw * ey
    P[4, 2] += vw * fx
    P[4, 3] += vw * fy
    P[4, 4] += ww
    mirror(P)


@kernel
def _identity(F: Any) -> None:
    for i in range(5):
        for j in range(5):
            F[i, j] = 0.0
        F[i, i] = 1.0


# ------------------------------------------------------------------ two estimates


@kernel
def mix(x: Any, P: Any, z: Any, Z: Any, a: float, c: float) -> None:
    """x, P becomes the mean and covariance of itself and a share a of z, Z; z, Z with a share c of x, P."""
    for i in range(5):
        for j in range(i + 1):
            apart = (z[0, i] - x[0, i]) * (z[0, j] - x[0, j])
            p, q = P[i, j], Z[i, j]
            P[i, j] = p + a * (q - p) + a * (1.0 - a) * apart
            Z[i, j] = q + c * (p - q) + c * (1.0 - c) * apart
            P[j, i], Z[j, i] = P[i, j], Z[i, j]
    for i in range(5):
        d = z[0, i] - x[0, i]
        x[0, i] += a * d
        z[0, i] -= c * d


@kernel
def mean(x: Any, P: Any, z: Any, Z: Any, p: float, o: Any, O: Any) -> None:
    """Mean o, covariance O of straight x, P, whose turn rate is 0, and, of probability p, turning z, Z."""
    for i in range(5):
        d = z[0, i] - x[0, i]
        o[0, i] = x[0, i] + p * d
        for j in range(i + 1):
            straight = P[i, j] if j < 4 else 0.0
            O[i, j] = straight + p * (Z[i, j] - straight) + p * (1.0 - p) * d * (z[0, j] - x[0, j])
            O[j, i] = O[i, j]


@kernel
def back_straight(x: Any, P: Any, e: Any, D: Any, t: float, q: float, turn: float) -> None:
    """x, P with what is known of e, D, t [s] later, having gone straight; Rauch, Tung and Striebel."""
    n, N, F, G = matrix(1, 5), matrix(5, 5), matrix(5, 5), matrix(5, 5)
    _copy(x, P, n, N)
    go_straight(n, N, F, t, q, turn)
    _back(x, P, e, D, n, N, F, G)


@kernel
def back_round(x: Any, P: Any, e: Any, D: Any, t: float, q: float, q_w: float) -> None:
    """x, P with what is known of e, D, t [s] later, having turned; Rauch, Tung and Striebel."""
    n, N, F, G = matrix(1, 5), matrix(5, 5), matrix(5, 5), matrix(5, 5)
    _copy(x, P, n, N)
    go_round(n, N, F, t, q, q_w)
    _back(x, P, e, D, n, N, F, G)


@kernel
def _back(x: Any, P: Any, e: Any, D: Any, n: Any, N: Any, F: Any, G: Any) -> None:
    """x, P from what n, N became of it by F; all but these two and e, D are used up."""
    product(P, F, G)
    if cholesky(N, F):
        for i in range(5):
            n[0, i] = e[0, i] - n[0, i]
            for j in range(5):
                N[i, j] = D[i, j] - N[i, j]
        look_back(x, P, G, n, N, F)


@kernel
def _copy(x: Any, P: Any, o: Any, O: Any) -> None:
    for i in range(5):
        o[0, i] = x[0, i]
        for j in range(5):
            O[i, j] = P[i, j]


# ------------------------------------------------------------------ correction


@kernel
def correct(x: Any, P: Any, G: Any, y: Measurement, told: bool, l_r: float, gains: Any) -> float:
    """x, P by the position and, if `told`, by the heading; logarithm of how likely both were. G: scratch.

    A body moves along its heading at its rear axle: the velocity across it, less l_r w, is 0.
    """
    c, s = cos(y.heading) if told else 1.0, sin(y.heading) if told else 0.0
    ahead = x[0, 2] * c + x[0, 3] * s
    square = ahead * ahead + P[2, 2] * c * c + 2.0 * P[3, 2] * c * s + P[3, 3] * s * s
    for i in range(5):
        G[i, 0], G[i, 1] = P[i, 0], P[i, 1]
    xx, xy, yy = scatter(y, gains)
    xx, xy, yy, ex, ey = xx + P[0, 0], xy + P[1, 0], yy + P[1, 1], y.x - x[0, 0], y.y - x[0, 1]
    det = xx * yy - xy * xy
    far = (yy * ex * ex - 2.0 * xy * ex * ey + xx * ey * ey) / det
    likely: float = -0.5 * log(det) - _loss(far, gains.huber)
    more = _more(far, gains.huber)
    correct_two(x, P, G, (ex, ey), (xx * more, xy * more, yy * more))
    if not told:
        return likely
    for i in range(5):
        G[i, 0] = c * P[i, 3] - s * P[i, 2] - l_r * P[i, 4]
    S = max(square * heading_scatter(y, gains), SLOWEST) + c * G[3, 0] - s * G[2, 0] - l_r * G[4, 0]
    e = s * x[0, 2] - c * x[0, 3] + l_r * x[0, 4]
    far = e * e / S
    likely -= 0.5 * log(S) + _loss(far, gains.huber)
    S *= _more(far, gains.huber)
    for i in range(5):
        k = G[i, 0] / S
        x[0, i] += k * e
        for j in range(i + 1):
            P[i, j] -= k * G[j, 0]
            P[j, i] = P[i, j]
    return likely


@kernel
def _loss(square: float, k: float) -> float:
    """Half a squared innovation in standard deviations; beyond k, if k > 0, Huber's straight line."""
    return k * sqrt(square) - 0.5 * k * k if 0.0 < k * k < square else 0.5 * square


@kernel
def _more(square: float, k: float) -> float:
    """What an innovation's covariance is multiplied by: deviations / k beyond k, if k > 0, else 1."""
    return sqrt(square) / k if 0.0 < k * k < square else 1.0
