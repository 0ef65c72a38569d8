"""Detections -> tracks: associate, correct, learn the size, tell what moves, birth and death."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from outrider import associate, births, body, envelope, moving, observers, predictor
from outrider.book import Book, TrackMemory, empty
from outrider.geometry import wrap
from outrider.records import Array, Detections, Ints, Kind, Scan, Tracks, TrackState
from outrider.segment import Segments
from outrider.settings import Settings

COURSE_SIGMA = 0.5  # pull of the course on the predictor's heading [rad]
CALM = 0.3  # what stands is expected to accelerate by this share of what moves
MOVING = (TrackState.CONFIRMED, TrackState.COASTING)  # what an observer is asked about
HEADING_FLOOR = 0.05  # a fitted heading is never trusted more than this [rad]


@dataclass(frozen=True, slots=True)
class Engine:
    """A named observer made ready: its gains, its compiled loops, and how many scans it looks back."""

    observer: Any
    gains: Any
    loops: Any
    n_states: int
    lag: int

    def tell(self, tracks: Tracks, states: Array, ahead: Array, rows: Ints) -> Tracks:
        """The tracks, with what the states (n, n_states) say of `rows`, `ahead` (n,) [s] later."""
        names = ("speed", "acceleration", "course", "yaw", "slip", "yaw_rate")
        motion = np.column_stack([tracks.W_p, *(getattr(tracks, name) for name in names)])
        cov = tracks.cov.copy()
        if len(rows):
            later = states.copy()
            self.loops.predict_all(states, ahead, self.gains, rows, later)
            self.loops.motion_all(later, self.gains, rows, motion)
            half = observers.spreads(self.observer, later, self.gains, rows)[rows, :3]
            sure = np.isfinite(half).all(axis=1)
            cov[rows[sure]] = half[sure][:, [0, 1, 1, 2]].reshape(-1, 2, 2)
        _, _, *told = motion.T
        columns: dict[str, Any] = dict(zip(names, told, strict=True))
        after = replace(tracks, W_p=motion[:, :2], cov=cov, **columns)
        if not np.isfinite(tracks.bound).any():
            return after
        shifts = [np.hypot(*(after.W_p - tracks.W_p).T), np.hypot(*(after.W_v - tracks.W_v).T)]
        return replace(after, bound=tracks.bound + np.column_stack(shifts))


def engine(settings: Settings) -> Engine:
    """The observer that the settings name; InputError for an unknown name or gain, or a lag it has not."""
    told = settings.observer
    for name, values in told.gains.items():
        observers.gains_from(observers.get(name), values)
    chosen = observers.variant(told.name, told.gains)
    n_states = len(chosen.observer.State._fields)
    return Engine(chosen.observer, chosen.gains, observers.stream(chosen.observer), n_states, chosen.lag)


def start(settings: Settings) -> TrackMemory:
    """Memory before the first scan."""
    return TrackMemory(empty(0, engine(settings).n_states), 1, ())


def update(
    memory: TrackMemory,
    scan: Scan,
    segments: Segments,
    detections: Detections,
    settings: Settings,
    eng: Engine,
) -> tuple[TrackMemory, Detections, Tracks]:
    """One scan further: memory, detections with the rectangles fitted to tracks, and the tracks at scan.t."""
    book = memory.book.writable()
    fits, chosen, owner = _associate(book, scan, segments, detections, settings)
    previous = (book.z.copy(), book.seen.copy())
    rows = fits.pairs[chosen, 0]
    _correct(book, rows, fits, chosen, settings)
    _learn(book, rows, fits, chosen, scan, segments, settings)
    moving.direct(book, rows, scan, settings)
    moving.judge(book, rows, scan, memory.earlier, settings)
    moving.straighten(book, rows, scan, settings)
    _observe(book, rows, previous, eng)
    _bound(book, rows, settings)
    book = book.keep(births.alive(book, scan.t, settings))
    born = births.births(scan, segments, detections, owner, book, settings, eng.n_states)
    born.id[:] = memory.next_id + np.arange(len(born))
    detections = _report(detections, fits, chosen, memory.book, owner)
    tracks = estimate(book, scan.t, settings, eng)
    after = TrackMemory(book.append(born), memory.next_id + len(born), moving.remember(memory.earlier, scan))
    return after, detections, tracks


# ------------------------------------------------------------------ association and correction


def _noise(book: Book, settings: Settings) -> Array:
    q = np.full(len(book), settings.track.acceleration_noise)
    q[book.state == TrackState.STATIC] *= CALM
    return q


def _associate(
    book: Book, scan: Scan, segments: Segments, detections: Detections, settings: Settings
) -> tuple[associate.Fits, Ints, Ints]:
    """All fits, the rows of them chosen, and the owner of each segment as a row of the chosen ones."""
    gate = settings.track.gate_sigma
    dt = book.ahead(detections.hit_t[:, None]).T
    pairs = associate.near_pairs(book.x, book.P, book.size, dt, detections, gate)
    i, j = pairs.T
    t = detections.hit_t[j]
    x, P = predictor.predict(
        book.x[i],
        book.P[i],
        dt[i, j],
        _noise(book, settings)[i],
        settings.track.yaw_acceleration_noise,
    )
    rows = np.column_stack([segments.start[j], segments.stop[j]])
    size = np.ascontiguousarray(book.size[i, :2])
    table = (segments.beams, segments.start, segments.stop)
    large = detections.kind == Kind.LARGE
    pose, W_v = np.ascontiguousarray(x[:, [0, 1, 4]]), np.ascontiguousarray(x[:, 2:4])
    associate.widen(scan.W_p, scan.beam_t, table, large, j, rows, t, pose, W_v, size, 0.5)
    turning = book.state[i] != TrackState.STATIC
    fits = associate.fit(scan, segments, pairs, rows, t, x, P, size, turning, settings)
    chosen = associate.assign(fits, len(book), len(detections.hits), gate)
    taken = large.copy()
    taken[j[chosen]] = True
    wide = rows[chosen]
    associate.widen(
        scan.W_p,
        scan.beam_t,
        table,
        taken,
        j[chosen],
        wide,
        t[chosen],
        fits.pose[chosen],
        W_v[chosen],
        size[chosen],
        0.3,
    )
    grown = np.flatnonzero((wide != rows[chosen]).any(axis=1))
    if len(grown):
        again = chosen[grown]
        new = associate.fit(
            scan,
            segments,
            pairs[again],
            wide[grown],
            t[again],
            x[again],
            P[again],
            size[again],
            turning[again],
            settings,
        )
        for name in ("pose", "cov", "cost", "sides", "hits", "start", "stop"):
            getattr(fits, name)[again] = getattr(new, name)
    owner = associate.owners(segments, wide)
    return fits, chosen, owner


def _correct(book: Book, rows: Ints, fits: associate.Fits, chosen: Ints, settings: Settings) -> None:
    """Predictor, last measurement and sightings; `rows` are the tracks seen."""
    x, P = fits.x[chosen], fits.P[chosen]
    _reconsider(x, P, fits.pose, chosen)
    x, P = predictor.correct(
        x,
        P,
        fits.pose[chosen],
        fits.cov[chosen],
        COURSE_SIGMA,
        2.0 * settings.track.moving_speed_mps,
        HEADING_FLOOR,
    )
    book.x[rows], book.P[rows], book.seen[rows] = x, P, fits.t[chosen]
    book.sightings[:] = (book.sightings << 1) & 0xFFFF
    book.sightings[rows] |= 1
    book.hits[:] = 0
    book.hits[rows] = fits.hits[chosen]
    cov = fits.cov[chosen]
    book.z[rows] = np.column_stack(
        [
            fits.pose[chosen, :2],
            cov[:, 0, 0],
            cov[:, 0, 1],
            cov[:, 1, 1],
            wrap(fits.pose[chosen, 2]),
            cov[:, 2, 2] + HEADING_FLOOR**2,
            book.size[rows, :2],
        ]
    )


def _reconsider(x: Array, P: Array, pose: Array, chosen: Ints) -> None:
    """Where a fit stands across its prediction, sides were confused: take its axis, along the motion."""
    turn = wrap(pose[chosen, 2] - x[:, 4])
    across = np.abs(turn) > 0.25 * np.pi
    fast = np.hypot(x[:, 2], x[:, 3]) > moving.SIGNIFICANT * np.sqrt(P[:, 2, 2] + P[:, 3, 3])
    towards = np.where(fast, np.arctan2(x[:, 3], x[:, 2]), x[:, 4])
    back = np.abs(wrap(pose[chosen, 2] - towards)) > 0.5 * np.pi
    pose[chosen[across & back], 2] += np.pi
    x[across, 4] = pose[chosen[across], 2]
    x[across, 5] = 0.0


def _learn(
    book: Book,
    rows: Ints,
    fits: associate.Fits,
    chosen: Ints,
    scan: Scan,
    segments: Segments,
    settings: Settings,
) -> None:
    """Sizes, unless they are given; a body that grows does so away from the side that is seen."""
    d = settings.detect
    if not len(rows) or (d.body_length_m is not None and d.body_width_m is not None):
        return
    noise = float(np.hypot(d.range_noise_m, d.shape_noise_m))
    beam_rows = np.column_stack([fits.start[chosen], fits.stop[chosen]])
    increment = abs(float(scan.angle[-1] - scan.angle[0])) / max(len(scan.angle) - 1, 1)
    free, gap = body.free_ends(scan, segments.beams, beam_rows, (d.max_gap_beams + 1.5) * increment, 0.5)
    pose = fits.pose[chosen]
    old = book.size[rows]
    seen, sigma = body.measure(
        scan.W_p, scan.W_sensor, segments.beams, beam_rows, free, gap, pose, old[:, :2].copy(), noise
    )
    new = body.learn(old, seen, sigma, 0.05)
    grown = 0.5 * (new[:, :2] - old[:, :2])
    eye = scan.W_sensor[segments.beams[beam_rows[:, 0]], :2] - pose[:, :2] if len(rows) else np.zeros((0, 2))
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    du = -np.sign(c * eye[:, 0] + s * eye[:, 1]) * grown[:, 0] * (fits.sides[chosen] & 1 > 0)
    dv = -np.sign(c * eye[:, 1] - s * eye[:, 0]) * grown[:, 1] * (fits.sides[chosen] & 2 > 0)
    book.x[rows, 0] += c * du - s * dv
    book.x[rows, 1] += s * du + c * dv
    book.size[rows] = new


# ------------------------------------------------------------------ observers


def _observe(book: Book, rows: Ints, previous: tuple[Array, Array], eng: Engine) -> None:
    """Step the observer of every track that was seen, standing or not; start it where none runs.

    One that keeps a covariance knows how little it knows, and starts at once; another one when the track is
    known to move. One that runs backwards, now that it is known which end is the front, starts anew.
    """
    z_before, seen_before = previous
    known = rows[book.observed[rows]]
    velocity = book.x[:, 2:4].copy()
    if len(known):
        eng.loops.step_all(book.obs, z_before, book.z, book.seen - seen_before, eng.gains, known, book.obs)
        motion = np.zeros((len(book), 8))
        eng.loops.motion_all(book.obs, eng.gains, known, motion)
        _, _, speed, _, course, yaw, _, _ = motion[known].T
        velocity[known] = speed[:, None] * np.column_stack([np.cos(course), np.sin(course)])
        backwards = np.abs(wrap(yaw - book.x[known, 4])) > 0.5 * np.pi
        book.observed[known[backwards]] = False
    early = hasattr(eng.observer, "spread")
    fresh = rows[~book.observed[rows] & (early | (book.state[rows] == TrackState.CONFIRMED))]
    if len(fresh):
        _start(book, fresh, velocity[fresh], early, eng)


def _start(book: Book, fresh: Ints, velocity: Array, early: bool, eng: Engine) -> None:
    """Start observers from the way of the last third of a second, at a velocity (k, 2) [m/s].

    How uncertain it is, is said of the way's beginning; nothing of it where the observer would not ask.
    """
    first, second, ago = book.z.copy(), book.z.copy(), np.full(len(book), 0.3)
    first[fresh, :2] -= 0.3 * velocity
    if early:
        first[fresh, 2:5] = 0.09 * book.P[fresh][:, [2, 2, 3], [2, 3, 3]]
    else:
        first[fresh, 2:5], second[fresh, 2:5] = 0.0, 0.0
    eng.loops.start_all(first, second, ago, eng.gains, fresh, book.obs)
    book.observed[fresh] = True


def _bound(book: Book, rows: Ints, settings: Settings) -> None:
    """Take what was measured of `rows` into what bounds them, where that is asked for."""
    assumed = envelope.limits(settings.envelope)
    if assumed:
        book.broken[:] = envelope.look(book.looks, rows, book.seen, book.z[:, :2], assumed)


def estimate(book: Book, t: float, settings: Settings, eng: Engine) -> Tracks:
    """All tracks at time t: the observer's motion where one runs, else the predictor's place at rest."""
    _, P = predictor.predict(
        book.x, book.P, book.ahead(t), _noise(book, settings), settings.track.yaw_acceleration_noise
    )
    still, heading = np.zeros(len(book)), wrap(book.x[:, 4])
    resting = Tracks(
        t=t,
        id=book.id,
        state=book.state,
        W_p=book.x[:, :2],
        speed=still,
        acceleration=still,
        course=heading,
        yaw=heading,
        slip=still,
        yaw_rate=still,
        extent=book.size[:, :2].copy(),
        cov=P[:, :2, :2],
        hits=book.hits,
        age=t - book.born,
        bound=np.full((len(book), 2), np.inf),
        broken=book.broken,
    )
    running = np.flatnonzero(book.observed & np.isin(book.state, MOVING))
    tracks = eng.tell(resting, book.obs, t - book.seen, running)
    assumed = envelope.limits(settings.envelope)
    if not assumed:
        return tracks
    return replace(tracks, bound=envelope.bounds(book.looks, t, tracks.W_p, tracks.W_v, assumed))


def _report(
    detections: Detections, fits: associate.Fits, chosen: Ints, before: Book, owner: Ints
) -> Detections:
    """Detections with the track's rectangle and its time wherever a segment belongs to one."""
    new = {
        k: getattr(detections, k).copy()
        for k in ("hit_t", "W_p", "heading", "extent", "cov", "sides", "kind")
    }
    track = np.full(len(owner), -1, np.int64)
    owned = np.flatnonzero(owner >= 0)
    c = chosen[owner[owned]]
    i = fits.pairs[c, 0]
    track[owned] = before.id[i]
    new["hit_t"][owned] = fits.t[c]
    new["W_p"][owned] = fits.pose[c, :2]
    new["heading"][owned] = wrap(fits.pose[c, 2])
    new["extent"][owned] = before.size[i, :2]
    new["cov"][owned] = fits.cov[c]
    new["sides"][owned] = (fits.sides[c] & 1) + (fits.sides[c] >> 1)
    new["kind"][owned] = np.where(before.state[i] == TrackState.STATIC, Kind.STATIC, Kind.VEHICLE)
    return replace(detections, track=track, **new)
