"""The gain itself: least noise under a decay rate and a region of poles, one P for all operating points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from outrider import inequalities
from outrider.design._solve import Problem, Solved
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
    advice = "lower the rate, raise `fastest`, or narrow the region"

    def noise(P: Array, Y: Array, mu: float, slack: float, F: Array, rate: float) -> Array:
        P, Y = inequalities.alike(P, axes), inequalities.alike(Y, axes)
        M = inequalities.estimate(F, H * T, G / T[:, None], C * T, P, Y, mu, rate, weight)
        return np.asarray(M + slack * np.eye(len(M)))

    def disc(P: Array, Y: Array, slack: float, F: Array, fastest: float) -> Array:
        P, Y = inequalities.alike(P, axes), inequalities.alike(Y, axes)
        M = inequalities.slower(F, H * T, P, Y, fastest) / fastest
        return np.asarray(M + slack * np.eye(len(M)))

    def solve(known: Array | None) -> tuple[Array, list[Array], Array, Solved]:
        """P, all Y and all mu: least mu with a little slack, or the largest slack with mu known."""
        problem = Problem()
        one, slack = problem.symmetric(n // axes), problem.number()
        Y = [problem.matrix(n // axes, p // axes) for _ in entries]
        mu = [problem.number() for _ in entries]
        problem.below(lambda P, s: s * np.eye(n // axes) - P, one, slack)
        for i, e in enumerate(entries):
            if known is not None:
                problem.below(lambda m, most: m - most, mu[i], most=known[i])
            for F in e.F:
                problem.below(noise, one, Y[i], mu[i], slack, F=F / T[:, None] * T, rate=e.rate)
                problem.below(disc, one, Y[i], slack, F=F / T[:, None] * T, fastest=e.fastest)
        if known is None:
            problem.below(lambda s: 1e-6 - s, slack)
            solved = problem.minimise(*mu)
        else:
            solved = problem.minimise(slack, sign=-1.0)
        found = [problem.found(u, solved, advice) for u in (one, *Y, *mu)]
        return found[0], found[1 : len(Y) + 1], np.array(found[len(Y) + 1 :]), solved

    *_, mu, first = solve(None)
    fixed = np.maximum(mu, 1e-9) * ROOM
    one, Y, _, solved = solve(fixed)
    P = np.asarray(inequalities.alike(one, axes))
    gains = [T[:, None] * np.linalg.solve(P, inequalities.alike(y, axes)) for y in Y]
    seconds = first.seconds + solved.seconds
    return gains, P, [float(np.sqrt(m)) for m in fixed], solved._replace(seconds=seconds)


def rounded(gain: Array, digits: int = 4) -> Array:
    """To so many significant digits: what is shipped is what is proven."""
    return np.array([float(f"{g:.{digits - 1}e}") for g in gain.ravel()]).reshape(gain.shape)
