"""How fast measured ranges change, from the past alone: a parabola, a line or a difference.

    rho(t_k + tau) ~ a + b tau + c tau^2   least squares over the last `window` seconds;   rate b

The slope at the end of a parabola hardly lags, but has some four times the noise of a line; that of a line is
the slope at the middle of the window, half a window ago. Sample by sample (`advance`) and for a whole log
(`of_log`) the same figures come out. Ranges may be (2,) or (n, 2): n robots seen at the same times.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.errors import InputError

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

WINDOW = 0.3  # [s]; 0.5 where the ranges are worse than some 3 cm
LEAST = {"parabola": 3, "line": 2, "difference": 2}  # readings that a slope takes
SAME = 1e-9  # two angles of a sensor that differ by less are one [rad]


class Memory(NamedTuple):
    """What is kept from sample to sample; None before the first."""

    t: Array  # (k,) times within the window [s]
    ranges: Array  # (k, ..., 2) [m]; NaN: no return, or before the sensor was turned
    since: Array  # (..., 2) time of the first reading of the unbroken stretch [s]
    last: Array  # (..., 2) time of the newest reading [s]; -inf: none
    angles: Array  # (2,) of the sensors [rad]


def advance(
    memory: Memory | None,
    t: float,
    ranges: Array,
    angles: Array,
    method: str = "parabola",
    window: float = WINDOW,
) -> tuple[Array, Memory]:
    """Rates (..., 2) [m/s] at time t [s] and the memory with it, from ranges (..., 2) [m], angles (2,) [rad].

    NaN: no reading now; fewer than three in the window (line: two); or the stretch without a gap, since the
    start or since the sensor was turned, is shorter than the window. A gap is half a window without a
    reading. A difference only needs the reading before, at most a window old. A time that does not increase
    gives NaN and is forgotten. InputError for an unknown method or a window that is not positive.
    """
    if method not in LEAST:
        raise InputError(f"range rate {method!r} is not known; want one of {', '.join(LEAST)}")
    if not (np.isfinite(window) and window > 0.0):
        raise InputError(f"window of the range rate = {window} s; want a positive number")
    ranges, angles = np.asarray(ranges, float), np.asarray(angles, float)
    if memory is None:
        none = np.full(ranges.shape, -np.inf)
        memory = Memory(np.empty(0), np.empty((0, *ranges.shape)), none, none, angles)
    if not np.isfinite(t) or (len(memory.t) and t <= memory.t[-1]):
        return np.full(ranges.shape, np.nan), memory
    memory = _with(memory, t, ranges, angles, window if method == "difference" else 0.5 * window, window)
    seen = np.isfinite(memory.ranges)
    full = seen[-1] & (seen.sum(axis=0) >= LEAST[method])
    if method == "difference":
        return _difference(memory, seen, full), memory
    full &= t - memory.since >= window * (1.0 - 1e-6)
    return _slope(memory, seen, full, window, method == "line"), memory


def of_log(
    t: Array,
    ranges: Array,
    angles: Array | None = None,
    method: str = "parabola",
    window: float = WINDOW,
) -> Array:
    """Rates (k, ..., 2) [m/s] for times t (k,) [s], ranges (k, ..., 2) [m]; angles (2,) or (k, 2) [rad]."""
    ranges = np.asarray(ranges, float)
    turned = np.broadcast_to(np.zeros(2) if angles is None else angles, (len(ranges), 2))
    memory, rates = None, np.empty_like(ranges)
    for k, now in enumerate(np.asarray(t, float)):
        rates[k], memory = advance(memory, float(now), ranges[k], turned[k], method, window)
    return rates


def _with(memory: Memory, t: float, ranges: Array, angles: Array, longest: float, window: float) -> Memory:
    """Memory with one more sample; what is older than the window, or before a gap or a turn, is dropped."""
    seen = np.isfinite(ranges)
    anew = np.abs(angles - memory.angles) > SAME
    broken = anew | (seen & (t - memory.last > longest * (1.0 + 1e-6)))
    keep = memory.t >= t - window * (1.0 + 1e-6)
    old = np.where(broken, np.nan, memory.ranges[keep])
    last = np.where(anew, -np.inf, memory.last)
    return Memory(
        np.append(memory.t[keep], t),
        np.concatenate([old, np.where(seen, ranges, np.nan)[None]]),
        np.where(broken & seen, t, np.where(anew, np.inf, memory.since)),
        np.where(seen, t, last),
        angles,
    )


def _difference(memory: Memory, seen: Bools, full: Bools) -> Array:
    """Difference to the reading before, over the time between."""
    before = len(seen) - 2 - np.argmax(seen[-2::-1], axis=0) if len(seen) > 1 else np.zeros(full.shape, int)
    rise = memory.ranges[-1] - np.take_along_axis(memory.ranges, before[None], axis=0)[0]
    run = memory.t[-1] - memory.t[before]
    return np.asarray(np.divide(rise, run, out=np.full(full.shape, np.nan), where=full))


def _slope(memory: Memory, seen: Bools, full: Bools, window: float, straight: bool) -> Array:
    """End-point slope of the least-squares parabola or line, by its normal equations in tau / window."""
    tau = (memory.t - memory.t[-1]) / window
    powers = tau ** np.arange(5)[:, None]
    rho = np.where(seen, memory.ranges - np.where(full, memory.ranges[-1], 0.0), 0.0)
    s0, s1, s2, s3, s4 = np.tensordot(powers, seen.astype(float), axes=1)
    y0, y1, y2 = np.tensordot(powers[:3], rho, axes=1)
    if straight:
        top, below = s0 * y1 - s1 * y0, s0 * s2 - s1 * s1
    else:
        top = s0 * (y1 * s4 - y2 * s3) - y0 * (s1 * s4 - s2 * s3) + s2 * (s1 * y2 - s2 * y1)
        below = s0 * (s2 * s4 - s3 * s3) - s1 * (s1 * s4 - s2 * s3) + s2 * (s1 * s3 - s2 * s2)
    spread = full & (below > 1e-6)
    return np.asarray(np.divide(top, below * window, out=np.full(full.shape, np.nan), where=spread))
