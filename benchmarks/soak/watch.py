"""What a soak is judged by: memory, and how soon after each fault all is well again."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from outrider.live import Shot, Silent

WITHIN_S = 2.0  # of good data: after that a fault is recovered from
GROWTH = 0.05  # share by which memory may differ from what it was after the first ten minutes


def resident_mb() -> float:
    """Memory of this process that is in RAM [MB]; Linux."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


class Watch(Silent):
    """A sink that notes when all is well, and what the tracker makes of it."""

    def __init__(self) -> None:
        super().__init__()
        self.scans = 0
        self.well = -1.0  # time of the last scan that can be trusted and lacks nothing [s]
        self._last = -1.0  # of the last scan [s]
        self._level = 0
        self.counts = dict.fromkeys(("backward", "degraded", "incomplete", "alerts raised", "most tracks"), 0)

    def shot(self, shot: Shot) -> None:
        """One scan came through."""
        frame, counts = shot.frame, self.counts
        incomplete = shot.turn is not None and len(shot.turn.faults) > 0
        self.scans += 1
        counts["backward"] += not frame.t > self._last
        counts["degraded"] += bool(shot.health.degraded)
        counts["incomplete"] += incomplete
        counts["alerts raised"] += frame.alert.level > self._level
        counts["most tracks"] = max(counts["most tracks"], len(frame.tracks.id))
        self._last, self._level = frame.t, frame.alert.level
        if not incomplete and not shot.health.degraded:
            self.well = frame.t

    def as_dict(self) -> dict[str, int]:
        """For the figures."""
        return dict(self.counts)


class Recoveries:
    """By kind of fault: how often, and how long until all was well [s of good data]."""

    def __init__(self) -> None:
        self._kinds: dict[str, list[float]] = {}  # times, mean, worst
        self._missed: dict[str, int] = {}

    def add(self, kind: str, seconds: float | None) -> None:
        """One fault; None where all was never well."""
        times, mean, worst = self._kinds.get(kind, (0, 0.0, 0.0))
        if seconds is None or seconds > WITHIN_S:
            self._missed[kind] = self._missed.get(kind, 0) + 1
        if seconds is not None:
            times, mean, worst = times + 1, mean + (seconds - mean) / (times + 1), max(worst, seconds)
        self._kinds[kind] = [times, mean, worst]

    def as_dict(self) -> dict[str, Any]:
        """For the figures."""
        rows = {
            kind: {"times": int(n), "mean_s": round(mean, 3), "worst_s": round(worst, 3)}
            for kind, (n, mean, worst) in self._kinds.items()
        }
        return {"within_s": WITHIN_S, "missed": self._missed, "after": rows}


class Memory:
    """Resident memory, looked at every `every` scans; the first look is what the others are compared with."""

    def __init__(self, every: int) -> None:
        self._every = self._next = every
        self.mb: list[float] = []

    def look(self, scans: int) -> bool:
        """Whether it was time for one more look."""
        if scans < self._next:
            return False
        self._next += self._every
        self.mb.append(resident_mb())
        return True

    def as_dict(self) -> dict[str, Any]:
        """For the figures; `growth` is the largest difference from the first look, as a share of it."""
        first, *after = self.mb or [resident_mb()]
        growth = max((mb / first - 1.0 for mb in after), key=abs, default=0.0)
        last = self.mb[-1] if self.mb else first
        return {
            "first_mb": round(first, 1),
            "last_mb": round(last, 1),
            "growth": round(growth, 4),
            "looks": len(self.mb),
        }
