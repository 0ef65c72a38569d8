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
ADVICE = "lower the rate, raise `fastest` or the bound on the gain, or narrow the region"
ROOM = 1.05  # the noise gain may grow by this for the sake of the margin [-]


class Entry(NamedTuple):
    """One operating point with a gain of its own."""

    F: Array  # (m, n, n) corners of the model's Jacobian
    rate: float  # errors decay at least as exp(-rate t) [1/s]
    fastest: float  # no pole further from 0 than this [1/s]


class Weights(NamedTuple):
    """What is weighed: errors C x of x' = F x + G v with y = H x + d, against d and sqrt(weight) v."""

    H: Array  # (p, n)
    C: Array  # (q, n)
    G: Array  # (n, k), no columns where nothing drives the model
    weight: float = 1.0


def synthesise(
    entries: Sequence[Entry],
    weights: Weights,
    *,
    axes: int = 1,
    scale: Array | None = None,
    gain_bound: float | None = None,
) -> tuple[list[Array], Array, list[float], Solved]:
    """Gains (n, p) of all entries, their common P (n, n), proven noise gains, and the solver's word.

    For each corner F of an entry, errors with the gain on y decay at its rate, no pole is faster than its
    limit, and the energy of C x is at most mu times that of (d, sqrt(weight) v). First the sum of all mu is
    made small; then mu may grow by 5 %, and the margin is made large. The gains of the entries may be
    switched at will, since P is common.

    axes: the state and output consist of that many alike parts, treated alike (P = I (x) P1).
    scale: size (n,) of the states beside each other. gain_bound: no gain has a larger spectral norm.
    InputError for a region of poles that is empty, NotCertified where there is no solution.
    """
    n = weights.H.shape[1]
    T = np.ones(n) if scale is None else np.asarray(scale, float)
    H, C, G = weights.H * T, weights.C * T, weights.G / T[:, None]
    for e in entries:
        if not 0.0 <= e.rate < e.fastest:
            raise InputError(f"rate {e.rate:g}, fastest {e.fastest:g}; want 0 <= rate < fastest [1/s]")
    if gain_bound is not None and not 0.0 < gain_bound < np.inf:
        raise InputError(f"bound {gain_bound:g} on the gain; want a positive number")

    def noise(P: Array, Y: Array, mu: float, slack: float, F: Array, rate: float) -> Array:
        M = inequalities.estimate(F, H, G, C, P, Y, mu, rate, weights.weight)
        return np.asarray(M + slack * np.eye(len(M)))

    def disc(P: Array, Y: Array, slack: float, F: Array, fastest: float) -> Array:
        M = inequalities.slower(F, H, P, Y, fastest) / fastest
        return np.asarray(M + slack * np.eye(len(M)))

    def within(P: Array, Y: Array, least: float, G: float) -> Array:
        return np.asarray(inequalities.gain_within(P, Y, least * G**2))

    def solve(known: Array | None) -> tuple[Array, list[Array], Array, Solved]:
        """P, all Y and all mu: least mu with a little slack, or the largest slack with mu known."""
        problem = Problem()
        P, slack = problem.symmetric(n, alike_blocks(n, axes)), problem.number()
        Y = [problem.matrix(n, H.shape[0], axes) for _ in entries]
        mu = [problem.number() for _ in entries]
        problem.below(lambda P, s: s * np.eye(n) - P, P, slack)
        if gain_bound is not None:
            least = problem.number()
            problem.below(lambda P, least: least * np.diag(T**2) - P, P, least)
        for i, e in enumerate(entries):
            if known is not None:
                problem.below(lambda m, most: m - most, mu[i], most=known[i])
            if gain_bound is not None:
                problem.below(within, P, Y[i], least, G=gain_bound)
            for F in e.F:
                problem.below(noise, P, Y[i], mu[i], slack, F=F / T[:, None] * T, rate=e.rate)
                problem.below(disc, P, Y[i], slack, F=F / T[:, None] * T, fastest=e.fastest)
        if known is None:
            problem.below(lambda s: 1e-6 - s, slack)
            solved = problem.minimise(*mu)
        else:
            solved = problem.minimise(slack, sign=-1.0)
        found = [problem.found(u, solved, ADVICE) for u in (P, *Y, *mu)]
        return found[0], found[1 : len(Y) + 1], np.array(found[len(Y) + 1 :]), solved

    *_, mu, first = solve(None)
    fixed = np.maximum(mu, 1e-9) * ROOM
    P, Y, _, solved = solve(fixed)
    gains = [T[:, None] * np.linalg.solve(P, y) for y in Y]
    seconds = first.seconds + solved.seconds
    return gains, P, [float(np.sqrt(m)) for m in fixed], solved._replace(seconds=seconds)


def alike_blocks(n: int, axes: int) -> list[list[range]]:
    """Blocks of a P (n, n) that is the same on each of so many axes."""
    return [[range(i * n // axes, (i + 1) * n // axes) for i in range(axes)]]


def rounded(gain: Array, digits: int = 4) -> Array:
    """To so many significant digits: what is shipped is what is proven."""
    return np.array([float(f"{g:.{digits - 1}e}") for g in gain.ravel()]).reshape(gain.shape)
