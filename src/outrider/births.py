"""Birth and death of tracks: what is new, what is gone, what is held twice."""

from __future__ import annotations

import numpy as np

from outrider import associate, body
from outrider.book import Book, empty
from outrider.geometry import wrap
from outrider.records import Array, Bools, Detections, Ints, Kind, Scan, TrackState
from outrider.segment import Segments
from outrider.settings import Settings


def alive(book: Book, t: float, settings: Settings) -> Bools:
    """(n,) whether each track lives on."""
    unseen = t - book.seen
    tentative = book.state == TrackState.TENTATIVE
    static = book.state == TrackState.STATIC
    known = np.clip(2.0 * (book.seen - book.born), 1.0, settings.track.forget_static_s)
    limit = np.where(static, known, settings.track.coast_s)
    doubled = _doubled(book, t)
    finite = np.isfinite(book.x).all(axis=1) & np.isfinite(book.P).all(axis=(1, 2))
    lost = tentative & ((book.sightings & 0b11) == 0)
    return np.asarray(finite & ~lost & ~doubled & (unseen < limit))


def _doubled(book: Book, t: float) -> Bools:
    """(n,) whether a younger track that is not known to move stands in an older one."""
    out = np.zeros(len(book), np.bool_)
    young = np.flatnonzero((book.state != TrackState.CONFIRMED) & (book.state != TrackState.COASTING))
    now = book.x[:, :2] + book.x[:, 2:4] * book.ahead(t)[:, None]
    d = now[young, None] - now[None]  # row: the younger, column: the older
    c, s = np.cos(book.x[:, 4]), np.sin(book.x[:, 4])
    u = np.abs(d[..., 0] * c + d[..., 1] * s) < 0.5 * book.size[:, 0]
    v = np.abs(d[..., 1] * c - d[..., 0] * s) < 0.5 * book.size[:, 1]
    out[young] = (u & v & (np.arange(len(book)) < young[:, None])).any(axis=1)
    return out


def births(
    scan: Scan,
    segments: Segments,
    detections: Detections,
    owner: Ints,
    book: Book,
    settings: Settings,
    n_states: int,
) -> Book:
    """New tentative tracks from segments that belong to none and lie in none."""
    new = np.flatnonzero((owner < 0) & (detections.kind == Kind.VEHICLE))
    if len(new) and len(book):
        now = book.x[:, :2] + book.x[:, 2:4] * book.ahead(scan.t)[:, None]
        near = np.hypot(*(detections.W_p[new, None] - now[None]).transpose(2, 0, 1))
        pairs = np.argwhere(near < 0.5 * np.hypot(book.size[:, 0], book.size[:, 1])[None, :] + 0.5)
        for a, b in pairs:
            pose = np.append(now[b], book.x[b, 4])
            if associate.inside(pose, book.size[b, :2], detections.W_p[new[a]][None], 0.3)[0]:
                new[a] = -1
        new = new[new >= 0]
    born = empty(len(new), n_states)
    if not len(new):
        return born
    pose, cov, size, good = _first_fit(scan, segments, detections, new, settings)
    born.x[:, :2], born.x[:, 4] = pose[:, :2], wrap(pose[:, 2])
    turn = wrap(scan.ego.W_pose[2] - born.x[:, 4])
    born.x[np.abs(turn) > 0.5 * np.pi, 4] += np.pi
    born.x[:, 4] = wrap(born.x[:, 4])
    vague = np.maximum(cov[:, [0, 1], [0, 1]].max(axis=1), 1.0)
    born.P[:, :2, :2] = cov[:, :2, :2] / vague[:, None, None] + 0.1 * np.eye(2)
    born.P[:, 2, 2] = born.P[:, 3, 3] = 8.0**2
    born.P[:, 4, 4], born.P[:, 5, 5] = 0.3**2, 0.5**2
    born.size[:] = size
    born.born[:] = scan.t
    born.seen[:] = detections.hit_t[new]
    born.hits[:] = detections.hits[new]
    born.z[:, :2] = born.home[:] = born.x[:, :2]
    born.looks[:, 0] = np.column_stack([born.seen, born.x[:, :2]])
    return born.keep(good)


def _first_fit(
    scan: Scan, segments: Segments, detections: Detections, new: Ints, settings: Settings
) -> tuple[Array, Array, Array, Bools]:
    """Best template and axis for each new segment: pose (n, 3), covariance, size (n, 4), good enough."""
    d = settings.detect
    templates = body.TEMPLATES
    if d.body_length_m is not None and d.body_width_m is not None:
        templates = np.array([[d.body_length_m, d.body_width_m, 0.0, 0.0]])
    m = len(templates)
    seg = np.repeat(new, 2 * m)
    size = np.tile(np.repeat(templates, 2, axis=0), (len(new), 1))
    x = np.zeros((len(seg), 6))
    x[:, :2] = detections.W_p[seg]
    x[:, 4] = detections.heading[seg] + np.tile([0.0, 0.5 * np.pi], m * len(new))
    P = np.tile(np.diag([1.0, 1.0, 0.0, 0.0, 0.1, 0.0]), (len(seg), 1, 1))
    rows = np.column_stack([segments.start[seg], segments.stop[seg]])
    pairs = np.column_stack([np.arange(len(seg)), seg])
    still = np.zeros(len(seg), np.bool_)
    fits = associate.fit(
        scan, segments, pairs, rows, detections.hit_t[seg], x, P, size[:, :2], still, settings
    )
    total = fits.cost * fits.hits + np.tile(np.repeat(2.0 * np.arange(m), 2), len(new))
    best = total.reshape(len(new), -1).argmin(axis=1) + 2 * m * np.arange(len(new))
    return fits.pose[best], fits.cov[best], size[best], fits.cost[best] < associate.WORST_FIT
