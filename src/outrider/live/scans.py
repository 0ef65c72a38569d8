"""Turns of a sensor -> scans: beams on an even grid of angles, as the tracker wants them.

A spinning sensor's beams are evenly spaced but for what was lost on the way: where beams are missing, beams
without return are put in their places, so that neighbours in the row are neighbours in angle.
"""

from __future__ import annotations

import math

import numpy as np

from outrider.geometry import TAU, wrap
from outrider.records import Array, Scan, Turn
from outrider.repair import FORGOTTEN, LOST, SKIPPED, Beams, place
from outrider.settings import Settings

BACKWARD = 0.2  # rad by which a beam may lie before its forerunner: the sensor's own angles are not exact
MOST_SLOTS = 16384  # of a grid


class TurnsToScans:
    """One scan a turn, in the order of time; the sensor stands, its poses are not known."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._t = -math.inf  # of the last scan
        self.skipped = 0

    def scan(self, turn: Turn) -> Scan | None:
        """The turn made ready; None where it ends before the last one did or has no beams.

        After a gap in which every moving track is lost, the scan tells that all before is to be forgotten.
        """
        t = float(turn.beam_t[-1]) if len(turn.beam_t) else turn.received
        if not t > self._t:
            self.skipped += 1
            return None
        faults = [f"{LOST}: {fault}" for fault in turn.faults]
        if self.skipped:
            faults.append(f"{SKIPPED}: out of order, {self.skipped} of them")
            self.skipped = 0
        if t - self._t > self._settings.track.coast_s and math.isfinite(self._t):
            faults.append(f"{FORGOTTEN}: gap of {t - self._t:.1f} s")
        self._t = t
        return place(even(turn, t), None, self._settings, faults)


def even(turn: Turn, t: float) -> Beams:
    """The beams of a turn that ends at t, on an even grid of angles; at most one turn, the last.

    Each beam keeps its own angle and time; of two in one place the nearer return stays. Angles go on past
    pi, so that they are in order.
    """
    begin = float(turn.beam_t[0]) if len(turn.beam_t) else t
    rest = turn.range_min, turn.range_max
    sign, way = _way(turn.angle)
    step = float(np.median(np.diff(way))) if len(way) > 2 else 0.0
    if not step >= TAU / MOST_SLOTS:
        return Beams(begin, t, turn.beam_t, turn.angle, turn.range, turn.quality, *rest)
    row = np.flatnonzero(way > way[-1] - TAU + 0.5 * step)
    slot = np.round((way[row] - way[row].min()) / step).astype(np.int64)
    if not (np.diff(slot) > 0).all():
        order = np.lexsort((np.where(turn.range[row] > 0.0, turn.range[row], np.inf), slot))
        slot, first = np.unique(slot[order], return_index=True)
        row = row[order][first]
    every = np.arange(slot[-1] + 1)
    beam_t = np.interp(every, slot, turn.beam_t[row])
    angle = turn.angle[0] + sign * np.interp(every, slot, way[row])
    ranges, quality = np.zeros((2, len(every)), np.float32)
    ranges[slot], quality[slot] = turn.range[row], turn.quality[row]
    return Beams(begin, t, beam_t, angle, ranges, quality, *rest)


def _way(angle: Array) -> tuple[float, Array]:
    """Which way the sensor turns, 1.0 or -1.0, and how far it has turned at each beam (n,) [rad]."""
    turned = wrap(np.diff(angle))
    sign = -1.0 if len(turned) and np.median(turned) < 0.0 else 1.0
    return sign, np.concatenate([[0.0], np.cumsum((sign * turned + BACKWARD) % TAU - BACKWARD)])
