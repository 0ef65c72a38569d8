"""How far an error can be when the sensor is wrong by at most so much: peak-to-peak and L2 gains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from outrider import certificate, inequalities
from outrider.certificate import Bound
from outrider.design._solve import Solved, below, least, symmetric, unknown, value
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
        g2, _, _ = _smallest(A, B, C, lambda A, B, P, g2: inequalities.energy(A, B, C, P, g2, form), of)
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
    with a known gain and Y = P @ L. It is what the solver says, and no proof; NotCertified where none exists.
    """
    P, mu = symmetric(n), unknown()
    free = unknown(multipliers, positive=True) if multipliers else None
    matrices = condition(P, free, mu)
    matrices = matrices if isinstance(matrices, Sequence) else [matrices]
    solved = least(mu, [P >> 0, *(below(M) for M in matrices)])
    if not solved.status.startswith("optimal"):
        raise NotCertified(f"no proof with this gain: the solver said {solved.status!r}")
    return float(value(mu, solved, "change the gain"))


def _smallest(
    A: Array, B: Array, C: Array, condition: Callable[..., Any], of: str
) -> tuple[float, Array, Solved]:
    P, g2 = symmetric(A.shape[-1]), unknown()
    constraints = [P >> 0, *(below(condition(a, b, P, g2)) for a, b in zip(A, B, strict=True))]
    solved = least(g2, constraints)
    if not solved.status.startswith("optimal"):
        raise NotCertified(f"bound on {of}: the solver said {solved.status!r}; no common proof was found")
    return float(value(g2, solved, "narrow the region")), value(P, solved, "narrow the region"), solved


def _best_multiplier(A: Array, B: Array, C: Array, form: Form, of: str) -> tuple[float, float]:
    """Smallest peak gain and its multiplier: golden section over the logarithm, after a coarse look."""
    poles = np.linalg.eigvals(A)
    if form == "continuous":
        limit = -2.0 * float(poles.real.max())
    else:
        limit = 1.0 - float(np.abs(poles).max()) ** 2
    if not limit > 0.0:
        raise NotCertified(f"bound on {of}: the error dynamics is not stable; no bound exists")

    def gain(share: float) -> float:
        a = share * limit
        P, g2 = symmetric(A.shape[-1]), unknown()
        conditions = [below(inequalities.ellipsoid(p, b, P, a, form)) for p, b in zip(A, B, strict=True)]
        solved = least(g2, [below(inequalities.inside(C, P, g2)), *conditions])
        good = solved.status.startswith("optimal") and g2.value is not None and g2.value > 0.0
        return float(np.sqrt(g2.value)) if good else np.inf

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
    n = A.shape[-1]
    P, margin, g2 = symmetric(n), unknown(), float(gain) ** 2
    constraints = [P >> margin * np.eye(n)]
    if kind == "peak":
        constraints.append(below(inequalities.inside(C, P, g2), margin * min(1.0, g2)))
    for p, b in zip(A, B, strict=True):
        if kind == "peak":
            M = inequalities.ellipsoid(p, b, P, a, form)
        else:
            M = inequalities.energy(p, b, C, P, g2, form)
        constraints.append(below(M, margin))
    solved = least(-margin, constraints)
    return Bound(of, by, gain, False, kind, A, B, C, value(P, solved, "scale the states alike"), a)
