"""Finds P of the invariant observer's certificate; `python -m benchmarks.certificates.invariant` prints it.

Clarabel is only asked for a candidate on a coarse grid; whether it proves anything is decided by the
certificate, on its own grid, with NumPy. The shipped numbers are this P to six digits.
"""

from __future__ import annotations

import numpy as np

from outrider import inequalities
from outrider.design import Problem
from outrider.observers import _invariant_proof as proof
from outrider.observers.invariant import Gains
from outrider.records import Array

CONDITION = 1e4  # P is asked to lie between I and this many I
SEARCHED = 0.1  # decay that P is asked to prove [1/s]
COARSE = 3, 5, 2  # grid of the search


def search(gains: Gains, decay: float, grid: tuple[int, int, int] = COARSE) -> tuple[Array, float]:
    """P (7, 7) with I <= P, and the least eigenvalue of P - A'P A over the grid, A times exp(decay dt)."""
    family = np.array([A * np.exp(decay * dt) for dt, A in proof.family(gains, grid)])
    P = _solve(family)
    return P, float(np.linalg.eigvalsh(P - family.transpose(0, 2, 1) @ P @ family).min())


def _solve(matrices: Array) -> Array:
    problem = Problem()
    along, across, margin = problem.symmetric(3), problem.symmetric(4), problem.number()

    def whole(along: Array, across: Array) -> Array:
        return np.block([[along, np.zeros((3, 4))], [np.zeros((4, 3)), across]])

    def shrinks(along: Array, across: Array, margin: float, A: Array) -> Array:
        M: Array = inequalities.decay(A, whole(along, across), 1.0, "sampled") + margin * np.eye(7)
        return M

    problem.below(lambda a, b: np.eye(7) - whole(a, b), along, across)
    problem.below(lambda a, b: whole(a, b) - CONDITION * np.eye(7), along, across)
    for A in matrices:
        problem.below(shrinks, along, across, margin, A=A)
    solved = problem.minimise(margin, sign=-1.0)
    return whole(*(problem.found(u, solved, "widen the gains") for u in (along, across)))


def main() -> None:
    """Print the two blocks of P, its least eigenvalue made 1, and how far it is proven."""
    P, least = search(Gains(), SEARCHED)
    P /= np.linalg.eigvalsh(P)[0]
    for block in (P[:3, :3], P[3:, 3:]):
        for i, row in enumerate(block):
            print(", ".join(f"{value:.6g}" for value in row[: i + 1]) + ",")
    print(f"decay {SEARCHED} 1/s: least slack {least:.3g} on the coarse grid")


if __name__ == "__main__":
    main()
