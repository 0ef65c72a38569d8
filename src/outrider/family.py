"""Error dynamics of the observers over a region, as the corners of a polytope of matrices.

If one P shrinks e'Pe for every corner, it does so for whatever lies between them, also where the matrix
changes with time from corner to corner. Each function says why the true error dynamics lies between its
corners. Errors are estimate minus truth, mean values taken on the line between the two.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from math import cos, sin
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.errors import InputError
from outrider.inequalities import SLIP, alike, chain

Array = npt.NDArray[np.float64]

CHAINS: Array = alike(chain(3))  # (6, 6) position, velocity, acceleration of each axis


class Family(NamedTuple):
    """Matrices (m, n, n), and what each one is a corner of, for messages."""

    matrices: Array
    corners: tuple[str, ...]


class Point(NamedTuple):
    """Orientation gains in use at a true speed: a corner of what a table or a line may give."""

    name: str
    speed: float  # true one [m/s]
    psi: float  # [1/s]
    beta: float  # [1/s]


class Table(NamedTuple):
    """Orientation gains by nominal speed, (k,) each; the nearest entry is used, no interpolation."""

    speed: Sequence[float]  # [m/s]
    psi: Sequence[float]  # [1/s]
    beta: Sequence[float]  # [1/s]

    def points(self, mismatch: float) -> list[Point]:
        """Both ends of the true speeds at which each entry may be in use."""
        spans = self.spans(mismatch)
        return [
            Point(f"entry {v:g} m/s used at {V:.3g} m/s", V, psi, beta)
            for v, psi, beta, span in zip(*self, spans, strict=True)
            for V in span
        ]

    def spans(self, mismatch: float) -> list[tuple[float, float]]:
        """True speeds (k, 2) at which each entry may be in use [m/s].

        From half way to the entry below to half way to the one above, and `mismatch` [-] of that further,
        since the estimated speed chooses; the first and last entry end at their own speed.
        """
        v = np.asarray(self.speed, float)
        middle = 0.5 * (v[1:] + v[:-1])
        low, high = np.r_[v[0], middle], np.r_[middle, v[-1]]
        return [
            (float(a * (1.0 - mismatch)), float(b * (1.0 + mismatch))) for a, b in zip(low, high, strict=True)
        ]


class Line(NamedTuple):
    """Orientation gains a + b V in the estimated speed V: nothing switches."""

    low: float  # speeds it is for [m/s]
    high: float  # [m/s]
    psi: tuple[float, float]  # a [1/s], b [1/m]
    beta: tuple[float, float]  # a [1/s], b [1/m]

    def points(self, mismatch: float) -> list[Point]:
        """Four: both ends, with the true speed off by `mismatch` [-] to either side.

        Model and gain are affine in the true and the estimated speed, so what is in between lies between.
        """
        (p, q), (r, s) = self.psi, self.beta
        return [
            Point(f"estimated {v:g} m/s, true {V:.3g} m/s", V, p + q * v, r + s * v)
            for v in (self.low, self.high)
            for V in (v * (1.0 - mismatch), v * (1.0 + mismatch))
        ]


def speed_chain() -> Array:
    """F (1, 4, 4) of path, speed, acceleration and jerk, [MS 12]; measured is the path."""
    return chain(4)[None]


def orientation(low: float, high: float, l_r: float = 2.0, slip: float = SLIP) -> Array:
    """F (2, 2, 2) of yaw and slip at speeds from low to high [m/s], [MS 19]; their sum is measured.

    The mean value of the slope of sin(slip) lies between cos(slip) of the largest slip and 1, and only its
    product with the speed counts.
    """
    return np.array([[[0.0, product / l_r], [0.0, 0.0]] for product in (low * cos(slip), high)])


def orientation_errors(points: Sequence[Point], l_r: float = 2.0, slip: float = SLIP) -> Family:
    """Error dynamics (m, 2, 2) of yaw and slip at each point, at both ends of the slope of sin(slip)."""
    matrices, corners = [], []
    for name, V, psi, beta in points:
        for k in (cos(slip), 1.0):
            matrices.append([[-psi, V * k / l_r - psi], [-beta, -beta]])
            corners.append(f"{name}, slope {k:.2f}")
    return Family(np.array(matrices), tuple(corners))


def multi_stage(
    L_s: Sequence[float],
    points: Sequence[Point],
    L_w: float,
    heading: float = 0.0,
    l_r: float = 2.0,
    slip: float = SLIP,
) -> Family:
    """Error dynamics (m, 8, 8) of the whole cascade: (S, V, A, J), (psi, beta), (along, across) the course.

    The position error is taken in the frame of the course, which may turn as it likes where P has one and the
    same weight on both components and none across to other states: |w| is what is measured. The rectangle's
    heading corrects the yaw with any gain from 0 to `heading`. Scaled by `scale_multi_stage`.
    """
    T = scale_multi_stage()
    matrices, corners = [], []
    for name, V, psi, beta in points:
        for k, b, h in product((cos(slip), 1.0), (-sin(slip), sin(slip)), sorted({0.0, heading})):
            A = np.zeros((8, 8))
            A[:4, :4] = chain(4) - np.outer(L_s, np.eye(4)[0])
            A[4, 4:6] = -psi - h, V * k / l_r - psi
            A[5, 4:6] = -beta
            A[4, 1] = b / l_r
            A[6, 1], A[7, 4:6] = 1.0, V
            A[6, 6] = A[7, 7] = -L_w
            matrices.append(A / T[:, None] * T)
            corners.append(f"{name}, slope {k:.2f}, slip {b:+.2f}, heading {h:g}")
    return Family(np.array(matrices), tuple(corners))


def scale_multi_stage() -> Array:
    """Size (8,) of the errors of the cascade beside each other [m, m/s, m/s2, m/s3, rad, rad, m, m]."""
    return np.array([1.0, 1.4, 2.0, 2.7, 0.2, 0.05, 10.0, 10.0])


def companion(speed: float, acceleration: float, yaw_rate: float) -> tuple[Array, tuple[str, ...]]:
    """F + G df/dz (16, 6, 6) of [HG 56-58] in the frame of the velocity, and the corners' names.

    For every state faster than `speed` [m/s], with |tangential acceleration| [m/s2] and |course rate| [rad/s]
    within the given ones. With k the course rate and r = acceleration / speed, the Jacobian is quadratic in
    (k, r); on each quarter of the box it lies among its Bernstein control points, which are these 16: the
    square of k runs to 0 at k / 2 and to K^2 at K. The frame may turn where P and the gain treat both axes
    alike (P = I2 (x) P3). InputError for a region that reaches down to standstill.
    """
    if not (speed > 0.0 and acceleration >= 0.0 and yaw_rate >= 0.0):
        raise InputError(
            f"speed {speed:g}, acceleration {acceleration:g}, yaw rate {yaw_rate:g}; want a speed above 0 "
            "and the others 0 or more: the model is singular at standstill"
        )
    K, R = yaw_rate, acceleration / speed
    ks, rs = ([(-B, B * B), (-B / 2, 0.0), (B / 2, 0.0), (B, B * B)] for B in (K, R))
    matrices, corners = [], []
    for (k, kk), (r, rr) in product(ks, rs):
        matrices.append(_companion(k, r, kk, k * r, rr))
        corners.append(f"course rate {k:.3g} rad/s, acceleration / speed {r:.3g} 1/s")
    return np.array(matrices), tuple(corners)


def _companion(k: float, r: float, kk: float, kr: float, rr: float) -> Array:
    F = CHAINS.copy()
    F[2, [1, 2, 4, 5]] = kk, 0.0, -kr, -2.0 * k
    F[5, [1, 2, 4, 5]] = -3.0 * kr, 3.0 * k, 2.0 * kk - 3.0 * rr, 3.0 * r
    return F


def high_gain(L: Sequence[float], speed: float, acceleration: float, yaw_rate: float) -> Family:
    """Error dynamics (16, 6, 6) under the gain L (3,) per axis, scaled to states of like size."""
    F, corners = companion(speed, acceleration, yaw_rate)
    return Family(_closed(F, L), corners)


def frozen_high_gain(L: Sequence[float], speed: float, acceleration: float, yaw_rate: float) -> Family:
    """Error dynamics (25, 6, 6) at states of the region itself; each must be stable for a proof to exist."""
    matrices, corners = [], []
    for k, r in product(
        np.linspace(-yaw_rate, yaw_rate, 5), np.linspace(-1.0, 1.0, 5) * acceleration / speed
    ):
        matrices.append(_companion(k, r, k * k, k * r, r * r))
        corners.append(f"course rate {k:.3g} rad/s, acceleration / speed {r:.3g} 1/s")
    return Family(_closed(np.array(matrices), L), tuple(corners))


def high_gain_box(L: Sequence[float], speed: float, acceleration: float, yaw_rate: float) -> Family:
    """As `high_gain`, with k, r, k^2, k r, r^2 free of each other: 32 corners, which prove less."""
    K, R = yaw_rate, acceleration / speed
    box = list(product((-K, K), (-R, R), (0.0, K * K), (-K * R, K * R), (0.0, R * R)))
    corners = tuple(f"(k, r, k^2, k r, r^2) = ({', '.join(f'{x:.3g}' for x in corner)})" for corner in box)
    return Family(_closed(np.array([_companion(*corner) for corner in box]), L), corners)


def _closed(F: Array, L: Sequence[float]) -> Array:
    if len(L) != 3 or not np.isfinite(L).all():
        raise InputError(f"gain {list(L)}; want three finite numbers")
    pace = float(max(abs(L[2]), 1e-9)) ** (1.0 / 3.0)
    T = np.tile([1.0, pace, pace**2], 2)
    A = F - alike(np.outer(L, np.eye(3)[0]))
    return np.asarray(A / T[:, None] * T)


def constant_velocity(
    speeds: Iterable[float], window: float, yaw_rate: float = 0.0, l_r: float = 2.0, slip: float = SLIP
) -> tuple[Array, tuple[str, ...]]:
    """F (m, 4, 4) of x, y, yaw, slip at given speeds [m/s] in a frame that turns along, and the corners.

    For courses within `window` [rad] of the frame's x axis, which turns at up to `yaw_rate` [rad/s]: the
    turning acts on the position error like a further term of the model.
    """
    matrices, corners = [], []
    lows, highs = (-sin(window), sin(window)), (cos(window), 1.0)
    for V, s, c, k, w in product(speeds, lows, highs, (cos(slip), 1.0), sorted({-yaw_rate, yaw_rate})):
        F = np.zeros((4, 4))
        F[:2, :2] = [[0.0, w], [-w, 0.0]]
        F[0, 2:] = -V * s
        F[1, 2:] = V * c
        F[2, 3] = V * k / l_r
        matrices.append(F)
        corners.append(f"{V:g} m/s, sin {s:.2f}, cos {c:.2f} of the course, yaw rate {w:g} rad/s")
    return np.array(matrices), tuple(corners)
