"""Component-wise functions that run as they are and inside compiled loops: tuples, rk4, small matrices.

Numba is not imported here: `compiler` takes the functions that `kernel` has marked when a loop is compiled.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from outrider.geometry import TAU

F = TypeVar("F", bound=Callable[..., Any])

MARKED: list[Callable[..., Any]] = []  # what `compiler` has not taken yet


def kernel(function: F) -> F:
    """A pure component-wise function: runs as it is on numbers and NumPy arrays, and in `compiled` code."""
    MARKED.append(function)
    return function


@kernel
def wrap(angle: Any) -> Any:
    """Angle folded into [-pi, pi) [rad]; geometry.wrap without its slow remainder, for inner loops."""
    return angle - TAU * np.floor(angle / TAU + 0.5)


def axpy(a: Any, b: Any, h: Any) -> Any:
    """a + h b, component by component: a named tuple of the type of `a`."""
    return type(a)(*(p + h * q for p, q in zip(a, b, strict=True)))


def from_row(cls: Any, row: Any) -> Any:
    """Named tuple `cls` of the numbers in a row (len(cls._fields),)."""
    return cls(*(float(value) for value in row))


def to_row(values: Any, row: Any) -> None:
    """Write a named tuple of numbers into a row (len(values),)."""
    for i, value in enumerate(values):
        row[i] = value


@kernel
def rk4(rhs: Any, s: Any, y: Any, dy: Any, c: Any, dt: Any, n: Any) -> Any:
    """State after dt [s] in n equal steps of the classical Runge-Kutta method; error of order (dt / n)^4.

    s' = rhs(s, y(t), c), where the input y(t) = y + t dy runs along a straight line; s, y, dy named tuples.
    """
    h = dt / n
    for i in range(n):
        middle = axpy(y, dy, (i + 0.5) * h)
        k1 = rhs(s, axpy(y, dy, i * h), c)
        k2 = rhs(axpy(s, k1, 0.5 * h), middle, c)
        k3 = rhs(axpy(s, k2, 0.5 * h), middle, c)
        k4 = rhs(axpy(s, k3, h), axpy(y, dy, (i + 1) * h), c)
        s = axpy(axpy(axpy(axpy(s, k1, h / 6.0), k2, h / 3.0), k3, h / 3.0), k4, h / 6.0)
    return s


def matrix(rows: int, columns: int) -> npt.NDArray[np.float64]:
    """Zeros (rows, columns) to compute with; both literal numbers. Never return it from a kernel.

    In compiled code it lies on the stack of the kernel that asks for it, so it costs no allocation.
    """
    return np.zeros((rows, columns))
