"""Runs of neighbouring returns that belong to one object: the adaptive breakpoint rule with a limit on the gap.

Source: Borges and Aldon, Line extraction in 2D range images for mobile robotics, J. Intell. Robot. Syst. 2004,
for the breakpoint distance; the limits on angular gap and on the distance itself are ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from outrider.kernel import compiled
from outrider.records import Array, Ints, Scan
from outrider.settings import Detect


@dataclass(frozen=True, slots=True)
class Segments:
    """Runs of returns; row i is segment i, in the order the beams are stored."""

    beams: Ints  # (m,) indices of the valid beams, in order, starting at a break so that no segment wraps
    start: Ints  # (n,) first row of the segment in `beams`
    stop: Ints  # (n,) one past its last row


@compiled
def _breaks(W_p: Array, W_o: Array, angle: Array, beam_t: Array, beams: Ints, limits: Array) -> Array:
    """Distance [m] to the return before where a segment starts at row i of `beams`, else 0; row 0 follows the last.

    Where the turn of the lidar begins and ends, two neighbours are a whole turn apart in time: always a break.
    """
    noise, lam, max_gap, max_break, increment = limits
    m = beams.shape[0]
    out = np.zeros(m)
    turn_s = abs(beam_t[-1] - beam_t[0])
    for i in range(m):
        a, b = beams[i - 1], beams[i]
        turn = abs((angle[b] - angle[a] + np.pi) % (2.0 * np.pi) - np.pi)
        ra = np.hypot(W_p[a, 0] - W_o[a, 0], W_p[a, 1] - W_o[a, 1])
        rb = np.hypot(W_p[b, 0] - W_o[b, 0], W_p[b, 1] - W_o[b, 1])
        gap = np.hypot(W_p[b, 0] - W_p[a, 0], W_p[b, 1] - W_p[a, 1]) + 1e-9
        if (
            abs(beam_t[b] - beam_t[a]) > 0.5 * turn_s > 0.0
            or turn > (max_gap + 1.5) * increment
            or turn > 0.9 * lam
        ):
            out[i] = gap
            continue
        reach = min(ra, rb) * np.sin(turn) / np.sin(lam - turn) + 3.0 * noise
        if gap > min(reach, max_break):
            out[i] = gap
    return out


def segment(scan: Scan, settings: Detect) -> Segments:
    """The valid beams of a scan split into segments; an empty or one-beam scan gives at most one segment."""
    beams = np.flatnonzero(scan.valid & (scan.range <= settings.max_range_m))
    if len(beams) < 2:
        ends = np.arange(len(beams), dtype=np.int64)
        return Segments(beams, ends, ends + 1)
    increment = abs(float(scan.angle[-1] - scan.angle[0])) / max(len(scan.angle) - 1, 1)
    limits = np.array(
        [
            np.hypot(settings.range_noise_m, settings.shape_noise_m),
            settings.breakpoint_angle_rad,
            settings.max_gap_beams,
            settings.max_break_m,
            increment,
        ]
    )
    gaps = _breaks(scan.W_p, scan.W_sensor, scan.angle, scan.beam_t, beams, limits)
    first = int(gaps.argmax())  # the widest gap is where the row of beams is cut
    gaps = np.roll(gaps, -first)
    gaps[0] = 1.0
    beams = np.roll(beams, -first)
    start = np.flatnonzero(gaps)
    return Segments(beams, start, np.append(start[1:], len(beams)))
