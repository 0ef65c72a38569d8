"""How far an error can be when the sensor is wrong by at most so much: peak-to-peak and L2 gains."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from outrider import certificate, inequalities
from outrider.certificate import Bound
from outrider.design._solve import Problem
from outrider.errors import NotCertified
from outrider.inequalities import Form

Array = npt.NDArray[np.float64]
ROOM = 1.01  # a bound is stated this much above the smallest found, so that its proof has a margin [-]


def exact(of: str, by: str, A: Array, B: Array, C: Array, form: Form = "continuous") -> Bound:
    """Peak-to-peak gain of one linear error dynamics, by the impulse response; B (n, 1), C (1, n)."""
    gain = certificate.peak(A, B, C, form)
    if not np.isfinite(gain):
        raise NotCertified(f"bound on {of}: the error dynamics is not stable; no bound exists")
    return Bound(of, by, gain, True, "peak", A[None], B[None], C)


def bound(
    of: str,
    by: str,
    A: Array,
    B: Array,
    C: Array,
    *,
    kind: Literal["peak", "energy"] = "peak",
    form: Form = "continuous",
) -> Bound:
    """Smallest provable gain, a little widened, over a family A (m, n, n) with inputs B (m, n, k), outputs C.

    energy: bounded-real lemma. peak: invariant ellipsoid, line search over its multiplier.
    NotCertified where none is found.
    """
    A, B = np.atleast_3d(A), np.atleast_3d(B)
    if kind == "energy":
        g2 = _smallest_energy(A, B, C, form, of)
        found = _widest(of, by, A, B, C, kind, form, np.sqrt(g2) * ROOM, 0.0)
    else:
        gain, a = _best_multiplier(A, B, C, form, of)
        found = _widest(of, by, A, B, C, kind, form, gain * ROOM, a)
    if not found.margin(form) > 100.0 * A.shape[-1] * certificate.EPS:
        raise NotCertified(f"bound on {of}: checked margin {found.margin(form):.1e}; scale the states alike")
    return found


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


def _smallest_energy(A: Array, B: Array, C: Array, form: Form, of: str) -> float:
    """Smallest squared L2 gain that one P proves for the whole family."""
    problem = Problem()
    P, g2 = problem.symmetric(A.shape[-1]), problem.number()
    problem.below(lambda P: -P, P)
    for a, b in zip(A, B, strict=True):
        problem.below(lambda P, g2, A, B: inequalities.energy(A, B, C, P, g2, form), P, g2, A=a, B=b)
    solved = problem.minimise(g2)
    if not solved.optimal:
        raise NotCertified(f"bound on {of}: the solver said {solved.status!r}; no common proof was found")
    return float(problem.found(g2, solved, "narrow the region"))


def _smallest_peak(A: Array, B: Array, C: Array, form: Form, a: float) -> float:
    """Smallest peak gain by an ellipsoid with the multiplier a; inf where there is none."""
    problem = Problem()
    P, g2 = problem.symmetric(A.shape[-1]), problem.number()
    for p, b in zip(A, B, strict=True):
        problem.below(lambda P, A, B: inequalities.ellipsoid(A, B, P, a, form), P, A=p, B=b)
    problem.below(lambda P, g2: inequalities.inside(C, P, g2), P, g2)
    solved = problem.minimise(g2)
    found = problem.found(g2, solved, "") if solved.optimal else -1.0
    return float(np.sqrt(found)) if found > 0.0 else np.inf


def _best_multiplier(A: Array, B: Array, C: Array, form: Form, of: str) -> tuple[float, float]:
    """Smallest peak gain and its multiplier: golden section, after a coarse look."""
    poles = np.linalg.eigvals(A)
    if form == "continuous":
        limit = -2.0 * float(poles.real.max())
    else:
        limit = 1.0 - float(np.abs(poles).max()) ** 2
    if not limit > 0.0:
        raise NotCertified(f"bound on {of}: the error dynamics is not stable; no bound exists")

    def gain(share: float) -> float:
        return _smallest_peak(A, B, C, form, share * limit)

    shares = np.linspace(0.05, 0.95, 10)
    values = [gain(float(s)) for s in shares]
    i = int(np.argmin(values))
    if not np.isfinite(values[i]):
        raise NotCertified(f"bound on {of}: no invariant ellipsoid was found; narrow the region")
    low, high = float(shares[max(i - 1, 0)]), float(shares[min(i + 1, 9)])
    golden = (np.sqrt(5.0) - 1.0) / 2.0
    best, at = values[i], float(shares[i])
    for _ in range(8):
        left, right = high - golden * (high - low), low + golden * (high - low)
        l, r = gain(left), gain(right)
        best, at = min((best, at), (l, left), (r, right))
        low, high = (low, right) if l < r else (left, high)
    return best, at * limit


def _widest(
    of: str, by: str, A: Array, B: Array, C: Array, kind: Any, form: Form, gain: float, a: float
) -> Bound:
    """The bound with the P of the largest margin."""
    n, g2, problem = A.shape[-1], float(gain) ** 2, Problem()
    P, margin = problem.symmetric(n), problem.number()
    problem.below(lambda P, margin: margin * np.eye(n) - P, P, margin)

    def grown(P: Array, margin: float, A: Array, B: Array) -> Array:
        if kind == "peak":
            M = inequalities.ellipsoid(A, B, P, a, form)
        else:
            M = inequalities.energy(A, B, C, P, g2, form)
        return np.asarray(M + margin * np.eye(len(M)))

    def reached(P: Array, margin: float) -> Array:
        M = inequalities.inside(C, P, g2)
        return np.asarray(M + min(1.0, g2) * margin * np.eye(len(M)))

    if kind == "peak":
        problem.below(reached, P, margin)
    for p, b in zip(A, B, strict=True):
        problem.below(grown, P, margin, A=p, B=b)
    solved = problem.minimise(margin, sign=-1.0)
    return Bound(of, by, gain, False, kind, A, B, C, problem.found(P, solved, "scale the states alike"), a)
