"""The papers' own inequalities, put right and given the limits they lack (E5, E6, E7), as designs.

[MS 58] for the orientation at one speed; [HG 76] to [HG 78] for the high-gain observer by theta.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider import family, inequalities
from outrider.certificate import relative
from outrider.design._solve import Design, Problem, Solved
from outrider.design.stages import certify_schedule
from outrider.design.synthesis import ADVICE, ROOM, rounded
from outrider.errors import InputError, NotCertified
from outrider.family import Point

Array = npt.NDArray[np.float64]


def orientation(
    speed: float = 10.0,
    l_r: float = 2.0,
    *,
    tight: bool = True,
    rate: float = 0.1,
    fastest: float = 5.0,
) -> Design:
    """Gain (2,) [1/s] of yaw and slip at one speed [m/s] by [MS 58], its signs put right.

    tight: with the sector condition alone, cos(20 deg) b^2 <= f b <= b^2; else both conditions as printed.
    Decay at `rate`, no pole further from 0 than `fastest` [1/s]. `noise` is the root of the least mu found.
    InputError for a speed that is not positive, NotCertified where there is no solution.
    """
    if not 0.0 < speed < np.inf or not 0.0 < l_r < np.inf:
        raise InputError(f"speed {speed:g} m/s, rear axle {l_r:g} m; want positive numbers")
    if not 0.0 <= rate < fastest:
        raise InputError(f"rate {rate:g}, fastest {fastest:g}; want 0 <= rate < fastest [1/s]")
    F, H = family.orientation(speed, speed, l_r), np.ones((1, 2))

    def condition(P: Array, Y: Array, m: Array, mu: float, slack: float) -> Array:
        M = inequalities.orientation(P, Y, m[:, 0], mu, speed, l_r, tight, rate)
        return np.asarray(M + slack * np.eye(len(M)))

    def disc(P: Array, Y: Array, slack: float, F: Array) -> Array:
        M = inequalities.slower(F, H, P, Y, fastest) / fastest
        return np.asarray(M + slack * np.eye(len(M)))

    def solve(known: float | None) -> tuple[Any, ...]:
        problem = Problem()
        P, Y, m = problem.symmetric(2), problem.matrix(2, 1), problem.matrix(2, 1)
        mu, slack = problem.number(), problem.number()
        problem.below(lambda P, s: s * np.eye(2) - P, P, slack)
        problem.below(lambda m: -np.diag(m[:, 0]), m)
        problem.below(condition, P, Y, m, mu, slack)
        for corner in F:
            problem.below(disc, P, Y, slack, F=corner)
        if known is None:
            problem.below(lambda s: 1e-6 - s, slack)
            solved = problem.minimise(mu)
        else:
            problem.below(lambda mu: mu - known, mu)
            solved = problem.minimise(slack, sign=-1.0)
        return *(problem.found(u, solved, ADVICE) for u in (P, Y, mu)), solved

    *_, mu, first = solve(None)
    P, Y, mu, said = solve(ROOM * mu)
    L = rounded(np.linalg.solve(P, Y))[:, 0]
    points = [Point(f"{speed:g} m/s", speed, float(L[0]), float(L[1]))]
    certificate = certify_schedule(points, rate, l_r)
    return Design(L, certificate, said._replace(seconds=first.seconds + said.seconds), float(np.sqrt(mu)))


class Theta(NamedTuple):
    """A high gain by [HG 76] to [HG 78]."""

    K: Array  # (3,) for theta = 1
    P: Array  # (3, 3) of each axis
    least: float  # theta_0 of [HG 77]
    theta: float  # in use
    gain: Array  # (3,) T(theta) K [1/s, 1/s2, 1/s3]
    margin: float  # of [HG 76], checked with NumPy, relative
    solved: Solved


def by_theta(
    lipschitz: float = 1.25,
    theta: float | None = None,
    *,
    slack: float = 10.0,
    largest: float = 30.0,
    gain_bound: float = 25.0,
) -> Theta:
    """High gain for a Lipschitz constant k_f of the model, [HG 76-78]: least lambda_max(P), P < `largest` I.

    theta: None takes 1.01 times the least that [HG 77] allows. gain_bound: norm of K, without which a solver
    returns gains beyond 1e4 (E7). slack: lambda. What the Lipschitz constant holds for is not said here:
    prove the gain over a region with `high_gain(gain=...)`. NotCertified where there is none, or theta is
    too small.
    """
    if not (lipschitz > 0.0 and slack > 0.0 and gain_bound > 0.0):
        raise InputError(f"k_f {lipschitz:g}, slack {slack:g}, bound {gain_bound:g}; want positive numbers")
    problem, one = Problem(), np.eye(3)
    P, Y, most = problem.symmetric(3), problem.matrix(3, 1), problem.number()
    problem.below(lambda P, Y: inequalities.high_gain(P, Y, 1.001 * slack), P, Y)
    problem.below(lambda P, most: P - most * one, P, most)
    problem.below(lambda most: most - largest, most)
    problem.below(lambda P: one - P, P)
    problem.below(lambda P, Y: inequalities.gain_within(P, Y, gain_bound**2), P, Y)
    solved = problem.minimise(most)
    advice = "raise `largest` or the bound on the gain, or lower the slack"
    if not solved.optimal:
        raise NotCertified(f"[HG 76]: the solver said {solved.status!r}: {advice}")
    P0, Y0 = (problem.found(u, solved, advice) for u in (P, Y))
    K = rounded(np.linalg.solve(P0, Y0))
    size = float(np.linalg.norm(P0 @ inequalities.chain(3), 2) + np.linalg.norm(P0 @ K, 2) + slack)
    margin = relative(inequalities.high_gain(P0, P0 @ K, slack), size)
    least = 2.0 * lipschitz * float(np.linalg.eigvalsh(P0)[-1]) / slack
    theta = 1.01 * least if theta is None else theta
    if not (margin > 0.0 and theta > max(least, 1.0)):
        raise NotCertified(
            f"[HG 76-77]: checked margin {margin:.1e}, theta {theta:g}, want more than {max(least, 1.0):.4g}"
        )
    gain = rounded(K[:, 0] * theta ** np.arange(1, 4))
    return Theta(K[:, 0], P0, least, theta, gain, margin, solved)
