"""Detections -> tracks: associate, correct, learn the size, tell what moves, birth and death."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from outrider import associate, body, change, observers, predictor
from outrider.book import Book, TrackMemory, empty
from outrider.geometry import wrap
from outrider.records import Array, Bools, Detections, Ints, Kind, Scan, Tracks, TrackState
from outrider.segment import Segments
from outrider.settings import Settings

COURSE_SIGMA = 0.5  # pull of the course on the predictor's heading [rad]
HEADING_FLOOR = 0.05  # a fitted heading is never trusted more than this [rad]
SIGNIFICANT = 3.0  # speed over its standard deviation, to be called moving
SLOW_S = 2.0  # a body slower than half the moving speed for longer is static
HISTORY_S = 3.0  # how far back earlier scans are kept
HISTORY_STEP_S = 0.2


@dataclass(frozen=True, slots=True)
class Engine:
    """A named observer made ready: its gains and its compiled loops."""

    gains: Any
    loops: Any
    n_states: int


def engine(settings: Settings) -> Engine:
    """The observer that the settings name; InputError for an unknown name or gain."""
    observer = observers.get(settings.observer.name)
    gains = observers.gains_from(observer, settings.observer.gains)
    return Engine(gains, observers.stream(observer), len(observer.State._fields))


def start(settings: Settings) -> TrackMemory:
    """Memory before the first scan."""
    return TrackMemory(empty(0, engine(settings).n_states), 1, ())


def update(
    memory: TrackMemory, scan: Scan, segments: Segments, detections: Detections, settings: Settings, eng: Engine
) -> tuple[TrackMemory, Detections, Tracks]:
    """One scan further: memory, detections with the rectangles fitted to tracks, and the tracks at scan.t."""
    book = memory.book.writable()
    fits, chosen, owner = _associate(book, scan, segments, detections, settings)
    previous = (book.z.copy(), book.seen.copy())
    rows = fits.pairs[chosen, 0]
    _correct(book, rows, fits, chosen, settings)
    _learn(book, rows, fits, chosen, scan, segments, settings)
    _direct(book, rows, scan, settings)
    _judge(book, rows, scan, memory.earlier, settings)
    _observe(book, rows, previous, eng)
    book = book.keep(_alive(book, scan.t, settings))
    born = _births(scan, segments, detections, owner, book, settings, eng)
    born.id[:] = memory.next_id + np.arange(len(born))
    detections = _report(detections, fits, chosen, memory.book, owner)
    tracks = _tracks(book, scan.t, settings, eng)
    after = TrackMemory(book.append(born), memory.next_id + len(born), _remember(memory.earlier, scan))
    return after, detections, tracks


# ------------------------------------------------------------------ association and correction


def _noise(book: Book, settings: Settings) -> Array:
    q = np.full(len(book), settings.track.acceleration_noise)
    q[book.state == TrackState.STATIC] *= 0.3
    return q


def _associate(
    book: Book, scan: Scan, segments: Segments, detections: Detections, settings: Settings
) -> tuple[associate.Fits, Ints, Ints]:
    """All fits, the rows of them chosen, and the owner of each segment as a row of the chosen ones."""
    gate = settings.track.gate_sigma
    pairs = associate.near_pairs(book.x, book.P, book.size, book.seen, detections, gate)
    i, j = pairs.T
    t = detections.hit_t[j]
    x, P = predictor.predict(
        book.x[i], book.P[i], t - book.seen[i], _noise(book, settings)[i], settings.track.yaw_acceleration_noise
    )
    rows = np.column_stack([segments.start[j], segments.stop[j]])
    size = book.size[i, :2]
    table = (segments.beams, segments.start, segments.stop)
    large = detections.kind == Kind.LARGE
    pose, W_v = x[:, [0, 1, 4]], x[:, 2:4]
    associate.widen(scan.W_p, scan.beam_t, table, large, j, rows, t, pose, W_v, size, 0.5)
    fits = associate.fit(scan, segments, pairs, rows, t, x, P, size, settings)
    chosen = associate.assign(fits, len(book), len(detections.hits), gate)
    taken = large.copy()
    taken[j[chosen]] = True
    wide = rows[chosen]
    associate.widen(
        scan.W_p, scan.beam_t, table, taken, j[chosen], wide, t[chosen], fits.pose[chosen], W_v[chosen], size[chosen], 0.3
    )
    grown = np.flatnonzero((wide != rows[chosen]).any(axis=1))
    if len(grown):
        again = chosen[grown]
        new = associate.fit(
            scan, segments, pairs[again], wide[grown], t[again], x[again], P[again], size[again], settings
        )
        for name in ("pose", "cov", "cost", "sides", "start", "stop"):
            getattr(fits, name)[again] = getattr(new, name)
    owner = associate.owners(segments, wide)
    return fits, chosen, owner


def _correct(book: Book, rows: Ints, fits: associate.Fits, chosen: Ints, settings: Settings) -> None:
    """Predictor, last measurement and sightings; `rows` are the tracks seen."""
    x, P = fits.x[chosen], fits.P[chosen]
    _reconsider(x, P, fits.pose, chosen)
    predictor.correct(
        x, P, fits.pose[chosen], fits.cov[chosen], COURSE_SIGMA, 2.0 * settings.track.moving_speed_mps, HEADING_FLOOR
    )
    book.x[rows], book.P[rows], book.seen[rows] = x, P, fits.t[chosen]
    book.sightings[:] = (book.sightings << 1) & 0xFFFF
    book.sightings[rows] |= 1
    book.hits[:] = 0
    book.hits[rows] = fits.stop[chosen] - fits.start[chosen]
    cov = fits.cov[chosen]
    book.z[rows] = np.column_stack([
        fits.pose[chosen, :2],
        cov[:, 0, 0],
        cov[:, 0, 1],
        cov[:, 1, 1],
        wrap(fits.pose[chosen, 2]),
        cov[:, 2, 2] + HEADING_FLOOR**2,
        book.size[rows, :2],
    ])


def _reconsider(x: Array, P: Array, pose: Array, chosen: Ints) -> None:
    """Where the fit stands across the prediction, the sides were confused: take the fit's axis, along the motion."""
    turn = wrap(pose[chosen, 2] - x[:, 4])
    across = np.abs(turn) > 0.25 * np.pi
    fast = np.hypot(x[:, 2], x[:, 3]) > SIGNIFICANT * np.sqrt(P[:, 2, 2] + P[:, 3, 3])
    towards = np.where(fast, np.arctan2(x[:, 3], x[:, 2]), x[:, 4])
    back = np.abs(wrap(pose[chosen, 2] - towards)) > 0.5 * np.pi
    pose[chosen[across & back], 2] += np.pi
    x[across, 4] = pose[chosen[across], 2]
    x[across, 5] = 0.0


def _learn(
    book: Book, rows: Ints, fits: associate.Fits, chosen: Ints, scan: Scan, segments: Segments, settings: Settings
) -> None:
    """Sizes, unless they are given; a body that grows does so away from the side that is seen."""
    d = settings.detect
    if d.body_length_m is not None and d.body_width_m is not None:
        return
    noise = float(np.hypot(d.range_noise_m, d.shape_noise_m))
    beam_rows = np.column_stack([fits.start[chosen], fits.stop[chosen]])
    increment = abs(float(scan.angle[-1] - scan.angle[0])) / max(len(scan.angle) - 1, 1)
    free, gap = body.free_ends(
        scan.W_p, scan.W_sensor, scan.angle, segments.beams, beam_rows, (d.max_gap_beams + 1.5) * increment, 0.5
    )
    pose = fits.pose[chosen]
    seen, sigma = body.measure(scan.W_p, scan.W_sensor, segments.beams, beam_rows, free, gap, pose, noise)
    old = book.size[rows]
    new = body.learn(old, seen, sigma, 0.05)
    grown = 0.5 * (new[:, :2] - old[:, :2])
    eye = scan.W_sensor[segments.beams[beam_rows[:, 0]], :2] - pose[:, :2] if len(rows) else np.zeros((0, 2))
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    du = -np.sign(c * eye[:, 0] + s * eye[:, 1]) * grown[:, 0] * (fits.sides[chosen] & 1 > 0)
    dv = -np.sign(c * eye[:, 1] - s * eye[:, 0]) * grown[:, 1] * (fits.sides[chosen] & 2 > 0)
    book.x[rows, 0] += c * du - s * dv
    book.x[rows, 1] += s * du + c * dv
    book.size[rows] = new


# ------------------------------------------------------------------ what moves


def _direct(book: Book, rows: Ints, scan: Scan, settings: Settings) -> None:
    """Until the front is known it is the end that leads; a body that never moved faces the way the rider does."""
    free = rows[~book.directed[rows]]
    v = book.x[free, 2:4]
    speed = np.hypot(v[:, 0], v[:, 1])
    sure = speed > SIGNIFICANT * np.sqrt(book.P[free, 2, 2] + book.P[free, 3, 3])
    leads = sure & (speed > 0.5 * settings.track.moving_speed_mps)
    towards = np.where(leads, np.arctan2(v[:, 1], v[:, 0]), scan.ego.W_pose[2])
    turn = wrap(towards - book.x[free, 4])
    flip = free[(np.abs(turn) > 0.5 * np.pi)]
    book.x[flip, 4] = wrap(book.x[flip, 4] + np.pi)
    book.z[flip, 5] = wrap(book.z[flip, 5] + np.pi)


def _judge(book: Book, rows: Ints, scan: Scan, earlier: tuple[Scan, ...], settings: Settings) -> None:
    """Tentative, static or moving: by sightings, by speed, and by what earlier scans say of the same places."""
    t = settings.track
    window = (1 << t.confirm_window) - 1
    speed = np.hypot(book.x[:, 2], book.x[:, 3])
    sure = speed > SIGNIFICANT * np.sqrt(book.P[:, 2, 2] + book.P[:, 3, 3])
    fast = sure & (speed > t.moving_speed_mps)
    for i in rows:
        if book.state[i] == TrackState.TENTATIVE:
            if int(book.sightings[i] & window).bit_count() >= t.confirm_hits:
                book.state[i] = TrackState.STATIC
            else:
                continue
        shifted = _shifted(book, i, float(speed[i]), scan, earlier, settings) if speed[i] > 0.5 * t.moving_speed_mps else 0
        if shifted is not None:
            book.shifts[i] = ((book.shifts[i] << 1) | shifted) & 0xFF
        moving = book.state[i] in (TrackState.CONFIRMED, TrackState.COASTING)
        if not moving and fast[i] and int(book.shifts[i] & 7).bit_count() >= 2:
            book.state[i], book.slow_since[i], book.directed[i] = TrackState.CONFIRMED, np.inf, True
        elif moving:
            slow = speed[i] < 0.5 * t.moving_speed_mps
            book.slow_since[i] = min(book.slow_since[i], scan.t) if slow else np.inf
            stood = scan.t - book.slow_since[i] > SLOW_S
            ghost = shifted == 0 and not slow and book.shifts[i] & 0x1F == 0
            book.state[i] = TrackState.STATIC if stood or ghost else TrackState.CONFIRMED
    missed = (book.hits == 0) & (book.state == TrackState.CONFIRMED)
    book.state[missed] = TrackState.COASTING
    still = book.state == TrackState.STATIC
    book.observed[still] = False


def _shifted(
    book: Book, i: int, speed: float, scan: Scan, earlier: tuple[Scan, ...], settings: Settings
) -> int | None:
    """1 where an earlier scan agrees that the body has moved, 0 where it does not, None where it cannot say."""
    way = settings.track.moving_distance_m
    old = next((s for s in reversed(earlier) if (scan.t - s.t) * speed > way and scan.t - s.t > 0.15), None)
    if old is None:
        return None if not earlier or (scan.t - earlier[0].t) < HISTORY_S - 2 * HISTORY_STEP_S else 0
    age = book.seen[i] - old.t
    box = np.array([book.x[i, 0], book.x[i, 1], book.x[i, 4], book.size[i, 0], book.size[i, 1]])
    old_box = box - np.array([book.x[i, 2] * age, book.x[i, 3] * age, book.x[i, 5] * age, 0.0, 0.0])
    noise = 3.0 * float(np.hypot(settings.detect.range_noise_m, settings.detect.shape_noise_m))
    same, changed, _hidden, unknown = change.votes(scan, box, old, old_box, 0.15 + noise)
    score = changed + 0.5 * unknown
    if score + same < 2.0:
        return None
    return int(same <= 0.3 * score)


# ------------------------------------------------------------------ observers


def _observe(book: Book, rows: Ints, previous: tuple[Array, Array], eng: Engine) -> None:
    """Step the observer of every moving track that was seen; start it where it does not run yet."""
    moving = rows[book.state[rows] == TrackState.CONFIRMED]
    fresh, known = moving[~book.observed[moving]], moving[book.observed[moving]]
    z_before, seen_before = previous
    dt = book.seen - seen_before
    if len(known):
        eng.loops.step_all(book.obs, z_before, book.z, dt, eng.gains, known, book.obs)
    if len(fresh):  # the way of the last third of a second is less noisy than that of one scan
        first, ago = book.z.copy(), np.full(len(book), 0.3)
        first[fresh, :2] -= 0.3 * book.x[fresh, 2:4]
        eng.loops.start_all(first, book.z, ago, eng.gains, fresh, book.obs)
        book.observed[fresh] = True


def _tracks(book: Book, t: float, settings: Settings, eng: Engine) -> Tracks:
    """All tracks at time t: the observer's motion where one runs, else the predictor's place at rest."""
    n = len(book)
    motion = np.zeros((n, 8))
    x, P = predictor.predict(
        book.x, book.P, t - book.seen, _noise(book, settings), settings.track.yaw_acceleration_noise
    )
    running = np.flatnonzero(book.observed)
    if len(running):
        ahead = book.obs.copy()
        eng.loops.predict_all(book.obs, t - book.seen, eng.gains, running, ahead)
        eng.loops.motion_all(ahead, eng.gains, running, motion)
    rest = np.flatnonzero(~book.observed)
    motion[rest, :2] = book.x[rest, :2]
    motion[rest, 4] = motion[rest, 5] = wrap(book.x[rest, 4])
    x_m, y_m, speed, acceleration, course, yaw, slip, yaw_rate = motion.T
    return Tracks(
        t=t,
        id=book.id,
        state=book.state,
        W_p=np.column_stack([x_m, y_m]),
        speed=speed,
        acceleration=acceleration,
        course=course,
        yaw=yaw,
        slip=slip,
        yaw_rate=yaw_rate,
        extent=book.size[:, :2].copy(),
        cov=P[:, :2, :2].copy(),
        hits=book.hits,
        age=t - book.born,
    )


# ------------------------------------------------------------------ birth, death, memory


def _alive(book: Book, t: float, settings: Settings) -> Bools:
    """(n,) whether each track lives on."""
    unseen = t - book.seen
    tentative = book.state == TrackState.TENTATIVE
    static = book.state == TrackState.STATIC
    known = np.clip(2.0 * (book.seen - book.born), 1.0, settings.track.forget_static_s)
    limit = np.where(static, known, settings.track.coast_s)
    finite = np.isfinite(book.x).all(axis=1) & np.isfinite(book.P).all(axis=(1, 2))
    lost = tentative & ((book.sightings & 0b11) == 0)
    return finite & ~lost & (unseen < limit)


def _births(
    scan: Scan, segments: Segments, detections: Detections, owner: Ints, book: Book, settings: Settings, eng: Engine
) -> Book:
    """New tentative tracks from segments that belong to none and lie in none."""
    new = np.flatnonzero((owner < 0) & (detections.kind == Kind.VEHICLE))
    if len(new) and len(book):
        near = np.hypot(*(detections.W_p[new, None] - book.x[None, :, :2]).transpose(2, 0, 1))
        pairs = np.argwhere(near < 0.5 * np.hypot(book.size[:, 0], book.size[:, 1])[None, :] + 0.5)
        for a, b in pairs:
            pose = book.x[b, [0, 1, 4]]
            if associate.inside(pose, book.size[b, :2], detections.W_p[new[a]][None], 0.3)[0]:
                new[a] = -1
        new = new[new >= 0]
    born = empty(len(new), eng.n_states)
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
    born.z[:, :2] = born.x[:, :2]
    return born.keep(good)


def _first_fit(
    scan: Scan, segments: Segments, detections: Detections, new: Ints, settings: Settings
) -> tuple[Array, Array, Array, Bools]:
    """The template and axis that fit each new segment best: pose (n, 3), covariance, size (n, 4), good enough."""
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
    fits = associate.fit(scan, segments, pairs, rows, detections.hit_t[seg], x, P, size[:, :2], settings)
    hits = np.minimum(rows[:, 1] - rows[:, 0], associate.MOST_HITS)
    total = fits.cost * hits + np.tile(np.repeat(2.0 * np.arange(m), 2), len(new))
    best = total.reshape(len(new), -1).argmin(axis=1) + 2 * m * np.arange(len(new))
    return fits.pose[best], fits.cov[best], size[best], fits.cost[best] < associate.WORST_FIT


def _report(
    detections: Detections, fits: associate.Fits, chosen: Ints, before: Book, owner: Ints
) -> Detections:
    """Detections with the track's rectangle and its time wherever a segment belongs to one; static ones are marked."""
    new = {k: getattr(detections, k).copy() for k in ("hit_t", "W_p", "heading", "extent", "cov", "sides", "kind")}
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


def _remember(earlier: tuple[Scan, ...], scan: Scan) -> tuple[Scan, ...]:
    """Earlier scans with this one, thinned to one every HISTORY_STEP_S and none older than HISTORY_S."""
    kept = tuple(s for s in earlier if scan.t - s.t <= HISTORY_S)
    return kept if kept and scan.t - kept[-1].t < HISTORY_STEP_S else (*kept, scan)
