"""Recorded or simulated scans as a turning lidar sees them: by time, turn by turn, sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from outrider.errors import InputError
from outrider.records import LaserScan
from outrider.rplidar.encode import Sweep, sweep

GAP_S = 0.1  # from one scan to the next where their stamps do not say
JUMP_S = 1.0  # stamps do not say where they are farther apart

Scans = Callable[[], Iterable[LaserScan]]  # begins anew whenever it is called


class Scene:
    """What there is to be seen, over and over again.

    A turn begins at the angle at which the first scan does, so that scans of a lidar which turns clockwise,
    as this one, keep the times of their beams. Of others the time of a beam within its scan is not kept.
    """

    def __init__(self, scans: Scans) -> None:
        """Raises InputError where there is no scan."""
        self._rounds = _rounds(scans)
        self._t, self._scan = next(self._rounds)
        self._ahead_t, self._ahead = next(self._rounds)
        s = self._scan
        first = s.angle_min + (len(s.ranges) - 1) * s.angle_increment * (s.time_increment < 0.0)
        self._begin = (-first / (2.0 * np.pi)) % 1.0

    def turn(self, number: int, t: float, samples: int) -> Sweep:
        """The samples of one turn that begins at t [s], from the scan nearest to t, which never falls."""
        while self._ahead_t - t < t - self._t:
            self._t, self._scan = self._ahead_t, self._ahead
            self._ahead_t, self._ahead = next(self._rounds)
        seen = sweep(self._scan, samples, 0)
        order = round(self._begin * samples) + np.arange(samples)
        angle = (number + order / samples) * 360.0
        return Sweep(angle, seen.range[order % samples], seen.quality[order % samples])


def _rounds(scans: Scans) -> Iterator[tuple[float, LaserScan]]:
    """Scans for ever, each with its time [s]; where stamps jump, the gap before counts once more."""
    t, gap, begun = 0.0, GAP_S, False
    while True:
        before = None
        for scan in scans():
            step = gap if before is None else (scan.stamp_ns - before) * 1e-9
            gap = step if 0.0 < step < JUMP_S else gap
            t, before = t + gap * begun, scan.stamp_ns
            begun = True
            yield t, scan
        if before is None:
            raise InputError("no laser scan to emulate a lidar from; name a recording that has some")
