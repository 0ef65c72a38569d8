"""Truth against estimates, in numbers; lengths and times in whatever metres and clock both were given in.

The definitions are in docs/results.md. Rows are instants, W is the fixed frame, NaN stands for unknown.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from outrider.geometry import corners, transform, wrap
from outrider.records import Array, Bools, Bytes, Ints

MAX_GAP_S = 0.3  # nothing is interpolated over a longer gap
SAME_S = 1e-6  # instants nearer than this are the same


@dataclass(frozen=True, slots=True)
class Truth:
    """How one body really moved; row i is time i; NaN where unknown."""

    t: Array  # (m,) increasing [s]
    W_p: Array  # (m, 2) body centre [m]
    W_v: Array  # (m, 2) its velocity [m/s]
    yaw: Array  # (m,) [rad]

    def at(self, t: Array) -> Truth:
        """The truth at times t (m,), straight between rows; NaN outside its life and in long gaps."""
        columns = np.column_stack([self.W_p, self.W_v, np.unwrap(np.nan_to_num(self.yaw))])
        values = _interpolate(self.t, columns, t)
        return Truth(t, values[:, :2], values[:, 2:4], wrap(values[:, 4]))

    def where(self, keep: Bools) -> Truth:
        """The same instants, unknown where not `keep` (m,)."""
        columns = (np.where(keep[:, None], c, np.nan) for c in (self.W_p, self.W_v, self.yaw[:, None]))
        p, v, yaw = columns
        return Truth(self.t, p, v, yaw[:, 0])


@dataclass(frozen=True, slots=True)
class Estimates:
    """Rows of tracks.parquet as columns, sorted by time."""

    t: Array  # (n,) [s]
    id: Ints  # (n,)
    W_p: Array  # (n, 2) body centre [m]
    W_v: Array  # (n, 2) [m/s]
    yaw: Array  # (n,) [rad]
    course: Array  # (n,) direction of motion: the course, turned by pi when reversing [rad]
    state: Bytes  # (n,) records.TrackState

    def rows(self, keep: Any) -> Estimates:
        """Those rows only; keep: a mask or a slice."""
        return Estimates(*(getattr(self, f.name)[keep] for f in fields(self)))


class Spread(NamedTuple):
    """Size of an error over many instants; NaN where there was none to measure."""

    rms: float
    median: float
    p95: float


class Gospa(NamedTuple):
    """Generalised OSPA of one instant; the parts add up to distance ** p."""

    distance: float
    localisation: float
    missed: float
    false: float


@dataclass(frozen=True, slots=True)
class Score:
    """One body's truth against all tracks."""

    scans: int  # instants with truth
    present: float  # share of them with a track inside the gate
    identities: int  # different tracks that were nearest
    switches: int  # changes from one to another
    breaks: int  # times the body was lost and found again
    heading_flips: int  # instants, body moving, with yaw wrong by more than 90 deg
    position_m: Spread
    velocity_mps: Spread  # length of the error of the vector
    speed_mps: Spread
    course_deg: Spread  # where the body moves
    yaw_deg: Spread  # where the body moves
    ids: tuple[int, ...]  # the tracks, in order of first appearance

    def to_dict(self) -> dict[str, Any]:
        """Flat numbers by name, such as position_rms_m; None where there was nothing to measure."""
        out: dict[str, Any] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, Spread):
                name, unit = f.name.rsplit("_", 1)
                for part, number in value._asdict().items():
                    out[f"{name}_{part}_{unit}"] = number if np.isfinite(number) else None
            else:
                out[f.name] = list(value) if isinstance(value, tuple) else value
        return out


def truth_from_poses(
    t: Array, poses: Array, offset: Sequence[float] = (0.0, 0.0), window_s: float = 0.25
) -> Truth:
    """Motion of the body centre from measured poses (n, 3) x, y [m], yaw [rad] at times t (n,) [s].

    offset: the body centre in the frame whose pose was measured [m]. Velocity: derivative of a quadratic
    fitted to `window_s`, at least five samples, around each instant (Savitzky and Golay 1964); not over gaps.
    """
    t, first = np.unique(np.asarray(t, float), return_index=True)
    poses = np.asarray(poses, float).reshape(-1, 3)[first]
    centre = transform(poses, np.asarray(offset, float))
    cuts = np.flatnonzero(np.diff(t) > MAX_GAP_S) + 1
    pieces = zip(np.split(t, cuts), np.split(centre, cuts), strict=True)
    velocity = [_derivative(*piece, window_s) for piece in pieces]
    return Truth(t, centre, np.vstack(velocity), poses[:, 2])


def _derivative(t: Array, x: Array, window_s: float) -> Array:
    """Derivative (n, 2) of x (n, 2) at t (n,), smoothed; NaN where there are too few samples."""
    from scipy.signal import savgol_filter

    step = float(np.median(np.diff(t))) if len(t) > 1 else np.inf
    window = max(2 * round(0.5 * window_s / step) + 1, 5)
    if len(t) < window:
        return np.full_like(x, np.nan)
    even = np.linspace(t[0], t[-1], max(round((t[-1] - t[0]) / step) + 1, window))
    step = even[1] - even[0]
    smooth = savgol_filter(_interpolate(t, x, even), window, 2, deriv=1, delta=step, axis=0)
    return _interpolate(even, smooth, t)


def _interpolate(t: Array, columns: Array, at: Array) -> Array:
    """Columns (n, k) given at t (n,), at the times `at` (m,); NaN outside [t[0], t[-1]] and in long gaps."""
    out = np.full((len(at), columns.shape[1]), np.nan)
    if len(t) < 2:
        return out
    i = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    given = np.minimum(np.abs(at - t[i]), np.abs(at - t[i - 1])) < SAME_S
    between = (at >= t[0]) & (at <= t[-1]) & (t[i] - t[i - 1] < MAX_GAP_S)
    known = given | between
    for k, column in enumerate(columns.T):
        out[known, k] = np.interp(at[known], t, column)
    return out


def score(truth: Truth, estimates: Estimates, gate: float, moving_mps: float) -> Score:
    """Errors of the nearest track inside `gate` [m] at each instant of `truth`.

    Tracks are interpolated to the instants. Course and yaw count where the body is faster than `moving_mps`.
    """
    known = np.isfinite(truth.W_p[:, 0])
    best, nearest, ids = _nearest(truth, estimates)
    hit = nearest < gate
    error = best - np.column_stack(
        [truth.W_p, truth.W_v, truth.yaw, np.arctan2(truth.W_v[:, 1], truth.W_v[:, 0])]
    )
    speed = np.hypot(*truth.W_v.T)
    moving = hit & (np.nan_to_num(speed) > moving_mps)
    yaw = np.degrees(wrap(error[moving, 4]))
    used = ids[hit]
    lost = np.flatnonzero(hit[known])
    return Score(
        scans=int(known.sum()),
        present=float(hit.sum() / known.sum()) if known.any() else float("nan"),
        identities=len(np.unique(used)),
        switches=int((used[1:] != used[:-1]).sum()),
        breaks=int((np.diff(lost) > 1).sum()),
        heading_flips=int((np.abs(yaw) > 90.0).sum()),
        position_m=spread(np.hypot(*error[hit, :2].T)),
        velocity_mps=spread(np.hypot(*error[hit, 2:4].T)),
        speed_mps=spread(np.hypot(*best[hit, 2:4].T) - speed[hit]),
        course_deg=spread(np.degrees(wrap(error[moving, 5]))),
        yaw_deg=spread(yaw),
        ids=tuple(dict.fromkeys(used.tolist())),
    )


def _nearest(truth: Truth, estimates: Estimates) -> tuple[Array, Array, Ints]:
    """Of the track nearest to each instant: x, y, vx, vy, yaw, course (m, 6), distance (m,), id (m,)."""
    m = len(truth.t)
    best, nearest, ids = np.full((m, 6), np.nan), np.full(m, np.inf), np.full(m, -1)
    order = np.argsort(estimates.id, kind="stable")
    tracks, starts = np.unique(estimates.id[order], return_index=True)
    for track, rows in zip(tracks, np.split(order, starts[1:]), strict=False):
        e = estimates.rows(rows)
        turns = np.unwrap(np.column_stack([e.yaw, e.course]), axis=0)
        columns = np.column_stack([e.W_p, e.W_v, turns])
        life = slice(*np.searchsorted(truth.t, [e.t[0] - SAME_S, e.t[-1] + SAME_S]))
        values = _interpolate(e.t, columns, truth.t[life])
        d = np.nan_to_num(np.hypot(*(values[:, :2] - truth.W_p[life]).T), nan=np.inf)
        nearer = np.flatnonzero(d < nearest[life]) + life.start
        best[nearer], nearest[nearer], ids[nearer] = (
            values[nearer - life.start],
            d[nearer - life.start],
            track,
        )
    return best, nearest, ids


def spread(error: Array) -> Spread:
    """Root mean square, median and 95 % quantile of the absolute errors; unknown ones are left out."""
    error = np.abs(error[np.isfinite(error)])
    if not len(error):
        return Spread(np.nan, np.nan, np.nan)
    median, p95 = np.quantile(error, [0.5, 0.95])
    return Spread(float(np.sqrt(np.mean(error**2))), float(median), float(p95))


def gospa(truth: Array, estimates: Array, c: float, p: float = 2.0) -> Gospa:
    """Generalised OSPA with alpha = 2 of two sets of points (n, 2) and (m, 2) [m], cut off at c [m].

    Rahmathullah, Garcia-Fernandez and Svensson 2017, eq. 1 and proposition 1.
    """
    from scipy.optimize import linear_sum_assignment

    n, m = len(truth), len(estimates)
    cost = np.minimum(np.linalg.norm(truth[:, None] - estimates[None], axis=-1), c) ** p
    rows, columns = linear_sum_assignment(cost) if n and m else ([], [])
    pairs = cost[rows, columns]
    paired = pairs[pairs < c**p]
    lone = 0.5 * c**p
    near, missed, false = float(paired.sum()), lone * (n - len(paired)), lone * (m - len(paired))
    return Gospa((near + missed + false) ** (1.0 / p), near, missed, false)


def overlap(A_pose: Array, A_extent: Array, B_pose: Array, B_extent: Array) -> Bools:
    """Whether rectangles touch: poses (..., 3) of their centres, extents (..., 2) length, width [m]."""
    a, b = corners(A_pose, A_extent), corners(B_pose, B_extent)
    apart = np.zeros(a.shape[:-2], bool)
    for pose in (np.asarray(A_pose), np.asarray(B_pose)):
        for angle in (pose[..., 2], pose[..., 2] + 0.5 * np.pi):
            axis = np.stack([np.cos(angle), np.sin(angle)], -1)[..., None]
            u, v = (a @ axis)[..., 0], (b @ axis)[..., 0]
            apart |= (u.max(-1) < v.min(-1)) | (v.max(-1) < u.min(-1))
    return ~apart


def lead_time(
    contact: float, alerts: Iterable[tuple[float, int]], ids: Iterable[int], horizon_s: float
) -> float | None:
    """Time from the first alert about one of the tracks `ids` to the contact [s]; None where there was none.

    alerts: time [s] and track of each alert that counts. One earlier than `horizon_s` before the contact is
    about something else.
    """
    wanted = set(ids)
    times = [t for t, track in alerts if track in wanted and contact - horizon_s <= t <= contact]
    return contact - min(times) if times else None
