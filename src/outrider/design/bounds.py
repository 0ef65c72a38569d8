"""How far an error can be when the sensor is wrong by at most so much: peak-to-peak and L2 gains."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from outrider import inequalities
from outrider.certificate import EPS
from outrider.claim import Proof, Sought
from outrider.design._solve import Problem, Unknown
from outrider.errors import NotCertified
from outrider.inequalities import Form

Array = npt.NDArray[np.float64]
LOOKS = 7  # values of the multiplier tried before the best is refined
ROOM = 1.01, 1.05, 1.25  # a bound is stated so much above the least found: its proof needs a margin [-]


def bound(sought: Sought, form: Form = "continuous") -> Proof:
    """Smallest provable gain, a little widened, over a family; checked without the solver.

    energy: bounded-real lemma. peak: invariant ellipsoid, line search over its multiplier; where the impulse
    response gives it exactly no proof is needed. NotCertified where none is found.
    """
    search = _Search(sought, form)
    gain, a = (search.energy(), 0.0) if sought.kind == "energy" else search.peak()
    for room in ROOM:
        found = Proof(sought.of, sought.by, sought.kind, room * gain, search.widest(room * gain, a), a)
        margin = sought.bound(found.gain, found.P, a).margin(form)
        if margin > 100.0 * sought.A.shape[-1] * EPS:
            return found
    raise NotCertified(f"bound on {sought.of}: checked margin {margin:.1e}; scale the states alike")


def smallest(condition: Callable[..., Any], n: int, multipliers: int = 0) -> float:
    """Smallest number mu for which some P (n, n) > 0 and multipliers make every condition negative.

    condition(P, multipliers, mu) gives one matrix or a list of them, such as [MS 36], [MS 58] and [MS 70]
    with a known gain and Y = P @ L; multipliers (multipliers,) are at least 0. It is what the solver says,
    and no proof; NotCertified where none exists.
    """
    problem = Problem()
    P, mu, free = problem.symmetric(n), problem.number(), problem.matrix(multipliers, 1)
    problem.below(lambda P: -P, P)
    if multipliers:
        problem.below(lambda free: -np.diag(free[:, 0]), free)

    def one(P: Array, free: Array, mu: float, k: int) -> Any:
        return _listed(condition(P, free[:, 0], mu))[k]

    for k in range(len(_listed(condition(np.zeros((n, n)), np.zeros(multipliers), 0.0)))):
        problem.below(one, P, free, mu, k=k)
    solved = problem.minimise(mu)
    if not solved.optimal:
        raise NotCertified(f"no proof with this gain: the solver said {solved.status!r}")
    return float(problem.found(mu, solved, "change the gain"))


def _listed(matrices: Any) -> list[Any]:
    return list(matrices) if isinstance(matrices, list | tuple) else [matrices]


class _Search:
    """The searches for one bound."""

    def __init__(self, sought: Sought, form: Form) -> None:
        self.sought, self.form = sought, form
        self.pairs = list(zip(sought.A, sought.B, strict=True))

    def _problem(self) -> tuple[Problem, Unknown]:
        problem = Problem()
        return problem, problem.symmetric(self.sought.A.shape[-1], self.sought.blocks)

    def energy(self) -> float:
        """Smallest L2 gain that one P proves for the whole family."""
        problem, P = self._problem()
        g2, C = problem.number(), self.sought.C
        problem.below(lambda P: -P, P)
        for A, B in self.pairs:
            problem.below(lambda P, g2, A, B: inequalities.energy(A, B, C, P, g2, self.form), P, g2, A=A, B=B)
        solved = problem.minimise(g2)
        if not solved.optimal:
            raise NotCertified(
                f"bound on {self.sought.of}: the solver said {solved.status!r}; no common proof was found"
            )
        return float(np.sqrt(problem.found(g2, solved, "narrow the region")))

    def _ellipsoid(self, a: float) -> float:
        """Smallest peak gain by an ellipsoid with the multiplier a; inf where there is none."""
        problem, P = self._problem()
        g2, C = problem.number(), self.sought.C
        for A, B in self.pairs:
            problem.below(lambda P, A, B: inequalities.ellipsoid(A, B, P, a, self.form), P, A=A, B=B)
        problem.below(lambda P, g2: inequalities.inside(C, P, g2), P, g2)
        solved = problem.minimise(g2)
        found = problem.found(g2, solved, "") if solved.optimal else -1.0
        return float(np.sqrt(found)) if found > 0.0 else np.inf

    def peak(self) -> tuple[float, float]:
        """Smallest peak gain and its multiplier, searched on a line after a coarse look."""
        from scipy.optimize import minimize_scalar

        of, poles = self.sought.of, np.linalg.eigvals(self.sought.A)
        if self.form == "continuous":
            limit = -2.0 * float(poles.real.max())
        else:
            limit = 1.0 - float(np.abs(poles).max()) ** 2
        if not limit > 0.0:
            raise NotCertified(f"bound on {of}: the error dynamics is not stable; no bound exists")
        shares = np.linspace(0.05, 0.95, LOOKS)
        values = [self._ellipsoid(float(share) * limit) for share in shares]
        i = int(np.argmin(values))
        if not np.isfinite(values[i]):
            raise NotCertified(f"bound on {of}: no invariant ellipsoid was found; narrow the region")
        between = float(shares[max(i - 1, 0)]), float(shares[min(i + 1, LOOKS - 1)])
        least = minimize_scalar(
            lambda share: min(self._ellipsoid(share * limit), 1e9), bounds=between, method="bounded",
            options={"xatol": 0.01},
        )  # fmt: skip
        gain, share = min((values[i], float(shares[i])), (float(least.fun), float(least.x)))
        return gain, share * limit

    def widest(self, gain: float, a: float) -> Array:
        """P (n, n) of the largest margin for a given gain."""
        problem, P = self._problem()
        margin, C, g2, form = problem.number(), self.sought.C, gain**2, self.form

        def grown(P: Array, margin: float, A: Array, B: Array) -> Array:
            if self.sought.kind == "peak":
                M = inequalities.ellipsoid(A, B, P, a, form)
            else:
                M = inequalities.energy(A, B, C, P, g2, form)
            return np.asarray(M + margin * np.eye(len(M)))

        def reached(P: Array, margin: float) -> Array:
            M = inequalities.inside(C / gain, P, 1.0)
            return np.asarray(M + margin * np.eye(len(M)))

        problem.below(lambda P, margin: margin * np.eye(len(P)) - P, P, margin)
        if self.sought.kind == "peak":
            problem.below(reached, P, margin)
        for A, B in self.pairs:
            problem.below(grown, P, margin, A=A, B=B)
        solved = problem.minimise(margin, sign=-1.0)
        return np.asarray(problem.found(P, solved, "scale the states alike"))
