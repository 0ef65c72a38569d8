"""What is claimed of the invariant observer: its error matrices over a region.

Errors are seen from the estimate: (along, speed, acceleration, across, course, curvature, slip). There the
heading of the vehicle drops out, so one set of matrices serves all headings. The mirrored world mirrors the
errors across, so P may keep the two chains apart: it is a block of 3 and a block of 4.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import cos, exp, expm1, sin

import numpy as np

from outrider.certificate import Array
from outrider.claim import Claim, Sought
from outrider.errors import InputError
from outrider.family import Family
from outrider.inequalities import Form
from outrider.observers.invariant import NOMINAL, NOMINAL_HEADING, Correction, Gains, correction

REGION = {
    "time between samples [s]": (0.05, 0.15),
    "speed [m/s]": (5.0, 25.0),
    "yaw rate [rad/s]": (-0.6, 0.6),
    "acceleration [m/s2]": (-3.0, 3.0),
    "weight of a saturated position [-]": (0.7, 1.0),
    "weight of a saturated heading [-]": (0.3, 1.0),
}
# Vertices of the weights of position and heading: the box of the region, and the edge to no heading at all.
WEIGHTS = (0.7, 0.3), (0.7, 1.0), (1.0, 0.0), (1.0, 1.0)
GRID = 4, 9, 3  # points of the first three, the turn to one side only
STEP = 0.1  # matrices are brought to this time between samples [s]
DECAY = 0.05  # of the error, at least [1/s]; P is searched for twice that: room between grid points
BLOCKS = ((range(3),), (range(3, 7),))  # along, across: the mirrored world mirrors the second


def claim(gains: Gains, form: Form = "sampled") -> Claim:
    """Claim for `invariant.Gains` over REGION; InputError for a form it has not."""
    if form != "sampled":
        raise InputError(f"invariant has no proof in {form!r} form; want sampled")
    made = list(family(gains))
    matrices = np.array([A * np.exp(DECAY * (dt - STEP)) for dt, A in made])
    names = tuple(f"point {i} of the grid, step {dt:.3g} s" for i, (dt, _) in enumerate(made))
    return Claim(
        "invariant",
        "sampled",
        Family(matrices, names),
        REGION,
        (
            "The error is small: the dynamics are linearised about the true motion, which may turn.",
            "The gains have settled: the ramp after the start is over.",
            "Measured positions have the deviation 0.1 m and headings 0.1 rad, added noise included.",
            "A heading is missing only where the position is not saturated.",
            "Slip and curvature are inside their limits, the slip is that of a rolling rear axle.",
            "Between grid points the matrices differ from interpolated ones by less than the margin.",
            "Matrices are brought to 0.1 s: the error shrinks by the rate in 0.1 s, whatever the sampling.",
        ),
        {},
        BLOCKS,
        _sought(gains),
    )


def _sought(gains: Gains, dt: float = STEP, V: float = NOMINAL[1]) -> tuple[Sought, ...]:
    """Errors on a straight path at speed V under position noise of any shape, bounded by 1 m; no heading.

    Exact: sums of the absolute impulse response, reached by noise with its signs.
    """
    L = correction(dt, V, np.inf, NOMINAL[0] ** 2, NOMINAL[0] ** 2, NOMINAL_HEADING**2, gains)
    A, B = error_matrix(dt, V, 0.0, L, 1.0, 0.0, gains), _by_position(L, 1.0, gains)
    pairs = (
        ("position along", "position along", 0, 0),
        ("speed", "position along", 1, 0),
        ("acceleration", "position along", 2, 0),
        ("position across", "position across", 3, 3),
        ("course", "position across", 4, 3),
    )
    return tuple(
        Sought(of, by, A[None], B[None, :, j : j + 1], np.eye(7)[i : i + 1]) for of, by, i, j in pairs
    )


def error_matrix(
    dt: float, V: float, yaw_rate: float, L: Correction, u: float, h: float, gains: Gains
) -> Array:
    """(I - L H) F, (7, 7): one sample of the error at constant speed; u, h: weights of position, heading."""
    left = 1.0 - h * L.course  # what the heading leaves open
    M = np.eye(7) - u * _by_position(L, left, gains) - h * _by_heading(L)
    out: Array = M @ _driven(dt, V, yaw_rate, gains)
    return out


def _driven(dt: float, V: float, yaw_rate: float, gains: Gains) -> Array:
    """Derivative of the flow, in the frame it ends in."""
    D, turn, T = V * dt, yaw_rate * dt, gains.coast
    fade = -expm1(-dt / T)
    half, k = 0.5 * turn, yaw_rate / V
    ahead = sin(turn) / turn if turn else 1.0  # chord over way, seen from the end
    aside = sin(half) ** 2 / half if turn else 0.0
    bulge = (turn - sin(turn)) / turn**2 if turn else 0.0
    way = np.array([0.0, dt, T * (dt - T * fade), 0.0, 0.0, 0.0, 0.0])  # error of the way driven
    left = exp(-D / gains.relax)
    F = np.eye(7)
    F[0] = [cos(turn), 0.0, 0.0, sin(turn), D * aside, D * D * bulge, 0.0]
    F[3] = [-sin(turn), 0.0, 0.0, cos(turn), D * ahead, D * D * aside / turn if turn else 0.5 * D * D, 0.0]
    F[0] += way
    F[1, 2], F[2, 2] = T * fade, 1.0 - fade
    F[4] += k * way
    F[4, 5] = D
    F[6, 5:] = gains.l_r / np.sqrt(1.0 - (gains.l_r * k) ** 2) * (1.0 - left), left
    return F


def _by_position(L: Correction, left: float, gains: Gains) -> Array:
    M = np.zeros((7, 7))
    M[:3, 0] = L.along
    M[3:7, 3] = L.across.p, left * L.across.v, left * L.across.a, left * (1.0 - gains.share) * L.across.v
    return M


def _by_heading(L: Correction) -> Array:
    gain = np.array([0.0, 0.0, 0.0, L.offset, L.course, L.curvature, L.course - L.yaw])
    yaw = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0])
    return np.outer(gain, yaw)


def family(gains: Gains, grid: tuple[int, int, int] = GRID) -> Iterator[tuple[float, Array]]:
    """Time step [s] and error matrix, of like size, at each point of the grid and vertex of the rest."""
    dts, speeds, rates, accelerations, *_ = REGION.values()
    for dt, V, w in product(
        np.geomspace(*dts, grid[0]), np.geomspace(*speeds, grid[1]), np.linspace(0.0, rates[1], grid[2])
    ):
        L = correction(dt, V, np.inf, NOMINAL[0] ** 2, NOMINAL[0] ** 2, NOMINAL_HEADING**2, gains)
        for u, h in WEIGHTS:
            A = error_matrix(dt, V, w, L, u, h, gains) / _size(V, gains)
            for a in accelerations:
                yield float(dt), _size(V + a * dt, gains)[:, None] * A


def _size(V: float, gains: Gains) -> Array:
    """What errors are multiplied by to be lengths of like size at speed V."""
    tau, arc = gains.tau, gains.arc * ((V + gains.v0) / NOMINAL[1]) ** (1.0 / 3.0)
    return np.array([1.0, tau, tau**2, 1.0, arc, arc**2, arc])
