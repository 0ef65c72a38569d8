"""Finds P of the invariant observer's certificate; `python -m benchmarks.certificates.invariant` prints it.

CLARABEL is only asked for a candidate on a coarse grid; whether it proves anything is decided by the
certificate, on its own grid, with NumPy. The shipped numbers are this P to six digits.
"""

from __future__ import annotations

import warnings

import numpy as np

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
    import cvxpy as cp

    along, across = cp.Variable((3, 3), symmetric=True), cp.Variable((4, 4), symmetric=True)
    margin = cp.Variable()
    P = cp.bmat([[along, np.zeros((3, 4))], [np.zeros((4, 3)), across]])
    conditions = [np.eye(7) << P, P << CONDITION * np.eye(7)]
    for A in matrices:
        S = P - A.T @ P @ A
        conditions.append(0.5 * (S + S.T) >> margin * np.eye(7))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of inaccuracy: nothing is believed anyway
        cp.Problem(cp.Maximize(margin), conditions).solve(solver=cp.CLARABEL)
    return np.asarray(P.value)


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
