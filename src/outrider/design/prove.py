"""Search a proof for given gains: one P for a whole family of error matrices, with the largest margin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from outrider import inequalities
from outrider.certificate import Bound, Certificate
from outrider.design._solve import Problem, Solved
from outrider.errors import NotCertified
from outrider.family import Family, axes_of
from outrider.inequalities import Form

Array = npt.NDArray[np.float64]
Blocks = Sequence[Sequence[Sequence[int]]]


def prove(
    observer: str,
    family: Family,
    rate: float,
    *,
    form: Form = "continuous",
    blocks: Blocks | None = None,
    region: Mapping[str, tuple[float, float]],
    assumptions: Sequence[str] = (),
    bounds: Sequence[Bound] = (),
) -> tuple[Certificate, Solved]:
    """Certificate that every matrix of a family decays at `rate`, re-checked without the solver.

    blocks: the shape of P; lists of states that form a block, blocks of one group being equal; None: full.
    NotCertified where a matrix alone is unstable at that rate (which one and its eigenvalue are named), where
    no common P exists, or where its margin does not stand up to rounding.
    """
    refuse_unstable(observer, family, rate, form, "no proof over these corners can exist")
    n = family.matrices.shape[1]
    picks = axes_of(n, blocks or [[range(n)]])
    problem, one = Problem(), np.eye(n)
    unknowns, margin = [problem.symmetric(len(group[0])) for group in picks], problem.number()

    def whole(*blocks: Array) -> Array:
        out: Array = sum(E.T @ M @ E for M, g in zip(blocks, picks, strict=True) for E in g) + np.zeros(
            (n, n)
        )
        return out

    def shrinks(margin: float, *blocks: Array, A: Array) -> Array:
        size = max(float(np.linalg.norm(A, 2)) ** (1 if form == "continuous" else 2), rate)
        M: Array = inequalities.decay(A, whole(*blocks), rate, form) / size + margin * one
        return M

    problem.below(lambda *M: whole(*M) - one, *unknowns)
    problem.below(lambda margin, *M: margin * one - whole(*M), margin, *unknowns)
    for A in np.unique(family.matrices, axis=0):
        problem.below(shrinks, margin, *unknowns, A=A)
    solved = problem.minimise(margin, sign=-1.0)
    advice = "lower the rate or narrow the region"
    P = whole(*(problem.found(M, solved, advice) for M in unknowns))
    certificate = Certificate(
        observer,
        form,
        family.matrices,
        P,
        rate,
        dict(region),
        tuple(assumptions),
        tuple(bounds),
    )
    return accept(certificate, solved), solved


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


def refuse_unstable(observer: str, family: Family, rate: float, form: Form, verdict: str) -> None:
    """NotCertified, with the corner and the eigenvalue, where one matrix alone does not decay at `rate`."""
    poles = np.linalg.eigvals(family.matrices)
    pace = poles.real if form == "continuous" else np.abs(poles)
    i, j = np.unravel_index(int(np.argmax(pace)), pace.shape)
    limit = 0.0 - rate if form == "continuous" else rate
    if pace[i, j] >= limit:
        pole = complex(poles[i, j])
        raise NotCertified(
            f"{observer}: {verdict}: at {family.corners[i]} the frozen error dynamics has the eigenvalue "
            f"{pole.real:+.4g}{f'{pole.imag:+.4g}i' if pole.imag else ''}, want "
            f"{'its real part' if form == 'continuous' else 'its magnitude'} below {limit:g}; narrow the "
            "region, lower the rate or change the gain"
        )
