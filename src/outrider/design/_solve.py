"""Linear matrix inequalities for Clarabel, and the rule that its word is not taken.

An inequality is handed over as the plain function it is, M(unknowns) <= 0, and is affine in them: its values
at zero and at one unit of each unknown are its coefficients, so no expression has to be taken apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.certificate import Certificate
from outrider.claim import Blocks
from outrider.errors import InputError, NotCertified
from outrider.proof_file import ProofFile

Array = npt.NDArray[np.float64]
SOLVER = "Clarabel"


class Solved(NamedTuple):
    """What a solver said of itself; it proves nothing."""

    solver: str
    status: str
    seconds: float

    @property
    def optimal(self) -> bool:
        """Whether it claims to have found the best there is, perhaps inaccurately."""
        return self.status in ("Solved", "AlmostSolved")


@dataclass(frozen=True, slots=True)
class Design:
    """A gain and the proof of it."""

    gain: Array  # shape and units as the function that made it says
    certificate: Certificate
    solved: Solved
    noise: float = float("nan")  # proven L2 gain from the measurement's error to what was weighed
    file: ProofFile | None = None  # of an observer as a whole: what is to be kept

    def __str__(self) -> str:
        """The gain, the solver's word and the certificate's report."""
        rows = np.array2string(self.gain, precision=6, suppress_small=True)
        s = self.solved
        return f"gain {rows}\n{s.solver} said {s.status} in {s.seconds:.2f} s\n{self.certificate}"


@dataclass(frozen=True, slots=True, eq=False)
class Unknown:
    """Some of a problem's unknown numbers, as the matrix or number they stand for."""

    first: int  # place of the first among all
    basis: Array  # (k, r, c): what one unit of each means; (1,) for a number

    def value(self, x: Array) -> Any:
        """Matrix (r, c), or number, for given values of all unknowns."""
        part = np.tensordot(x[self.first : self.first + len(self.basis)], self.basis, 1)
        return part if part.ndim else float(part)


class Problem:
    """Minimise a sum of unknowns under matrix inequalities."""

    def __init__(self) -> None:
        """Nothing unknown, nothing asked."""
        self.size = 0
        self._rows: list[tuple[Array, Array, Array]] = []  # columns (k,), their entries (m, k), constant (m,)
        self._cones: list[int] = []

    def symmetric(self, n: int, blocks: Blocks | None = None) -> Unknown:
        """Unknown symmetric matrix (n, n), full or of `blocks`: lists of states, those of one group alike."""
        basis = []
        for group in blocks or [[range(n)]]:
            for i, j in zip(*map(np.ndarray.tolist, np.triu_indices(len(group[0]))), strict=True):
                unit = np.zeros((n, n))
                for states in group:
                    unit[states[i], states[j]] = unit[states[j], states[i]] = 1.0
                basis.append(unit)
        return self._new(np.array(basis, float))

    def matrix(self, rows: int, columns: int, axes: int = 1) -> Unknown:
        """Unknown matrix (rows, columns); with axes, the same block on each of them."""
        r, c = rows // axes, columns // axes
        return self._new(np.asarray(np.kron(np.eye(axes), np.eye(r * c).reshape(r * c, r, c)), float))

    def number(self) -> Unknown:
        """Unknown number."""
        return self._new(np.ones(1))

    def _new(self, basis: Array) -> Unknown:
        unknown = Unknown(self.size, basis)
        self.size += len(basis)
        return unknown

    def below(self, condition: Callable[..., Any], *unknowns: Unknown, **given: Any) -> None:
        """Ask that condition(*values, **given), symmetric, affine in the values, is negative semidefinite."""
        nothing = [unknown.value(np.zeros(self.size)) for unknown in unknowns]
        constant = np.atleast_2d(condition(*nothing, **given))
        j, i = np.tril_indices(len(constant))  # the upper triangle, column by column
        scale = np.where(i == j, 1.0, sqrt(2.0))
        columns, entries = [], []
        for place, unknown in enumerate(unknowns):
            for k, unit in enumerate(unknown.basis):
                values = list(nothing)
                values[place] = unit
                entries.append(scale * (np.atleast_2d(condition(*values, **given)) - constant)[i, j])
                columns.append(unknown.first + k)
        self._rows.append((np.array(columns), np.array(entries).T, -scale * constant[i, j]))
        self._cones.append(len(constant))

    def minimise(self, *unknowns: Unknown, sign: float = 1.0) -> Solved:
        """Make the sum of these numbers least (sign -1: greatest); `found` has the values afterwards."""
        clarabel = _clarabel()
        from scipy.sparse import csc_matrix

        begin = time.perf_counter()
        q = np.zeros(self.size)
        for unknown in unknowns:
            q[unknown.first : unknown.first + len(unknown.basis)] += sign
        A = np.zeros((sum(len(b) for _, _, b in self._rows), self.size))
        row = 0
        for columns, entries, b in self._rows:
            A[row : row + len(b), columns] = entries
            row += len(b)
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        cones = [clarabel.PSDTriangleConeT(n) for n in self._cones]
        right = np.concatenate([b for _, _, b in self._rows])
        solver = clarabel.DefaultSolver(
            csc_matrix((self.size, self.size)), q, csc_matrix(A), right, cones, settings
        )
        answer = solver.solve()
        self._x = np.asarray(answer.x, float)
        return Solved(SOLVER, str(answer.status), time.perf_counter() - begin)

    def found(self, unknown: Unknown, solved: Solved, otherwise: str) -> Any:
        """Value found for an unknown; NotCertified, with what to do `otherwise`, where there is none."""
        if "Infeasible" in solved.status or not np.isfinite(self._x).all():
            raise NotCertified(f"the solver said {solved.status!r} and found nothing: {otherwise}")
        return unknown.value(self._x)


def _clarabel() -> Any:
    """The library, or InputError that says how to have it."""
    try:
        import clarabel
    except ImportError as error:
        raise InputError("designing gains needs Clarabel; want pip install 'outrider[design]'") from error
    return clarabel
