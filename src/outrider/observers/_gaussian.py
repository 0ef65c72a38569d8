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
    p, q = P[at, at], 1.0 / (P[at, at] + r)
    for i in range(n):
        if i != at:
            k = P[i, at] * q
            x[0, i] += k * e
            for j in range(i + 1):
                if j != at:
                    g = P[j, at] * q
                    P[i, j] += (p + r) * k * g - k * P[j, at] - g * P[i, at]
                    P[j, i] = P[i, j]
    x[0, at] += p * q * e
    for i in range(n):
        P[i, at] *= r * q
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


@kernel
def correct_two(x: Any, P: Any, G: Any, e: tuple[float, float], S: tuple[float, float, float]) -> None:
    """Kalman correction of x (1, n), P (n, n) by two outputs at once: x + G S^-1 e, P - G S^-1 G'.

    G (n, 2): covariance of the state and the outputs, used up. e: their innovations. S: the covariance of
    these, (xx, xy, yy), positive. With S = L L' what is taken away is (G L^-T)(G L^-T)'.
    """
    l = 1.0 / sqrt(S[0])
    m = S[1] * l
    k = 1.0 / sqrt(S[2] - m * m)
    a = e[0] * l
    b = (e[1] - m * a) * k
    for i in range(x.shape[1]):
        G[i, 0] *= l
        G[i, 1] = (G[i, 1] - m * G[i, 0]) * k
        x[0, i] += G[i, 0] * a + G[i, 1] * b
        for j in range(i + 1):
            P[i, j] -= G[i, 0] * G[j, 0] + G[i, 1] * G[j, 1]
            P[j, i] = P[i, j]


@kernel
def limit(P: Any, at: int, most: float) -> None:
    """Variance `at` of P (n, n) at most `most`, correlations as they are."""
    if P[at, at] > most:
        shrink = sqrt(most / P[at, at])
        for i in range(P.shape[0]):
            P[i, at] *= shrink
            P[at, i] *= shrink


@kernel
def product(P: Any, F: Any, G: Any) -> None:
    """G <- P F', all (n, n): covariance of a state and of what it becomes."""
    n = P.shape[0]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += P[i, k] * F[j, k]
            G[i, j] = total


@kernel
def look_back(x: Any, P: Any, G: Any, e: Any, D: Any, L: Any) -> None:
    """One step back of Rauch, Tung and Striebel: x + K e, P + K D K' with K = G (L L')^-1, in place.

    x (1, n), P (n, n): filtered. G (n, n): covariance of this state and the next one. L: Cholesky factor of
    the next one's predicted covariance. e (1, n), D (n, n): mean and covariance of the next one, smoothed
    minus predicted. G, D and L are used up.
    """
    n = P.shape[0]
    for i in range(n):  # each row of G becomes one of K: L z = g, L' k = z
        for j in range(n):
            for k in range(j):
                G[i, j] -= L[j, k] * G[i, k]
            G[i, j] /= L[j, j]
        for j in range(n - 1, -1, -1):
            for k in range(j + 1, n):
                G[i, j] -= L[k, j] * G[i, k]
            G[i, j] /= L[j, j]
        for j in range(n):
            x[0, i] += G[i, j] * e[0, j]
    congruence(G, D, L)
    for i in range(n):
        for j in range(n):
            P[i, j] += D[i, j]
