"""How the values of the ultra-local model are found: what is tried, and four ways to choose, bin by bin."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.lateral import Array
from outrider.lateral.estimators._ultra import BINS
from outrider.lateral.estimators.ultra_local_published import NONE

Ints = npt.NDArray[np.int64]

SHARES = (0.0, 0.3, 0.6, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998)  # k tried [-]
ALPHAS = (
    *(NONE, 1000.0, 700.0, 500.0, 350.0, 300.0, 250.0, 220.0, 190.0, 170.0, 150.0),
    *(140.0, 130.0, 120.0, 115.0, 110.0, 105.0, 100.0, 95.0, 90.0),
)  # alpha tried [m/s2 per rad]
METHODS = ("grid", "greedy", "curve", "joint")
LEAST_ROWS = 100  # a bin with fewer is left without the ultra-local model
SWEEPS = 4  # of the joint method, at most


class Kind(NamedTuple):
    """What of an estimator is tuned."""

    gain: str  # the name of its seven gains, without the number
    grid: tuple[float, ...]  # values tried, from none of it upwards
    over: tuple[str, ...]  # quantities whose bins it knows

    def strength(self, values: Array | Sequence[float]) -> Array:
        """How strong it is, growing from 0: k itself, or 1 / alpha."""
        v = np.asarray(values, float)
        if self.gain == "k":
            return v
        made: Array = np.where(v < NONE, 1.0 / v, 0.0)
        return made

    def value(self, strength: Array) -> list[float]:
        """Gains of strengths (7,), within those of the grid."""
        within = np.clip(strength, 0.0, self.strength(self.grid).max())
        made = within if self.gain == "k" else 1.0 / np.maximum(within, 1.0 / NONE)
        return [float(v) for v in made]


KINDS = {
    "ultra_local": Kind("k", SHARES, ("ay", "speed")),
    "ultra_local_published": Kind("alpha", ALPHAS, ("speed",)),
}


def search(
    squares: Callable[[Sequence[float]], Array], errors: Array, rows: Ints, at: Array, kind: Kind
) -> dict[str, list[float]]:
    """Method -> values (7,), for bins with middles `at` (7,) that have `rows` (7,).

    squares: values (7,) -> squared errors (7,); errors (m, 7): those of each value of the grid in all bins.
    """
    seen = rows >= LEAST_ROWS
    greedy = [first_rise(errors[:, i]) if seen[i] else 0 for i in range(BINS)]
    least = [int(errors[:, i].argmin()) if seen[i] else 0 for i in range(BINS)]
    found = {"grid": least, "greedy": greedy, "joint": _jointly(squares, least, seen, kind)}
    values = {name: [kind.grid[i] for i in index] for name, index in found.items()}
    curve = kind.value(ramp(at, kind.strength(values["grid"]), rows, at))
    return {name: curve if name == "curve" else values[name] for name in METHODS}


def _jointly(
    squares: Callable[[Sequence[float]], Array], first: list[int], seen: npt.NDArray[np.bool_], kind: Kind
) -> list[int]:
    """Indices (7,) from the first ones on, one bin at a time changed to what lowers the error of all rows."""

    def error(index: list[int]) -> float:
        return float(squares([kind.grid[i] for i in index]).sum())

    best, least = first, error(first)
    for _ in range(SWEEPS):
        before = best
        for i in np.flatnonzero(seen):
            for k in range(len(kind.grid)):
                tried = [*best[:i], k, *best[i + 1 :]]
                if tried != best and (e := error(tried)) < least:
                    best, least = tried, e
        if best == before:
            break
    return best


def first_rise(errors: Array) -> int:
    """Index of the last of errors (m,) before they first stop falling."""
    rising = np.flatnonzero(np.diff(errors) >= 0.0)
    return int(rising[0]) if len(rising) else len(errors) - 1


def ramp(at: Array, strength: Array, rows: Ints, x: Array) -> Array:
    """The line nearest to strengths (7,) that is level, rises or falls, and is level again; its value at x.

    Its corners are middles of bins; bins with too few rows do not count, others by their rows.
    """
    seen = rows >= LEAST_ROWS
    places, weight, goal = at[seen], np.sqrt(rows[seen]), strength[seen]
    least, best = np.inf, np.full(len(x), goal.mean())
    for i in range(len(places) - 1):
        for j in range(i + 1, len(places)):
            corners = places[[i, j]]
            terms = np.vander(np.interp(places, corners, (0.0, 1.0)), 2)
            fit = np.linalg.lstsq(terms * weight[:, None], goal * weight, rcond=None)[0]
            error = float(np.sum((weight * (terms @ fit - goal)) ** 2))
            if error < least:
                least, best = error, np.polyval(fit, np.interp(x, corners, (0.0, 1.0)))
    return best
