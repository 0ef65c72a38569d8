"""Which segment belongs to which track: fit the track's rectangle to each near one, then assign globally.

The pose of the rectangle that fits best is the measurement, its distance to the prediction the price. So a
neighbour's returns are dear even where they are near, and the point that is tracked does not hop when another
side comes into view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from outrider import predictor
from outrider.compiler import compiled
from outrider.geometry import rotate
from outrider.kernel import kernel
from outrider.records import Array, Bools, Detections, Ints, Kind, Scan
from outrider.rectangle import MOST_HITS, copy, fit_sized, solve3
from outrider.segment import Segments
from outrider.settings import Settings

MOST_BESIDE = 24  # returns on each side of a segment that are asked whether they passed through the body
CAUCHY = 2.0  # returns further than this many sigmas from the outline count ever less
FREE_WEIGHT = 1.0  # of a beam that passed through the body, against one return off the outline
SILENT_WEIGHT = (
    0.05  # of a beam beside the body that found nothing at all: it may have passed, or was swallowed
)
FOR_EVER = 1e3  # range of such a beam [m]
HEADING_PRIOR = (
    0.2,
    0.3,
)  # least and largest standard deviation of the prediction's pull on the heading [rad]
TURNS = (0.0, 0.35, -0.35, 0.5 * np.pi)  # headings a fit starts from, relative to the prediction [rad]
STILL = (0.0, 0.0, 0.0, 0.5 * np.pi)  # the same for a body that stands: 0 is tried once
GOOD_FIT = 0.3  # mean cost a return below which the first start is enough
DOUBTFUL_FIT = 0.5  # mean cost a return above which the last of them is tried
WORST_FIT = 4.0  # mean cost a return above which a segment does not look like the track's body
FORBIDDEN = 1e6
MOST_STRANGE = 3  # segments of something else between two of the same body


@kernel
def _gather(
    W_p: Array,
    W_o: Array,
    angle: Array,
    valid: Bools,
    beam_t: Array,
    beams: Ints,
    a: int,
    b: int,
    at: float,
    vx: float,
    vy: float,
    box: Array,
    margin: float,
) -> tuple[Array, Array, Array, Array, Array]:
    """Returns of rows a..b of `beams` moved to time `at` with velocity (vx, vy); and the beams beside them.

    Of the returns, those in `box` (x, y, heading, length, width) grown by `margin` + 1 m.

    A beam beside them that has no return is taken to have gone on for ever, at the weight SILENT_WEIGHT.
    """
    n = b - a
    keep = min(n, MOST_HITS)
    p, o = np.empty((keep, 2)), np.empty((keep, 2))
    x, y, c, s = box[0], box[1], np.cos(box[2]), np.sin(box[2])
    kept = 0
    for k in range(keep):
        j = beams[a + (k * (n - 1)) // max(keep - 1, 1)]
        p[kept, 0] = W_p[j, 0] - vx * (beam_t[j] - at)
        p[kept, 1] = W_p[j, 1] - vy * (beam_t[j] - at)
        o[kept, 0] = W_o[j, 0] - vx * (beam_t[j] - at)
        o[kept, 1] = W_o[j, 1] - vy * (beam_t[j] - at)
        u = abs(c * (p[kept, 0] - x) + s * (p[kept, 1] - y))
        v = abs(c * (p[kept, 1] - y) - s * (p[kept, 0] - x))
        kept += u < 0.5 * box[3] + margin + 1.0 and v < 0.5 * box[4] + margin + 1.0
    reach = 0.5 * np.hypot(box[3], box[4]) + margin
    m = angle.shape[0]
    far, far_o = np.empty((2 * MOST_BESIDE, 2)), np.empty((2 * MOST_BESIDE, 2))
    weight = np.empty(2 * MOST_BESIDE)
    found = 0
    for side in (-1, 1):
        j = beams[a] if side < 0 else beams[b - 1]
        for _ in range(min(MOST_BESIDE, (m - n) // 2)):
            j = (j + side) % m
            yaw = W_o[j, 2] + angle[j]
            dx, dy = np.cos(yaw), np.sin(yaw)
            ox, oy = W_o[j, 0] - vx * (beam_t[j] - at), W_o[j, 1] - vy * (beam_t[j] - at)
            if abs(dx * (y - oy) - dy * (x - ox)) > reach or dx * (x - ox) + dy * (y - oy) <= 0.0:
                break
            r = np.hypot(W_p[j, 0] - W_o[j, 0], W_p[j, 1] - W_o[j, 1]) if valid[j] else FOR_EVER
            far[found, 0], far[found, 1] = ox + r * dx, oy + r * dy
            far_o[found, 0], far_o[found, 1] = ox, oy
            weight[found] = FREE_WEIGHT if valid[j] else SILENT_WEIGHT
            found += 1
    return p[:kept], o[:kept], far[:found], far_o[:found], weight[:found]


@compiled
def fit_pairs(
    W_p: Array,
    W_o: Array,
    angle: Array,
    valid: Bools,
    beam_t: Array,
    beams: Ints,
    rows: Ints,
    hit_t: Array,
    prior: Array,
    W_v: Array,
    size: Array,
    turns: Array,
    scale: Array,
) -> tuple[Array, Array, Array, Ints, Ints]:
    """The sized rectangle fitted for each row of prior to the beams rows[:, 0]..rows[:, 1] of `beams`.

    prior (k, 5): x, y, heading, position sigma, heading sigma at the time of the segment's returns; W_v (k,
    2); size (k, 2); turns (k, m): headings to start from, relative to the prior's. Returns pose (k, 3),
    covariance (k, 3, 3) of the data alone (the prior's information taken out), cost per return (k,), sides
    seen (k,) mask, returns used (k,).
    """
    k = prior.shape[0]
    pose, cov, cost = np.empty((k, 3)), np.ones((k, 3, 3)), np.empty(k)
    sides, hits = np.zeros(k, np.int64), np.zeros(k, np.int64)
    z, N, begin, box = np.empty(3), np.empty((3, 4)), np.empty(3), np.empty(5)
    for i in range(k):
        box[0], box[1], box[2], box[3], box[4] = prior[i, 0], prior[i, 1], prior[i, 2], size[i, 0], size[i, 1]
        p, o, far, far_o, weight = _gather(
            W_p,
            W_o,
            angle,
            valid,
            beam_t,
            beams,
            rows[i, 0],
            rows[i, 1],
            hit_t[i],
            W_v[i, 0],
            W_v[i, 1],
            box,
            2.0 * prior[i, 3],
        )
        hits[i] = p.shape[0]
        copy(prior[i], pose[i])
        if p.shape[0] == 0:
            cost[i] = 1e3
            continue
        best = 1e300
        for m in range(turns.shape[1]):
            enough = DOUBTFUL_FIT if abs(turns[i, m]) > 1.0 else GOOD_FIT
            if m > 0 and (turns[i, m] == 0.0 or best < enough * p.shape[0]):
                continue
            begin[0], begin[1], begin[2] = prior[i, 0], prior[i, 1], prior[i, 2] + turns[i, m]
            c, seen = fit_sized(begin, p, o, far, far_o, weight, prior[i], size[i], scale, z, N)
            if c < best:
                best = c
                copy(z, pose[i])
                sides[i] = seen
                _covariance(N, prior[i], cov[i])
        cost[i] = best / p.shape[0]
    return pose, cov, cost, sides, hits


@kernel
def _covariance(N: Array, prior: Array, out: Array) -> None:
    """Inverse of the information in N less nine tenths of the prior's: an unseen direction stays open."""
    N[0, 0] -= 0.9 / prior[3] ** 2
    N[1, 1] -= 0.9 / prior[3] ** 2
    N[2, 2] -= 0.9 / prior[4] ** 2
    for k in range(3):
        for m in range(3):
            N[m, 3] = 1.0 if m == k else 0.0
        out[0, k], out[1, k], out[2, k] = solve3(N, 0.0)


@dataclass(frozen=True, slots=True)
class Fits:
    """Rectangles of tracks fitted to segments; row i is pair i; fixed frame W."""

    pairs: Ints  # (k, 2) row of the track, segment
    t: Array  # (k,) mean time of the segment's returns [s]
    pose: Array  # (k, 3) x, y, heading
    cov: Array  # (k, 3, 3)
    cost: Array  # (k,) a return
    sides: Ints  # (k,) mask: 1 a short side was seen, 2 a long side
    hits: Ints  # (k,) returns used, at most MOST_HITS
    start: Ints  # (k,) rows of the beams
    stop: Ints  # (k,)
    x: Array  # (k, 6) the track's prediction for that time
    P: Array  # (k, 6, 6)


def fit(
    scan: Scan,
    segments: Segments,
    pairs: Ints,
    rows: Ints,
    t: Array,
    x: Array,
    P: Array,
    size: Array,
    turning: Bools,
    settings: Settings,
) -> Fits:
    """The sized rectangle of each pair; x (k, 6), P (k, 6, 6) predicted at t (k,); rows (k, 2) of beams.

    turning (k,): the body may have turned, so that the fit starts from several headings.
    """
    noise = float(np.hypot(settings.detect.range_noise_m, settings.detect.shape_noise_m))
    spread = np.clip(3.0 * np.sqrt(np.maximum(P[:, 0, 0], P[:, 1, 1])), 0.5, 3.0)
    turn = np.clip(np.sqrt(P[:, 4, 4]), *HEADING_PRIOR)
    prior = np.column_stack([x[:, :2], x[:, 4], spread, turn])
    scale = np.array([noise, CAUCHY])
    turns = np.where(turning[:, None], TURNS, STILL)
    pose, cov, cost, sides, hits = fit_pairs(
        scan.W_p,
        scan.W_sensor,
        scan.angle,
        scan.valid,
        scan.beam_t,
        segments.beams,
        rows,
        t,
        prior,
        np.ascontiguousarray(x[:, 2:4]),
        np.ascontiguousarray(size),
        turns,
        scale,
    )
    return Fits(pairs, t, pose, cov, cost, sides, hits, rows[:, 0], rows[:, 1], x, P)


def near_pairs(x: Array, P: Array, size: Array, dt: Array, detections: Detections, gate: float) -> Ints:
    """(k, 2) pairs of track and segment near enough for a fit; dt (n, m) [s] from track to segment."""
    centre = x[:, None, :2] + x[:, None, 2:4] * dt[:, :, None]
    apart = np.hypot(*(centre - detections.W_p[None]).transpose(2, 0, 1))
    spread = gate * np.sqrt(np.maximum(P[:, 0, 0], P[:, 1, 1])) + 0.5 * np.hypot(size[:, 0], size[:, 1])
    reach = spread[:, None] + 0.5 * detections.extent[None, :, 0]
    usable = (detections.kind != Kind.LARGE) & (detections.hits >= 2)
    return np.argwhere((apart < reach) & usable[None, :])


def assign(fits: Fits, n_tracks: int, n_segments: int, gate: float) -> Ints:
    """Rows of `fits` with the least sum of squared Mahalanobis distances; one segment a track."""
    from scipy.optimize import linear_sum_assignment

    d2 = predictor.mahalanobis2(fits.x, fits.P, fits.pose, fits.cov)
    good = (d2 < gate * gate) & (fits.cost < WORST_FIT)
    price = np.full((n_tracks, n_segments), FORBIDDEN)
    row = np.full((n_tracks, n_segments), -1, np.int64)
    i, j = fits.pairs[good].T
    spread = fits.P[good, 0, 0] + fits.P[good, 1, 1]  # a vague track must not outbid a sharp one
    price[i, j] = d2[good] + 2.0 * fits.cost[good] + np.log1p(spread)
    row[i, j] = np.flatnonzero(good)
    a, b = linear_sum_assignment(price)
    chosen: Ints = row[a, b]
    return chosen[chosen >= 0]


def inside(pose: Array, size: Array, p: Array, margin: float) -> Bools:
    """(n,) whether points p (n, 2) lie in the rectangle at pose (3,) of size (2,), grown by margin [m]."""
    q = np.abs(rotate(p - pose[:2], -pose[2]))
    return np.asarray((q[:, 0] < 0.5 * size[0] + margin) & (q[:, 1] < 0.5 * size[1] + margin))


@compiled
def widen(
    W_p: Array,
    beam_t: Array,
    segments: tuple[Ints, Ints, Ints],
    taken: Bools,
    segment: Ints,
    rows: Ints,
    t: Array,
    pose: Array,
    W_v: Array,
    size: Array,
    margin: float,
) -> None:
    """Grow rows (k, 2) of beams over neighbours that lie in the rectangle at pose (k, 3), size (k, 2).

    Returns are moved to time t (k,) with W_v (k, 2): a body that straddles the beginning of a turn is seen
    twice. Up to MOST_STRANGE segments in between may be of something else, seen through a window or past a
    mirror. segments: beams, start, stop; taken (n,) marks those that may not be used; `segment` (k,) is
    where to begin.
    """
    beams, start, stop = segments
    for k in range(rows.shape[0]):
        c, s = np.cos(pose[k, 2]), np.sin(pose[k, 2])
        for step in (-1, 1):
            j, strange = segment[k] + step, 0
            while 0 <= j < start.shape[0] and not taken[j] and strange <= MOST_STRANGE:
                within = 0
                for r in range(start[j], stop[j]):
                    b = beams[r]
                    dx = W_p[b, 0] - W_v[k, 0] * (beam_t[b] - t[k]) - pose[k, 0]
                    dy = W_p[b, 1] - W_v[k, 1] * (beam_t[b] - t[k]) - pose[k, 1]
                    u, v = abs(c * dx + s * dy), abs(c * dy - s * dx)
                    within += u < 0.5 * size[k, 0] + margin and v < 0.5 * size[k, 1] + margin
                strange += 1
                if within >= 0.7 * (stop[j] - start[j]):
                    rows[k, 0], rows[k, 1] = min(rows[k, 0], start[j]), max(rows[k, 1], stop[j])
                    strange = 0
                j += step


def owners(segments: Segments, rows: Ints) -> Ints:
    """(n,) which of rows (k, 2) of beams holds each segment, -1 for none."""
    inside = (segments.start[:, None] >= rows[None, :, 0]) & (segments.stop[:, None] <= rows[None, :, 1])
    return np.where(inside.any(axis=1), inside.argmax(axis=1), -1) if len(rows) else np.full(len(inside), -1)
