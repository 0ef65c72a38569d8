"""A proof of stability as data, re-checked from its definition with NumPy alone.

A certificate says: for every matrix A of a family, the error dynamics e' = A e (continuous form) or
e+ = A e (sampled form) shrinks V(e) = e' P e at least at the given rate. The family is what an observer's
gains give over a region of speed, time step and so on; its corners or grid points are the `matrices`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Bound:
    """|error of `of`| <= gain * max |disturbance `by`|, once the start is forgotten."""

    of: str  # what is estimated, such as "speed"
    by: str  # the disturbance, such as "position"
    gain: float  # unit of `of` per unit of `by`
    exact: bool  # reached by some disturbance (impulse response), or an upper bound only


@dataclass(frozen=True, slots=True)
class Certificate:
    """P and a rate for a family of error matrices, the region and the assumptions under which it is one."""

    observer: str  # name in observers/
    form: Literal["continuous", "sampled"]  # which difference or differential equation runs
    matrices: Array  # (m, n, n) error matrices, scaled to states of like size
    P: Array  # (n, n)
    rate: float  # continuous: e decays as exp(-rate t) [1/s]; sampled: each step by at least this factor [-]
    region: Mapping[str, tuple[float, float]]  # quantity with unit -> from, to
    assumptions: tuple[str, ...]  # what must hold besides, one sentence each
    bounds: tuple[Bound, ...] = field(default=())

    def margin(self) -> float:
        """Smallest slack of all inequalities, relative to the size of their matrices; positive: proven.

        Continuous: -(A'P + P A + 2 rate P); sampled: rate^2 P - A'P A; and P itself; each divided by its
        largest term's spectral norm.
        """
        P = 0.5 * (self.P + self.P.T)
        slack = [_least(P, _size(P))]
        for A in self.matrices:
            if self.form == "continuous":
                S = A.T @ P + P @ A + 2.0 * self.rate * P
                slack.append(_least(-S, _size(A.T @ P) + self.rate * _size(P)))
            else:
                S = self.rate**2 * P - A.T @ P @ A
                slack.append(_least(S, _size(A.T @ P @ A) + self.rate**2 * _size(P)))
        return min(slack)

    def tolerance(self) -> float:
        """What rounding alone can make of a margin: 100 n machine epsilons."""
        return 100.0 * len(self.P) * float(np.finfo(float).eps)

    def proven(self) -> bool:
        """Whether the margin is beyond rounding."""
        return self.margin() > self.tolerance()


def _size(M: Array) -> float:
    return max(float(np.linalg.norm(M, 2)), np.finfo(float).tiny)


def _least(S: Array, size: float) -> float:
    """Smallest eigenvalue of the symmetric part of S, relative to `size`; -inf where it is not finite."""
    if not np.isfinite(S).all():
        return -np.inf
    return float(np.linalg.eigvalsh(0.5 * (S + S.T))[0]) / size
