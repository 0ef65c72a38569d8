"""The matrix inequalities of all proofs, each written once, in plain operators.

A quadratic form in several signals is written as it is spoken: `x, d = parts(n, k)` are the matrices that
pick the error x (n) and the disturbance d (k) out of their stack, so `both(x.T @ P @ (A @ x + B @ d))` is the
derivative of x'Px along x' = A x + B d. With the gain unknown, P A stands as P F - Y H where Y = P L.

Each is affine in its unknowns (P, Y, multipliers, squared gains): `design` reads a solver's coefficients off
its values, and a proof is checked by calling it with the numbers that were found. Every function returns the
symmetric matrix that must be negative (semi)definite unless it says positive.

[MS] Alai & Rajamani 2023, Multi-Stage Estimation Algorithm for Target Vehicle Trajectory Tracking.
[HG] Alai, Zemouche & Rajamani, Vehicle Trajectory Estimation Using a High-Gain Multi-Output Observer.
What was put right in them is in docs/errata.md.
"""

from __future__ import annotations

from math import cos, pi
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Form = Literal["continuous", "sampled"]

SLIP = pi / 9.0  # largest slip, [MS 8] [rad]


def both(M: Any) -> Any:
    """M + M', twice the symmetric part of M (n, n) or of each of a stack (m, n, n)."""
    return M + M.mT


def parts(*sizes: int) -> list[Array]:
    """Matrices (size_i, sum of sizes) that pick each signal out of the stack of all."""
    return np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1])


def chain(n: int) -> Array:
    """Shift (n, n) of a chain of n integrators, position first."""
    return np.eye(n, k=1)


def alike(M: Array, axes: int = 2) -> Array:
    """I (x) M: the same block M for each of so many axes."""
    return np.asarray(np.kron(np.eye(axes), M), float)


# ------------------------------------------------------------------ given error dynamics A, one or a stack


def decay(A: Any, P: Any, rate: float, form: Form) -> Any:
    """e'Pe falls at least at the rate: as exp(-2 rate t), or by rate^2 a step."""
    if form == "continuous":
        return both(P @ A) + 2.0 * rate * P
    return A.mT @ P @ A - rate**2 * P


def flow(A: Any, B: Any, P: Any, form: Form, keep: Any = 1.0) -> Any:
    """Growth of x'Px along x' = A x + B d as a form in (x, d); sampled: P at the next step minus keep P."""
    x, d = parts(A.shape[-2], B.shape[-1])
    to = A @ x + B @ d
    if form == "continuous":
        return both(x.T @ P @ to)
    return to.mT @ P @ to - keep * (x.T @ P @ x)


def ellipsoid(A: Any, B: Any, P: Any, a: float, form: Form) -> Any:
    """Where |d| <= 1, x'Px <= 1 is never left; a > 0 is a free multiplier, below 1 in sampled form.

    Abedor, Nagpal & Poolla, A linear matrix inequality approach to peak-to-peak gain minimization, 1996.
    """
    x, d = parts(A.shape[-2], B.shape[-1])
    if form == "continuous":
        return flow(A, B, P, form) + a * (x.T @ P @ x) - a * (d.T @ d)
    return flow(A, B, P, form, 1.0 - a) - a * (d.T @ d)


def inside(C: Any, P: Any, gain2: Any) -> Any:
    """Where x'Px <= 1, |C x|^2 is at most gain2."""
    x, y = parts(P.shape[0], C.shape[0])
    return -(x.T @ P @ x) - both(x.T @ C.T @ y) - gain2 * (y.T @ y)


def energy(A: Any, B: Any, C: Any, P: Any, gain2: Any, form: Form) -> Any:
    """The energy of C x is at most gain2 times that of d: the bounded-real lemma."""
    x, d = parts(A.shape[-2], B.shape[-1])
    return flow(A, B, P, form) + x.T @ (C.T @ C) @ x - gain2 * (d.T @ d)


# ------------------------------------------------------------------ unknown gain L = P^-1 Y


def slower(F: Any, H: Any, P: Any, Y: Any, fastest: float) -> Any:
    """No pole of F - L H is further than `fastest` from 0, nor does e'Pe change faster than that.

    Chilali & Gahinet, H-infinity design with pole placement constraints, 1996: the disc.
    """
    e, to = parts(P.shape[0], P.shape[0])
    return both(e.T @ (P @ F - Y @ H) @ to) - fastest * (e.T @ P @ e + to.T @ P @ to)


def gain_within(P: Any, Y: Any, bound2: Any) -> Any:
    """L'PL is at most bound2; where P >= I, so is the square of the spectral norm of L."""
    x, d = parts(P.shape[0], Y.shape[1])
    return both(x.T @ Y @ d) - x.T @ P @ x - bound2 * (d.T @ d)


def estimate(
    F: Any, H: Any, G: Any, C: Any, P: Any, Y: Any, mu: Any, rate: float = 0.0, weight: float = 1.0
) -> Any:
    """With the gain L on y = H x + d, errors of x' = F x + G v fall as exp(-rate t), and do not grow much.

    The energy of C x is at most mu times that of d and `weight` times that of v together.
    """
    x, v, d = parts(F.shape[0], G.shape[1], H.shape[0])
    to = (P @ F - Y @ H) @ x + P @ G @ v - Y @ d
    goal = mu * (weight * (v.T @ v) + d.T @ d) - x.T @ (C.T @ C) @ x
    return both(x.T @ to) + 2.0 * rate * (x.T @ P @ x) - goal


def unknown_gain(F: Any, H: Any, P: Any, Y: Any, rate: float) -> Any:
    """Errors of x' = F x with the gain L on the output H x fall as exp(-rate t)."""
    return both(P @ F - Y @ H) + 2.0 * rate * P


def unknown_sampled_gain(F: Any, H: Any, P: Any, Y: Any, rate: float) -> Any:
    """Errors of x+ = F x, then corrected by the gain L on H x, shrink by the factor `rate` each step."""
    before, after = parts(P.shape[0], P.shape[0])
    step = before.T @ (P @ F - Y @ H @ F).T @ after
    return both(step) - rate**2 * (before.T @ P @ before) - after.T @ P @ after


def speed(P: Any, Y: Any, mu: Any) -> Any:
    """[MS 36] with eps = 1: errors of speed and acceleration have at most mu times the energy of d_S."""
    return estimate(chain(4), np.eye(1, 4), np.zeros((4, 0)), np.eye(4)[1:3], P, Y, mu)


def position(P: Any, Y: Any, mu: Any) -> Any:
    """[MS 70] with eps = 1: position errors against errors of velocity g and of the sensor d, both (2,)."""
    one = np.eye(2)
    return estimate(np.zeros((2, 2)), one, one, one, P, Y, mu)


def orientation(
    P: Any,
    Y: Any,
    multipliers: Any,
    mu: Any,
    V: float,
    l: float = 2.0,
    tight: bool = True,
    rate: float = 0.0,
) -> Any:
    """[MS 58] put right, eps_3 = 1: errors of yaw and slip against d_z and the speed error; l is l_r [m].

    Signals z = (yaw, slip), f = sin(slip) error, v = speed error times sin(slip) / l_r, d_z. Multipliers
    (2,) >= 0: of both conditions on f in [MS 44-45]; tight: the first alone, of the sector cos(20 deg) to 1.
    rate: the errors also decay so fast [1/s]; not in the paper. v counts 36 times as in the paper, where
    sin(20 deg) / l_r = 0.171 is taken for 1/6.
    """
    z, f, v, d = parts(2, 1, 1, 1)
    G, H, b = np.eye(2, 1), np.ones((1, 2)), np.array([[0.0, 1.0]]) @ z
    to = (P @ G) @ (V / l * f + v) - Y @ (H @ z + d)
    if tight:
        slope = multipliers[0] * (0.5 * both((f - b).T @ (f - cos(SLIP) * b)))
    else:
        first = f.T @ f + 0.88 * b.T @ b - both(f.T @ b)
        second = f.T @ f + b.T @ b - 0.94 * both(f.T @ b)
        slope = multipliers[0] * first - multipliers[1] * second
    goal = mu * (36.0 * v.T @ v + d.T @ d) - z.T @ z
    return both(z.T @ to) + 2.0 * rate * (z.T @ P @ z) - slope - goal


def high_gain(P: Any, Y: Any, slack: float) -> Any:
    """[HG 76] for one axis, Y = Q': the chain of three with output position, slack lambda."""
    return both(P @ chain(3) - Y @ np.eye(1, 3)) + slack * np.eye(3)
