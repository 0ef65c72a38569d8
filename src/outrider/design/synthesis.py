"""The gain itself: least noise under a decay rate and a region of poles, one P for all operating points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider import inequalities
from outrider.design._solve import Solved, below, least, symmetric, unknown, value
from outrider.errors import InputError

Array = npt.NDArray[np.float64]
ROOM = 1.05  # the noise gain may grow by this for the sake of the margin [-]


class Entry(NamedTuple):
    """One operating point with a gain of its own."""

    F: Array  # (m, n, n) corners of the model's Jacobian
    rate: float  # errors decay at least as exp(-rate t) [1/s]
    fastest: float  # no pole further from 0 than this [1/s]


def synthesise(
    entries: Sequence[Entry],
    H: Array,
    C: Array,
    *,
    G: Array | None = None,
    weight: float = 1.0,
    axes: int = 1,
    scale: Array | None = None,
) -> tuple[list[Array], Array, list[float], Solved]:
    """Gains (n, p) of all entries, their common P (n, n), proven noise gains, and the solver's word.

    For each corner F of an entry, errors of x' = F x + G v with the gain on y = H x + d decay at its rate, no
    pole is faster than its limit, and the energy of C x is at most mu times that of (d, sqrt(weight) v).
    First the sum of all mu is made small; then mu may grow by 5 %, and the margin is made large. The gains of
    the entries may be switched at will, since P is common.

    axes: the state and output consist of that many alike parts, treated alike (P = I (x) P1).
    scale: size (n,) of the states beside each other. InputError for a region of poles that is empty.
    """
    n, p = H.shape[1], H.shape[0]
    T = np.ones(n) if scale is None else np.asarray(scale, float)
    G = np.zeros((n, 0)) if G is None else G
    for e in entries:
        if not 0.0 <= e.rate < e.fastest:
            raise InputError(f"rate {e.rate:g}, fastest {e.fastest:g}; want 0 <= rate < fastest [1/s]")
    one = symmetric(n // axes)
    P = inequalities.alike(one, axes)
    Y = [unknown(n // axes, p // axes) for _ in entries]
    mu, margin = unknown(len(entries), positive=True), unknown()

    def conditions(mus: Any, slack: Any) -> list[Any]:
        out = [P >> slack * np.eye(n)]
        for i, e in enumerate(entries):
            YT = inequalities.alike(Y[i], axes)
            for F in e.F:
                A, N = F / T[:, None] * T, H * T
                M = inequalities.estimate(A, N, G / T[:, None], C * T, P, YT, mus[i], e.rate, weight)
                disc = inequalities.slower(A, N, P, YT, e.fastest) / e.fastest
                out += [below(M, slack), below(disc, slack)]
        return out

    advice = "lower the rate, raise `fastest`, or narrow the region"
    first = least(sum(mu), conditions(mu, 1e-6))
    fixed = np.maximum(value(mu, first, advice), 1e-9) * ROOM
    solved = least(-margin, conditions(fixed, margin))
    P0 = np.asarray(inequalities.alike(value(one, solved, advice), axes))
    gains = [T[:, None] * np.linalg.solve(P0, inequalities.alike(value(y, solved, advice), axes)) for y in Y]
    seconds = first.seconds + solved.seconds
    return gains, P0, [float(np.sqrt(m)) for m in fixed], solved._replace(seconds=seconds)


def rounded(gain: Array, digits: int = 4) -> Array:
    """To so many significant digits: what is shipped is what is proven."""
    return np.array([float(f"{g:.{digits - 1}e}") for g in gain.ravel()]).reshape(gain.shape)
