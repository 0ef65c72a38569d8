"""What a run comes to in a few numbers: how long at which alert level, how near, and how fast computed."""

from __future__ import annotations

import time
from array import array
from typing import Any

import numpy as np

from outrider.records import Frame, Level, TrackState


class Tally:
    """Counts over the frames of a run; 8 bytes a scan."""

    def __init__(self) -> None:
        self._begun = time.perf_counter()
        self._step_s = array("d")
        self._broken = 0
        self._at = dict.fromkeys(Level, 0.0)
        self._last: tuple[float, Level] | None = None
        self._least: tuple[float, int, float] | None = None  # ttc, track, t

    def add(self, frame: Frame, step_s: float) -> None:
        """One frame, and the time from its scan to its alert [s]."""
        self._step_s.append(step_s)
        if self._last is not None:
            self._at[self._last[1]] += max(0.0, frame.t - self._last[0])
        self._last = (frame.t, frame.alert.level)
        heard = np.isin(frame.tracks.state, (TrackState.CONFIRMED, TrackState.COASTING))
        self._broken += int((frame.tracks.broken & heard).sum())
        ttc = np.where(heard & frame.threats.in_corridor, frame.threats.ttc, np.inf)
        if len(ttc) and ttc.min() < (self._least[0] if self._least else np.inf):
            i = int(ttc.argmin())
            self._least = (float(ttc[i]), int(frame.tracks.id[i]), frame.t)

    def as_dict(self) -> dict[str, Any]:
        """For summary.json; None where there was nothing to measure."""
        ms = 1e3 * np.array(self._step_s)
        wall = time.perf_counter() - self._begun
        least = self._least
        return {
            "duration_s": sum(self._at.values()),
            "seconds_at_level": {level.name.lower(): s for level, s in self._at.items()},
            "least_ttc": None if least is None else dict(zip(("ttc_s", "track_id", "t"), least, strict=True)),
            "broken_bounds": self._broken,
            "speed": {
                "scans_per_s": len(ms) / wall,
                "median_ms": float(np.median(ms)) if len(ms) else None,
                "p95_ms": float(np.percentile(ms, 95.0)) if len(ms) else None,
            },
        }
