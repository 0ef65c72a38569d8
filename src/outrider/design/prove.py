"""Search a proof for given gains: one P for a whole family of error matrices, with the largest margin."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from outrider import inequalities
from outrider.certificate import Certificate, unstable
from outrider.claim import Claim, Proof
from outrider.design._solve import Problem, Solved
from outrider.design.bounds import bound
from outrider.errors import NotCertified
from outrider.family import Family

Array = npt.NDArray[np.float64]


def prove(claim: Claim, rate: float, *, bounds: bool = True) -> tuple[Certificate, tuple[Proof, ...], Solved]:
    """Certificate that a claim's errors decay at `rate`, re-checked with NumPy, and proofs of its bounds.

    rate: [1/s] in continuous form, else the factor of a step. bounds: also search what the claim seeks.
    NotCertified where a matrix alone is unstable at that rate (which one and its eigenvalue are named), where
    no common P exists, or where its margin does not stand up to rounding.
    """
    if claim.states:
        _refuse_unstable(claim, claim.states, rate, "no proof can exist")
    _refuse_unstable(claim, claim.family, rate, "no proof over these corners can exist")
    matrices, form = claim.family.matrices, claim.form
    problem, one = Problem(), np.eye(matrices.shape[1])
    P, margin = problem.symmetric(len(one), claim.blocks), problem.number()

    def shrinks(P: Array, margin: float, A: Array) -> Array:
        size = max(float(np.linalg.norm(A, 2)) ** (1 if form == "continuous" else 2), rate)
        M: Array = inequalities.decay(A, P, rate, form) / size + margin * one
        return M

    problem.below(lambda P: P - one, P)
    problem.below(lambda P, margin: margin * one - P, P, margin)
    for A in np.unique(matrices, axis=0):
        problem.below(shrinks, P, margin, A=A)
    solved = problem.minimise(margin, sign=-1.0)
    found = problem.found(P, solved, "lower the rate or narrow the region")
    accept(claim.certificate(found, rate), solved)
    wanted = [s for s in claim.sought if bounds and not s.exact]
    proofs = tuple(bound(s, claim.form) for s in wanted)
    return accept(claim.certificate(found, rate, proofs), solved), proofs, solved


def accept(certificate: Certificate, solved: Solved) -> Certificate:
    """The certificate itself; NotCertified where NumPy alone does not confirm it."""
    margin, tolerance = certificate.margin(), certificate.tolerance()
    if not margin > tolerance:
        raise NotCertified(
            f"{certificate.observer}: no proof over this region at rate {certificate.rate:g} (the solver "
            f"said {solved.status!r}, checked margin {margin:.1e}, rounding {tolerance:.0e}); narrow the "
            "region or lower the rate"
        )
    return certificate


def _refuse_unstable(claim: Claim, family: Family, rate: float, verdict: str) -> None:
    """NotCertified, with the corner and the eigenvalue, where one matrix alone does not decay at `rate`."""
    if found := unstable(family.matrices, family.corners, rate, claim.form):
        raise NotCertified(
            f"{claim.observer}: {verdict}: {found}; narrow the region, lower the rate or change the gain"
        )
