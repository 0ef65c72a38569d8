"""Tracks -> threats: when, where and how hard each road user would touch the rider.

Both bodies are rectangles on arcs: motion and search are in contact.py, the method in docs/warnings.md.
"""

from __future__ import annotations

import numpy as np

from outrider import settings
from outrider.compiler import compiled
from outrider.contact import (
    TICK,
    Body,
    Mover,
    closest,
    enters_corridor,
    first_contact,
    gap_at,
    pose_at,
    required_deceleration,
)
from outrider.errors import InputError
from outrider.interval import apart, earliest, latest
from outrider.kernel import from_row
from outrider.records import Array, Bools, Ego, Ints, Threats, Tracks, TrackState

HUGE = 1e9  # a state beyond this, in SI units, is as good as infinite


def assess(tracks: Tracks, ego: Ego, rider: settings.Rider, threat: settings.Threat) -> Threats:
    """How near each track comes to the rider's rectangle with its margin, within `threat.horizon_s`.

    A track that is STATIC is taken as standing. A row that cannot be assessed (a non-finite state, of the
    track or of the rider) has ttc and closest_distance inf: no other row has an infinite closest_distance.
    ttc_earliest and ttc_latest hold for every place and velocity within the track's bound; without a bound
    they are 0 and inf.

    Raises InputError for a horizon, step, corridor or size that is not positive.
    """
    _check(rider, threat)
    bodies, finite = _bodies(tracks)
    mover = np.array(_mover(ego, rider))
    finite &= bool((np.abs(mover) < HUGE).all())
    out = np.zeros((len(tracks.id), 8))
    out[:, [0, 1, 7]] = np.inf
    half, columns = 0.5 * threat.corridor_width_m, np.column_stack(bodies)
    _assess(columns, mover, finite, threat.horizon_s, threat.step_s, half, out)
    bounded = finite & np.isfinite(tracks.bound).all(axis=1)
    if bounded.any():
        _between(columns, mover, np.flatnonzero(bounded), tracks.bound, threat.horizon_s, out)
    ttc, distance, time, braking, inside, closing, first, last = out.T.copy()
    return Threats(tracks.t, tracks.id, ttc, distance, time, braking, inside > 0.5, closing, first, last)


def predict_arc(tracks: Tracks, horizon_s: float, step_s: float) -> Array:
    """Poses (n, m, 3) x, y [m], yaw [rad, not wrapped] of the bodies 0, step_s ... horizon_s after tracks.t.

    m = 1 + round(horizon_s / step_s). A row whose state is not finite is NaN.
    """
    bodies, finite = _bodies(tracks)
    t = np.linspace(0.0, horizon_s, 1 + round(horizon_s / step_s))
    poses = np.stack(pose_at(Body(*(column[:, None] for column in bodies)), t[None, :]), axis=-1)
    poses[~finite] = np.nan
    return poses


def _check(rider: settings.Rider, threat: settings.Threat) -> None:
    for section, name in [
        (threat, "horizon_s"), (threat, "step_s"), (threat, "corridor_width_m"),
        (rider, "length_m"), (rider, "width_m"),
    ]:  # fmt: skip
        value = getattr(section, name)
        if not 0.0 < value < np.inf:
            raise InputError(f"{type(section).__name__.lower()}.{name} is {value}: want a positive number")


def _bodies(tracks: Tracks) -> tuple[Body, Bools]:
    """The targets as columns (n,), and which rows are finite; the others are replaced by zeros."""
    moving = tracks.state != TrackState.STATIC
    rows = np.column_stack([
        tracks.W_p, tracks.yaw, tracks.course, np.where(moving, tracks.speed, 0.0),
        np.where(moving, tracks.acceleration, 0.0), np.where(moving, tracks.yaw_rate, 0.0), tracks.extent,
    ])  # fmt: skip
    finite = (np.abs(rows) < HUGE).all(axis=1)
    rows = np.where(finite[:, None], rows, 0.0) + 0.0  # no negative zero: its sign would mean reversing
    x, y, yaw, course, v, a, yaw_rate, length, width = rows.T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        tightest = np.where(length > 0.0, 1.0 / length, 0.0)  # no path is tighter than the body is long
        curvature = np.where(v == 0.0, 0.0, np.clip(yaw_rate / v, -tightest, tightest))
        braking = (v * a < 0.0) | ((v == 0.0) & (a < 0.0))
        stop = np.where(braking, -v / a, np.inf)
    return Body(x, y, yaw, course, v, a, curvature, stop, 0.5 * length, 0.5 * width), finite


def _mover(ego: Ego, rider: settings.Rider) -> Mover:
    x, y, yaw = ego.W_pose
    speed = np.hypot(*ego.W_v)
    course = np.arctan2(ego.W_v[1], ego.W_v[0]) if speed > 0.0 else yaw
    half_length, half_width = 0.5 * rider.length_m + rider.margin_m, 0.5 * rider.width_m + rider.margin_m
    return Mover(x, y, yaw, course, speed, ego.yaw_rate, rider.centre_x_m, half_length, half_width)


@compiled
def _assess(
    bodies: Array, mover: Array, finite: Bools, horizon: float, step: float, half: float, out: Array
) -> None:
    """Fill out[:, :6]: ttc, closest distance, its time, braking, in corridor (0 or 1), closing speed."""
    r = from_row(Mover, mover)
    for i in range(len(bodies)):
        if not finite[i]:
            continue
        b = from_row(Body, bodies[i])
        now = gap_at(b, r, 0.0)
        ttc = first_contact(b, r, horizon, TICK)
        distance, when = (0.0, ttc) if ttc < np.inf else closest(b, r, horizon, step)
        if now <= 0.0:
            closing = (now - gap_at(b, r, TICK)) / TICK
        else:
            closing = (now - distance) / when if when > 0.0 else 0.0
        out[i, 0], out[i, 1], out[i, 2] = ttc, distance, when
        out[i, 3] = required_deceleration(b, r, ttc, horizon)
        out[i, 4] = 1.0 if enters_corridor(b, r, half, horizon, step) else 0.0
        out[i, 5] = closing


@compiled
def _between(bodies: Array, mover: Array, rows: Ints, bound: Array, horizon: float, out: Array) -> None:
    """Fill out[rows, 6:8]: earliest and latest time to collision."""
    r = from_row(Mover, mover)
    for i in rows:
        b = from_row(Body, bodies[i])
        e = apart(b, bound[i, 0], bound[i, 1])
        out[i, 6], out[i, 7] = earliest(b, r, horizon, e), latest(b, r, horizon, e)
