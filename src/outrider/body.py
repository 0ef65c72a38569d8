"""The size of a body, learnt over its track: only what is bounded is measured, what is not can only grow.

A side is bounded where it ends in a corner (the other side is seen too) or in a free beam (the next beam went
past it). The 75 % quantile of bounding boxes, for comparison, was wrong by a quarter of the length. Ours.
"""

from __future__ import annotations

import numpy as np

from outrider.compiler import compiled
from outrider.geometry import wrap
from outrider.records import Array, Bools, Ints, Scan

# length, width, and how sure [m]: car, two-wheeler, pedestrian or part of something
TEMPLATES = np.array([[4.3, 1.8, 0.5, 0.15], [1.8, 0.65, 0.3, 0.15], [0.7, 0.7, 0.5, 0.4]])

GRAZING = 0.2  # sine of the angle between beam and side below which the gap is not drawn out further
GROWTH = 0.8  # how far beyond its believed outline a body may show itself in one scan [m]


def free_ends(scan: Scan, beams: Ints, rows: Ints, max_turn: float, behind: float) -> tuple[Bools, Array]:
    """Whether the beam next to each end of beams rows[:, 0]..rows[:, 1] went past it, and the gap it left.

    max_turn [rad]: further off a beam is no neighbour; behind [m]: by how much it must have gone past.
    (k, 2) bool, first and last end; (k, 2) width [m] of the gap between the last return and that beam.
    """
    own = beams[rows - [0, 1]] if len(rows) else rows
    beside = beams[(rows - [1, 0]) % len(beams)] if len(rows) else rows
    turn = np.abs(wrap(scan.angle[beside] - scan.angle[own]))
    free = (turn < max_turn) & (scan.range[beside] > scan.range[own] + behind)
    return free, scan.range[own] * turn


@compiled
def measure(
    W_p: Array,
    W_o: Array,
    beams: Ints,
    rows: Ints,
    free: Bools,
    gap: Array,
    pose: Array,
    size: Array,
    noise: float,
) -> tuple[Array, Array]:
    """Seen length and width (k, 2) in the pose's frame, and their standard deviation: inf where not seen.

    Returns more than GROWTH outside the rectangle of `size` (k, 2) belong to something else.
    A negative standard deviation marks a lower bound: the side is seen, but one of its ends is open.
    """
    k = rows.shape[0]
    seen, sigma = np.zeros((k, 2)), np.zeros((k, 2))
    lo, hi, eye, end = np.empty(2), np.empty(2), np.empty(2), np.empty((2, 2))
    for i in range(k):
        c, s = np.cos(pose[i, 2]), np.sin(pose[i, 2])
        n = 0
        for a in range(2):
            sigma[i, a], lo[a], hi[a] = np.inf, 1e300, -1e300
        q = np.empty((rows[i, 1] - rows[i, 0], 2))
        for r in range(rows[i, 0], rows[i, 1]):
            dx, dy = W_p[beams[r], 0] - pose[i, 0], W_p[beams[r], 1] - pose[i, 1]
            q[n, 0], q[n, 1] = c * dx + s * dy, c * dy - s * dx
            if abs(q[n, 0]) > 0.5 * size[i, 0] + GROWTH or abs(q[n, 1]) > 0.5 * size[i, 1] + GROWTH:
                continue
            for a in range(2):
                lo[a], hi[a] = min(lo[a], q[n, a]), max(hi[a], q[n, a])
            n += 1
        if n < 3:
            continue
        for a in range(2):
            end[0, a], end[1, a] = q[0, a], q[n - 1, a]
        j = beams[rows[i, 0]]
        ex, ey = W_o[j, 0] - pose[i, 0], W_o[j, 1] - pose[i, 1]
        eye[0], eye[1] = c * ex + s * ey, c * ey - s * ex
        for a in range(2):  # a = 0: the long side's extent lies along u
            b = 1 - a
            near = hi[b] if eye[b] > 0.0 else lo[b]
            on_side = 0
            for r in range(n):
                if abs(q[r, b] - near) < 3.0 * noise:
                    on_side += 1
            if on_side < 3 or (eye[b] < hi[b] and eye[b] > lo[b]):
                continue
            corner = hi[b] - lo[b] > 6.0 * noise  # the other side is seen, so it ends this one
            bounded, slack = True, 0.0
            for limit in (lo[a], hi[a]):
                facing = (limit - 0.5 * (lo[a] + hi[a])) * eye[a] > 0.0
                if corner and facing and abs(eye[a]) > max(abs(lo[a]), abs(hi[a])):
                    continue
                e = 0 if abs(end[0, a] - limit) < abs(end[1, a] - limit) else 1
                bounded = bounded and free[i, e] and abs(end[e, a] - limit) < 3.0 * noise
                ru, rv = end[e, 0] - eye[0], end[e, 1] - eye[1]
                steep = abs(rv if b == 1 else ru) / np.hypot(ru, rv)  # aslant a beam skips more of the side
                slack += gap[i, e] / max(steep, GRAZING)
            seen[i, a] = hi[a] - lo[a] + (0.5 * slack if bounded else 0.0)
            spread = np.hypot(noise, 0.3 * slack) if bounded else noise
            sigma[i, a] = spread if bounded else -spread
    return seen, sigma


def learn(size: Array, seen: Array, sigma: Array, least: float) -> Array:
    """Sizes (n, 4) [length, width, their standard deviations] after one more look.

    A bounded side is a measurement; an open one only where it is longer than what was believed. `least` [m]:
    floor of the believed standard deviation, so that later looks still count.
    """
    out = size.copy()
    for a in range(2):
        e, s = size[:, a], size[:, 2 + a]
        bounded = (
            np.isfinite(sigma[:, a])
            & (sigma[:, a] > 0.0)
            & (np.abs(seen[:, a] - e) < 4.0 * np.hypot(s, sigma[:, a]))
        )
        grown = np.isfinite(sigma[:, a]) & (sigma[:, a] < 0.0) & (seen[:, a] > e + np.abs(sigma[:, a]))
        used = bounded | grown
        noise2 = np.where(used, 4.0 * sigma[:, a] ** 2, 1.0)
        gain = np.where(used, s**2 / (s**2 + noise2), 0.0)
        out[:, a] = e + gain * (np.where(used, seen[:, a], e) - e)
        out[:, 2 + a] = np.maximum(np.sqrt(1.0 - gain) * s, least)
    return out
