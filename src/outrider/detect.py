"""Scan -> segments -> rectangles: what is seen, before it is known what it is."""

from __future__ import annotations

import numpy as np

from outrider.compiler import compiled
from outrider.records import Array, Detections, Ints, Kind, Scan
from outrider.rectangle import MOST_HITS, fit_closeness
from outrider.segment import Segments, segment
from outrider.settings import Detect


@compiled
def _describe(
    W_p: Array, beam_t: Array, beams: Ints, start: Ints, stop: Ints, noise: float, out: Array
) -> None:
    """Per segment: x, y, heading, length, width of the closeness rectangle, and mean time of its returns."""
    for i in range(start.shape[0]):
        n = stop[i] - start[i]
        keep = min(n, MOST_HITS)
        p = np.empty((keep, 2))
        t = 0.0
        for k in range(keep):
            j = beams[start[i] + (k * (n - 1)) // max(keep - 1, 1)]
            p[k, 0], p[k, 1] = W_p[j, 0], W_p[j, 1]
            t += beam_t[j]
        if keep == 1:
            out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = p[0, 0], p[0, 1], 0.0, 0.0, 0.0
        elif np.hypot(p[0, 0] - p[-1, 0], p[0, 1] - p[-1, 1]) > 12.0:  # a wall: its chord is enough
            dx, dy = p[-1, 0] - p[0, 0], p[-1, 1] - p[0, 1]
            out[i, 0], out[i, 1] = 0.5 * (p[0, 0] + p[-1, 0]), 0.5 * (p[0, 1] + p[-1, 1])
            out[i, 2], out[i, 3], out[i, 4] = np.arctan2(dy, dx), np.hypot(dx, dy), 0.0
        else:
            out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = fit_closeness(p, noise)
        out[i, 5] = t / keep


def detect(scan: Scan, settings: Detect) -> tuple[Segments, Detections]:
    """Segments of a scan and the closeness rectangle of each, marked by size; empty where nothing returned.

    Scan in the fixed frame W. A segment longer than `max_length_m` or wider than `max_width_m` is LARGE, one
    with fewer than `min_hits` returns or both sides shorter than `min_length_m` is SMALL. Covariance is that
    of the middle of what was seen: the range noise across, a quarter of the seen extent along it.
    """
    segments = segment(scan, settings)
    n = len(segments.start)
    table = np.zeros((n, 6))
    noise = float(np.hypot(settings.range_noise_m, settings.shape_noise_m))
    _describe(scan.W_p, scan.beam_t, segments.beams, segments.start, segments.stop, noise, table)
    hits = segments.stop - segments.start
    extent = table[:, 3:5]
    kind = np.full(n, Kind.VEHICLE, np.uint8)
    kind[(hits < settings.min_hits) | (extent.max(axis=1, initial=0.0) < settings.min_length_m)] = Kind.SMALL
    kind[(extent[:, 0] > settings.max_length_m) | (extent[:, 1] > settings.max_width_m)] = Kind.LARGE
    c, s = np.cos(table[:, 2]), np.sin(table[:, 2])
    along, across = (0.25 * extent[:, 0]) ** 2 + noise**2, (0.25 * extent[:, 1]) ** 2 + noise**2
    cov = np.zeros((n, 3, 3))
    cov[:, 0, 0] = c * c * along + s * s * across
    cov[:, 1, 1] = s * s * along + c * c * across
    cov[:, 0, 1] = cov[:, 1, 0] = c * s * (along - across)
    cov[:, 2, 2] = np.minimum((noise / np.maximum(extent[:, 0], noise)) ** 2 * 4.0, 1.0)
    corner = extent[:, 1] > 4.0 * noise
    detections = Detections(
        t=scan.t,
        hit_t=table[:, 5],
        W_p=table[:, :2],
        heading=table[:, 2],
        extent=extent,
        cov=cov,
        hits=hits,
        sides=np.where(corner, 2, 1),
        kind=kind,
        track=np.full(n, -1, np.int64),
        first=segments.beams[segments.start] if n else segments.start,
        last=segments.beams[segments.stop - 1] if n else segments.stop,
    )
    return segments, detections
