"""Runs of neighbouring returns that belong to one object: the adaptive breakpoint rule, gaps limited.

Source: Borges and Aldon, Line extraction in 2D range images for mobile robotics, J. Intell. Robot. Syst.
2004, for the breakpoint distance; the limits on angular gap and on the distance itself are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from outrider.geometry import wrap
from outrider.records import Array, Ints, Scan
from outrider.settings import Detect

T = TypeVar("T", Array, Ints)


@dataclass(frozen=True, slots=True)
class Segments:
    """Runs of returns; row i is segment i, in the order the beams are stored."""

    beams: Ints  # (m,) indices of the valid beams, in order, starting at a break so that no segment wraps
    start: Ints  # (n,) first row of the segment in `beams`
    stop: Ints  # (n,) one past its last row


def _breaks(scan: Scan, beams: Ints, settings: Detect) -> Array:
    """Distance [m] to the return before where a segment starts at row i of `beams`, else 0; a ring.

    Where the turn of the lidar begins and ends, two neighbours are a whole turn apart in time: always a
    break.
    """
    increment = abs(float(scan.angle[-1] - scan.angle[0])) / max(len(scan.angle) - 1, 1)
    lam = settings.breakpoint_angle_rad
    before = _turned(beams, -1)
    turn = np.abs(wrap(scan.angle[beams] - scan.angle[before]))
    r = scan.range[beams]
    nearer = np.minimum(r, _turned(r, -1))
    gap = np.hypot(*(scan.W_p[beams] - scan.W_p[before]).T) + 1e-9
    noise = np.hypot(settings.range_noise_m, settings.shape_noise_m)
    steep = np.minimum(turn, 0.9 * lam)
    reach = np.minimum(nearer * np.sin(steep) / np.sin(lam - steep) + 3.0 * noise, settings.max_break_m)
    apart = np.abs(scan.beam_t[beams] - scan.beam_t[before]) > 0.5 * abs(scan.beam_t[-1] - scan.beam_t[0])
    simultaneous = scan.beam_t[-1] == scan.beam_t[0]
    wide = (turn > (settings.max_gap_beams + 1.5) * increment) | (turn > 0.9 * lam)
    return np.where((gap > reach) | wide | (apart & ~simultaneous), gap, 0.0)


def _turned(a: T, first: int) -> T:
    """The ring a (n,) cut so that it begins at index `first` (quicker than `np.roll`)."""
    return np.concatenate((a[first:], a[:first]))


def segment(scan: Scan, settings: Detect) -> Segments:
    """The valid beams of a scan split into segments; an empty or one-beam scan gives at most one segment."""
    beams = np.flatnonzero(scan.valid & (scan.range <= settings.max_range_m))
    if len(beams) < 2:
        ends = np.arange(len(beams), dtype=np.int64)
        return Segments(beams, ends, ends + 1)
    gaps = _breaks(scan, beams, settings)
    first = int(gaps.argmax())  # the widest gap is where the row of beams is cut
    gaps = _turned(gaps, first)
    gaps[0] = 1.0
    beams = _turned(beams, first)
    start = np.flatnonzero(gaps)
    return Segments(beams, start, np.append(start[1:], len(beams)))
