"""What a certificate says before anybody has found a proof: error dynamics, region, what is to be bounded.

An observer's file states its claim for given gains and a given region, with NumPy alone. `design` looks for
the numbers that prove it, a file keeps them, and `Claim.certificate` puts both together for checking.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.certificate import Bound, Certificate, peak
from outrider.errors import InputError, NotCertified
from outrider.family import Family
from outrider.inequalities import Form

CONTINUOUS = "The observer runs in continuous time; between two samples the measurement is on their line."
ON_THE_LINE = "Every state on the line between estimate and truth is within the region."
WITHOUT_HOLD = "Every sample is used: nothing is missing, held or limited."
Array = npt.NDArray[np.float64]
Blocks = Sequence[Sequence[Sequence[int]]]


@dataclass(frozen=True, slots=True)
class Sought:
    """An error C x of x' = A x + B d, or x+ = A x + B d, and the disturbance d it is to be bounded by."""

    of: str
    by: str
    A: Array  # (m, n, n)
    B: Array  # (m, n, k)
    C: Array  # (p, n)
    kind: Literal["peak", "energy"] = "peak"
    blocks: Blocks | None = None  # of the ellipsoid's P, as of the claim's

    @property
    def exact(self) -> bool:
        """Whether the impulse response gives it: one matrix, one disturbance, one error."""
        return self.kind == "peak" and len(self.A) == 1 and self.B.shape[2] == self.C.shape[0] == 1

    def bound(self, gain: float, P: Array | None, a: float) -> Bound:
        """The bound with its proof."""
        return Bound(self.of, self.by, gain, self.exact, self.kind, self.A, self.B, self.C, P, a)


class Proof(NamedTuple):
    """Numbers that prove a bound: an ellipsoid and its multiplier; of what and by what, as sought."""

    of: str
    by: str
    kind: str
    gain: float
    P: Array  # (n, n)
    a: float


@dataclass(frozen=True, slots=True)
class Claim:
    """Error dynamics of an observer over a region, and the errors that are to be bounded."""

    observer: str  # name in observers/
    form: Form
    family: Family
    region: Mapping[str, tuple[float, float]]  # quantity with unit -> from, to
    assumptions: tuple[str, ...]
    asked: Mapping[str, Any]  # arguments that make this claim again, all of them
    blocks: Blocks | None = None  # lists of states that form a block of P; blocks of one group are equal
    sought: tuple[Sought, ...] = ()
    states: Family | None = None  # of states of the region itself: where one is unstable, no proof can exist

    def certificate(self, P: Array, rate: float, proofs: Iterable[Proof] = ()) -> Certificate:
        """The claim with what is said to prove it; exact bounds are computed here.

        InputError where a shape does not fit, NotCertified where P is not of the blocks that the claim's
        argument needs, such as the same on both axes of a frame that turns.
        """
        _of_blocks(self.observer, P, self.blocks)
        known = {(p.of, p.by, p.kind): p for p in proofs}
        bounds = []
        for s in self.sought:
            if s.exact:
                gain = peak(s.A[0], s.B[0], s.C, self.form)
                if np.isfinite(gain):
                    bounds.append(s.bound(gain, None, 0.0))
            elif found := known.pop((s.of, s.by, s.kind), None):
                _of_blocks(self.observer, found.P, s.blocks)
                bounds.append(s.bound(found.gain, found.P, found.a))
        if known:
            raise InputError(f"{self.observer}: no bound is sought on {next(iter(known))[0]}; make it anew")
        return Certificate(
            self.observer,
            self.form,
            self.family.matrices,
            P,
            rate,
            dict(self.region),
            self.assumptions,
            tuple(bounds),
            self.family.corners,
        )


def _of_blocks(observer: str, P: Array, blocks: Blocks | None) -> None:
    if blocks is None:
        return
    n = sum(len(states) for group in blocks for states in group)
    if np.shape(P) != (n, n):
        raise InputError(f"{observer}: P has shape {np.shape(P)}; want {(n, n)}")
    made = np.zeros((n, n))
    for group in blocks:
        for states in group:
            made[np.ix_(states, states)] = P[np.ix_(group[0], group[0])]
    if not np.array_equal(made, P):
        raise NotCertified(f"{observer}: P is not of the blocks that its proof needs; make it anew")
