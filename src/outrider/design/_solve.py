"""CVXPY and Clarabel, and the rule that their word is not taken: what they find is checked elsewhere."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.certificate import Certificate
from outrider.errors import InputError, NotCertified

Array = npt.NDArray[np.float64]
SOLVER = "CLARABEL"


class Solved(NamedTuple):
    """What a solver said of itself; it proves nothing."""

    solver: str
    status: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Design:
    """A gain and the proof of it."""

    gain: Array  # shape and units as the function that made it says
    certificate: Certificate
    solved: Solved
    noise: float = float("nan")  # proven L2 gain from the measurement's error to what was weighed

    def __str__(self) -> str:
        """The gain, the solver's word and the certificate's report."""
        rows = np.array2string(self.gain, precision=6, suppress_small=True)
        s = self.solved
        return f"gain {rows}\n{s.solver} said {s.status} in {s.seconds:.2f} s\n{self.certificate}"


def cvxpy() -> Any:
    """The library, or InputError that says how to have it."""
    try:
        import cvxpy
    except ImportError as error:
        raise InputError("designing gains needs CVXPY; want pip install 'outrider[design]'") from error
    return cvxpy


def symmetric(n: int) -> Any:
    """Unknown symmetric matrix (n, n)."""
    return cvxpy().Variable((n, n), symmetric=True)


def unknown(*shape: int, positive: bool = False) -> Any:
    """Unknown number or matrix."""
    return cvxpy().Variable(shape, nonneg=positive)


def below(M: Any, slack: Any = 0.0) -> Any:
    """Constraint M <= -slack I on a symmetric expression (n, n)."""
    return -M >> slack * np.eye(M.shape[0])


def least(objective: Any, constraints: Sequence[Any]) -> Solved:
    """Minimise; the values are in the unknowns afterwards, None where the solver found nothing."""
    cp = cvxpy()
    problem, begin = cp.Problem(cp.Minimize(objective), list(constraints)), time.perf_counter()
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # of inaccuracy: nothing is believed anyway
            problem.solve(solver=SOLVER)
        status = str(problem.status)
    except cp.error.SolverError:
        status = "failed"
    return Solved(SOLVER, status, time.perf_counter() - begin)


def value(unknown: Any, solved: Solved, otherwise: str) -> Array:
    """Number found for an unknown; NotCertified, with what to do `otherwise`, where there is none."""
    found = unknown.value
    if found is None or not np.isfinite(found).all():
        raise NotCertified(f"the solver said {solved.status!r} and found nothing: {otherwise}")
    return np.asarray(found, float)
