"""Kalman algebra on small matrices: means (1, n), covariances (n, n), all scratch from `kernel.matrix`.

A state keeps its covariance as the lower half, row by row; a row of numbers is unpacked, worked on in place,
and packed again, so it is symmetric by construction. Corrections use Joseph's form, which keeps it positive.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from outrider.kernel import kernel


@kernel
def unpack(row: Any, first: int, P: Any) -> None:
    """Symmetric P (n, n) from the lower half at row[first:]."""
    k = first
    for i in range(P.shape[0]):
        for j in range(i + 1):
            P[i, j] = row[k]
            P[j, i] = row[k]
            k += 1


@kernel
def pack(P: Any, row: Any, first: int) -> None:
    """Lower half of P (n, n) into row[first:]; undoes `unpack`."""
    k = first
    for i in range(P.shape[0]):
        for j in range(i + 1):
            row[k] = P[i, j]
            k += 1


@kernel
def congruence(F: Any, P: Any, scratch: Any) -> None:
    """P <- F P F', all (n, n)."""
    n = P.shape[0]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += F[i, k] * P[k, j]
            scratch[i, j] = total
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += scratch[i, k] * F[j, k]
            P[i, j] = total
            P[j, i] = total


@kernel
def correct_one(x: Any, P: Any, at: int, e: float, r: float) -> None:
    """Kalman correction of x (1, n), P (n, n) by component `at`: innovation e, variance r."""
    n = P.shape[0]
    p, s = P[at, at], P[at, at] + r
    for i in range(n):
        if i != at:
            k = P[i, at] / s
            x[0, i] += k * e
            for j in range(i + 1):
                if j != at:
                    g = P[j, at] / s
                    P[i, j] += (p + r) * k * g - k * P[j, at] - g * P[i, at]
                    P[j, i] = P[i, j]
    x[0, at] += p / s * e
    for i in range(n):
        P[i, at] *= r / s
        P[at, i] = P[i, at]


@kernel
def cholesky(P: Any, L: Any) -> bool:
    """Lower L (n, n) with L L' = P; False, L half done, where P is not positive."""
    for i in range(P.shape[0]):
        for j in range(i + 1):
            total = P[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            elif total > 0.0:
                L[i, i] = sqrt(total)
            else:
                return False
    return True
