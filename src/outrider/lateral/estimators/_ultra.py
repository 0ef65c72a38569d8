"""What both ultra-local estimators share: the observer they stand on, and seven numbers in bins.

The observer is the LQ one, fixed at 10 m/s as in the source, or scheduled over speed: `lq` and `scheduled`.
"""

from __future__ import annotations

from math import copysign
from typing import Any

import numpy as np
import numpy.typing as npt

from outrider.cars import Car
from outrider.errors import InputError
from outrider.kernel import kernel
from outrider.lateral.estimators._linear import correction, phi, riccati, table, tabled
from outrider.models.single_track import Linear, linear

Array = npt.NDArray[np.float64]

SPEED = (5.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, np.inf)  # edges of the bins of |vx| [m/s]
SIDE = (0.0, 1.5, 3.0, 4.5, 6.0, 7.0, 8.0, np.inf)  # of |ay| [m/s2]
BINS = 7
FIXED = 10.0  # speed that the source's observer is made for [m/s]
Q, R = np.diag([1000.0, 10.0]), np.eye(1)  # its weights
FARTHEST, SPUN = 100.0, 20.0  # beyond any car: only keep numbers finite [m/s, rad/s]


def middles(edges: tuple[float, ...]) -> Array:
    """Middles (7,) of the bins; the last is taken as wide as the one before."""
    e = np.array([*edges[:-1], 2.0 * edges[-2] - edges[-3]])
    made: Array = 0.5 * (e[1:] + e[:-1])
    return made


@kernel
def between(x: float, at: Any, values: Any) -> float:
    """Value at x: straight between the points `at` (7,), constant beyond them."""
    value: float = values[BINS - 1]
    for i in range(BINS - 1, 0, -1):
        if x < at[i]:
            w = max((x - at[i - 1]) / (at[i] - at[i - 1]), 0.0)
            value = (1.0 - w) * values[i - 1] + w * values[i]
    return value


def observer(car: Car, scheduled: bool, dt: float) -> tuple[Array, Array]:
    """Gains L of a predictor and K of a filter, (m, 2) each, over the speeds of `_linear.table`."""
    speeds = table()
    F = phi(speeds if scheduled else np.copysign(FIXED, speeds), car, dt)
    K = correction(riccati(F, Q, R), R)
    return np.ascontiguousarray((F @ K)[..., 0]), np.ascontiguousarray(K[..., 0])


@kernel
def gain(rows: Any, vx: float) -> tuple[float, float]:
    """Gains on vy [m/rad] and yaw rate [-] at vx [m/s], of a table as `observer` makes it."""
    i, w = tabled(vx)
    return w * rows[i, 0] + (1.0 - w) * rows[i + 1, 0], w * rows[i, 1] + (1.0 - w) * rows[i + 1, 1]


@kernel
def model(scheduled: bool, vx: float, car: Any) -> Linear:
    """The observer's model at vx [m/s]: of this speed, or of the fixed one that way round."""
    made: Linear = linear(vx if scheduled else copysign(FIXED, vx), car)
    return made


@kernel
def bounded(value: float, most: float) -> float:
    """The value, at most `most` either way."""
    return min(max(value, -most), most)


def one_of(where: str, name: str, value: float, known: tuple[float, ...]) -> None:
    """InputError for a switch that is none of those known."""
    if value not in known:
        raise InputError(f"{where}: {name} = {value:g}; want one of {', '.join(f'{v:g}' for v in known)}")
