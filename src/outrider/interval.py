"""Between which times two bodies touch, when the target may be elsewhere and move otherwise than expected.

A target whose centre is displaced by at most `apart(t)` from where it is expected has a gap to the rider that
differs by at most as much: the distance of two rectangles changes no faster than one of them is moved, and
neither does the depth of their overlap. So no contact comes before the gap is `apart`, and none later than
when the overlap is as deep. What `apart` is: docs/bounds.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from outrider.contact import TICK, Body, Mover, agility, gap_at, rush, safe_time
from outrider.kernel import kernel


class Apart(NamedTuple):
    """Distance of the true centre from the expected one, at most: p + v t + a t^2 / 2."""

    p: float  # [m]
    v: float  # [m/s]
    a: float  # [m/s2]


@kernel
def apart(b: Body, position: float, speed: float) -> Any:
    """What errors of position [m] and velocity [m/s] come to, if the target goes on as it is told.

    That is: its speed changes at the same rate, and not past zero, and its course turns as told. Two that
    brake alike never part faster than at first; two that gather speed part by the angle between them, too.
    """
    gathers = b.speed * b.acceleration > 0.0 or (b.speed == 0.0 and b.acceleration != 0.0)
    chord = 2.0  # of the unit circle, over the largest angle between the two courses
    if speed < abs(b.speed):
        sine = speed / abs(b.speed)
        chord = np.sqrt(2.0 * (1.0 - np.sqrt(1.0 - sine * sine)))
    return Apart(position, speed, abs(b.acceleration) * chord if gathers else 0.0)


@kernel
def earliest(b: Body, r: Mover, horizon: float, e: Apart) -> Any:
    """A time [s] before which no target within `e` of the expected one touches, inf: none in the horizon.

    At most a tick before the first possible touch; a miss by what can be gone in a tick counts as a touch.
    """
    t, most = 0.0, agility(b, r, horizon) + e.a
    while True:
        way = gap_at(b, r, t) - (e.p + (e.v + 0.5 * e.a * t) * t)
        if not way > 0.0:
            return t
        idle = safe_time(rush(b, r, t) + e.v + e.a * t, way, most)
        if idle < TICK:
            return t
        if t >= horizon:
            return np.inf
        t = min(t + idle, horizon)


@kernel
def latest(b: Body, r: Mover, horizon: float, e: Apart) -> Any:
    """A time [s] by which every target within `e` of the expected one touches, inf: not in the horizon."""
    t, before, most = 0.0, 0.0, agility(b, r, horizon)
    deepest = np.hypot(b.half_length, b.half_width) + np.hypot(r.half_length, r.half_width)
    while True:
        swell = e.p + (e.v + 0.5 * e.a * t) * t
        way = gap_at(b, r, t) + swell
        if way <= 0.0:
            break
        if t >= horizon or swell > deepest:
            return np.inf
        before, t = t, min(t + max(safe_time(rush(b, r, t), way, most), TICK), horizon)
    for _ in range(24):
        middle = 0.5 * (before + t)
        if gap_at(b, r, middle) + e.p + (e.v + 0.5 * e.a * middle) * middle <= 0.0:
            t = middle
        else:
            before = middle
    return t
