"""What moves and what stands, which end of a body is its front."""

from __future__ import annotations

import numpy as np

from outrider import body, change
from outrider.book import Book
from outrider.geometry import wrap, wrap_axis
from outrider.records import Array, Ints, Scan, TrackState
from outrider.settings import Settings

TENTATIVE, CONFIRMED, COASTING, STATIC = (int(state) for state in TrackState)
SIGNIFICANT = 3.0  # speed over its standard deviation, to be called moving
SLOW_S = 2.0  # a body slower than half the moving speed for longer is static
HISTORY_S = 3.0  # how far back earlier scans are kept
HISTORY_STEP_S = 0.2
HOME_GAIN = 0.02  # of a standing body's home towards where it is now, a scan: forgets in some seconds
LOOK_AGAIN_S = 0.4  # what moves is asked again whether it really does, this often
LOOK_AGAIN_SURE_S = 1.5  # the same where eight looks in a row agreed
ACROSS = np.pi / 3.0  # angle between length and course that no slip explains [rad]
RUNNING = 2.5  # slower, what moves across its length may be people side by side [m/s]


def direct(book: Book, rows: Ints, scan: Scan, settings: Settings) -> None:
    """Until the front is known it is the end that leads; what never moved faces the way the rider does."""
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


def straighten(book: Book, rows: Ints, scan: Scan, settings: Settings) -> None:
    """What moves across its length shows its width: the length is that of the template it fits, and unseen.

    So it is with a car that comes straight on: its front alone was taken for the side of a two-wheeler. The
    face that is seen stays, the body grows away from it, and the observer starts anew.
    """
    d = settings.detect
    if d.body_length_m is not None and d.body_width_m is not None:
        return
    v = book.x[rows, 2:4]
    speed, course = np.hypot(v[:, 0], v[:, 1]), np.arctan2(v[:, 1], v[:, 0])
    sure = speed > np.maximum(RUNNING, SIGNIFICANT * np.sqrt(book.P[rows, 2, 2] + book.P[rows, 3, 3]))
    across = np.abs(wrap_axis(course - book.x[rows, 4])) > ACROSS
    wrong = sure & across & (book.state[rows] == CONFIRMED) & (book.size[rows, 0] < d.max_width_m)
    if not wrong.any():
        return
    i, course = rows[wrong], course[wrong]
    old = book.size[i]
    template = body.TEMPLATES[np.abs(old[:, :1] - body.TEMPLATES[:, 1]).argmin(axis=1)]
    new = np.column_stack([np.maximum(old[:, 1], template[:, 0]), old[:, 0], template[:, 2], old[:, 2]])
    ahead = np.column_stack([np.cos(course), np.sin(course)])
    eye = np.sum((scan.W_sensor[-1:, :2] - book.x[i, :2]) * ahead, axis=1)
    seen = np.abs(eye) > 0.5 * old[:, 1]
    book.x[i, :2] -= np.where(seen, 0.5 * np.sign(eye) * (new[:, 0] - old[:, 1]), 0.0)[:, None] * ahead
    book.x[i, 4], book.x[i, 5] = course, 0.0
    book.P[i, 0, 0] += (0.5 * new[:, 2]) ** 2
    book.P[i, 1, 1] += (0.5 * new[:, 2]) ** 2
    book.size[i] = new
    book.z[i, :2], book.z[i, 5], book.z[i, 7:9] = book.x[i, :2], course, new[:, :2]
    book.observed[i] = False


def judge(book: Book, rows: Ints, scan: Scan, earlier: tuple[Scan, ...], settings: Settings) -> None:
    """Tentative, static or moving: by sightings, speed, and what earlier scans say of the same places."""
    t = settings.track
    _confirm(book, rows, settings)
    rows = rows[book.state[rows] != TENTATIVE]
    speed = np.hypot(book.x[rows, 2], book.x[rows, 3])
    sure = speed > SIGNIFICANT * np.sqrt(book.P[rows, 2, 2] + book.P[rows, 3, 3])
    slow = speed < 0.5 * t.moving_speed_mps
    moving = (book.state[rows] == CONFIRMED) | (book.state[rows] == COASTING)
    again = np.where(book.shifts[rows] == 0xFF, LOOK_AGAIN_SURE_S, LOOK_AGAIN_S)
    due = ~slow & (~moving | (scan.t - book.looked[rows] > again))
    for i, v in zip(rows[due], speed[due], strict=True):
        shifted = _shifted(book, i, float(v), scan, earlier, settings)
        if shifted is not None:
            book.looked[i] = scan.t
            book.shifts[i] = ((book.shifts[i] << 1) | shifted) & 0xFF
    book.shifts[rows[slow & ~moving]] = 0
    agreed = np.bitwise_count(book.shifts[rows] & 0b111) >= 2
    strayed = np.hypot(*(book.x[rows, :2] - book.home[rows]).T) > _way(book, rows, scan, settings)
    begins = ~moving & sure & (speed > t.moving_speed_mps) & agreed & strayed
    stays = rows[~moving & ~begins]
    book.home[stays] += HOME_GAIN * (book.x[stays, :2] - book.home[stays])
    book.slow_since[rows] = np.where(slow & ~begins, np.minimum(book.slow_since[rows], scan.t), np.inf)
    ends = moving & ((scan.t - book.slow_since[rows] > SLOW_S) | (book.shifts[rows] & 0b111 == 0))
    book.directed[rows[begins]] = True
    book.state[rows[moving | begins]] = CONFIRMED
    book.state[rows[ends]] = STATIC
    book.home[rows[ends]] = book.x[rows[ends], :2]
    book.state[(book.hits == 0) & (book.state == CONFIRMED)] = COASTING


def _confirm(book: Book, rows: Ints, settings: Settings) -> None:
    """Tentative tracks that were seen often enough are taken to stand until they are seen to move."""
    window = (1 << settings.track.confirm_window) - 1
    often = np.bitwise_count(book.sightings[rows] & window) >= settings.track.confirm_hits
    book.state[rows[often & (book.state[rows] == TENTATIVE)]] = STATIC


def _margin(settings: Settings) -> tuple[float, float]:
    """Distance below which two surfaces are one, and what each metre of range adds [m, m/m]."""
    noise = float(np.hypot(settings.detect.range_noise_m, settings.detect.shape_noise_m))
    return 0.15 + 3.0 * noise, settings.track.drift_per_range


def _way(book: Book, rows: Ints, scan: Scan, settings: Settings) -> Array:
    """(k,) the least way [m] that tells moving from the wandering of what stands."""
    least, drift = _margin(settings)
    away = np.hypot(*(book.x[rows, :2] - scan.ego.W_pose[:2]).T)
    return np.asarray(np.maximum(settings.track.moving_distance_m, 1.5 * (least + drift * away)))


def _shifted(
    book: Book, i: int, speed: float, scan: Scan, earlier: tuple[Scan, ...], settings: Settings
) -> int | None:
    """1 where an earlier scan agrees that the body has moved, 0 where not, None where it cannot say."""
    least, drift = _margin(settings)
    way = float(_way(book, np.array([i]), scan, settings)[0])
    old = next((s for s in reversed(earlier) if (scan.t - s.t) * speed > way and scan.t - s.t > 0.15), None)
    if old is None:
        return None if not earlier or (scan.t - earlier[0].t) < HISTORY_S - 2 * HISTORY_STEP_S else 0
    age = book.seen[i] - old.t
    box = np.array([book.x[i, 0], book.x[i, 1], book.x[i, 4], book.size[i, 0], book.size[i, 1]])
    old_box = box - np.array([book.x[i, 2] * age, book.x[i, 3] * age, book.x[i, 5] * age, 0.0, 0.0])
    same, changed, _hidden, unknown = change.votes(scan, box, old, old_box, np.array([least, drift]))
    score = changed + 0.5 * unknown
    if score + same < 2.0:
        return None
    return int(same <= 0.3 * score)


def remember(earlier: tuple[Scan, ...], scan: Scan) -> tuple[Scan, ...]:
    """Earlier scans and this one, one every HISTORY_STEP_S, none older than HISTORY_S, none blind."""
    kept = tuple(s for s in earlier if scan.t - s.t <= HISTORY_S)
    if not scan.valid.any():
        return kept
    return kept if kept and scan.t - kept[-1].t < HISTORY_STEP_S else (*kept, scan)
