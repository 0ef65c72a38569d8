"""What the page draws, as bytes: a JSON head, then columns of float32.

Everything that may be infinite or not a number lies in the columns, which JSON could not hold. Places in them
are counted from the rider, in W, so that float32 is exact enough; the head says where the rider is.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any, NamedTuple

import msgspec
import numpy as np

from outrider.contact import Body
from outrider.interval import apart
from outrider.records import Alert, Array, Ego, Frame, Tracks, TrackState
from outrider.settings import Settings
from outrider.threat import predict_arc

ARC_S, STEP_S = 3.0, 0.25  # how far ahead paths are shown, and between two poses of a path
COLUMNS = (
    *("x", "y", "yaw", "course", "speed", "length", "width", "hits"),
    *("ttc", "earliest", "latest", "bound_position", "bound_speed", "broken"),
)  # of a track, SI units
ARRAYS = ("points", "tracks", "arcs")


class Picture(NamedTuple):
    """One instant, lengths of the full-size world."""

    ego: Ego
    points: Array  # (n, 2) returns, W [m]
    tracks: Tracks
    times: Array  # (m, 3) time to collision of each track: expected, earliest, latest [s]
    alert: Alert


def picture(frame: Frame) -> Picture:
    """What of a frame is drawn."""
    scan, threats = frame.scan, frame.threats
    times = np.column_stack([threats.ttc, threats.ttc_earliest, threats.ttc_latest])
    return Picture(scan.ego, scan.W_p[scan.valid], frame.tracks, times, frame.alert)


def pack(shown: Picture, **more: Any) -> bytes:
    """The message: size of the head (uint32), head, columns; all little-endian, columns from a multiple of 4.

    The head names the columns and their shapes in order: `points` (n, 2), `tracks` (m, len(COLUMNS)), `arcs`
    (m, k, 4) with x, y [m], yaw [rad] and how far off the centre may be [m]. `more` is added to it.
    """
    ego, tracks, alert = shown.ego, shown.tracks, shown.alert
    origin = np.nan_to_num(ego.W_pose[:2], posinf=0.0, neginf=0.0)
    with np.errstate(over="ignore", invalid="ignore"):  # what float32 cannot hold becomes infinite
        columns = (shown.points - origin, _rows(shown, origin), _arcs(tracks, origin))
        arrays = {name: a.astype("<f4") for name, a in zip(ARRAYS, columns, strict=True)}
    head = {
        "t": ego.t,
        "ego": [*origin, ego.W_pose[2], *ego.W_v, ego.yaw_rate],
        "known": ego.known,
        "id": tracks.id.tolist(),
        "state": tracks.state.tolist(),
        "level": int(alert.level),
        "track": int(alert.track),
        "ttc": alert.ttc if np.isfinite(alert.ttc) else None,
        "degraded": alert.degraded,
        "arrays": [[name, *a.shape] for name, a in arrays.items()],
        **more,
    }
    text = msgspec.json.encode(head, enc_hook=float)  # what is not finite becomes null
    text += b" " * (-len(text) % 4)
    return b"".join([struct.pack("<I", len(text)), text, *(a.tobytes() for a in arrays.values())])


def _rows(shown: Picture, origin: Array) -> Array:
    """(m, len(COLUMNS)) the tracks."""
    tracks = shown.tracks
    return np.column_stack([
        tracks.W_p - origin, tracks.yaw, tracks.course, tracks.speed, tracks.extent, tracks.hits,
        shown.times, tracks.bound, tracks.broken,
    ])  # fmt: skip


def _arcs(tracks: Tracks, origin: Array) -> Array:
    """(m, k, 4) predicted poses, and how far off they may be; infinite without a bound."""
    poses = predict_arc(tracks, ARC_S, STEP_S)
    poses[..., :2] -= origin
    t = np.linspace(0.0, ARC_S, poses.shape[1])
    off = np.full(poses.shape[:2], np.inf)
    for i in np.flatnonzero(np.isfinite(tracks.bound).all(axis=1) & (tracks.state != TrackState.STATIC)):
        body = Body(*np.zeros(len(Body._fields)))
        body = body._replace(speed=tracks.speed[i], acceleration=tracks.acceleration[i])
        p, v, a = apart(body, *tracks.bound[i])
        off[i] = p + (v + 0.5 * a * t) * t
    return np.concatenate([poses, off[..., None]], axis=-1)


def hello(settings: Settings, about: Mapping[str, Any], **more: Any) -> bytes:
    """The first message, JSON: what does not change while the page is open."""
    rider, threat, alert = settings.rider, settings.threat, settings.alert
    return msgspec.json.encode({
        "rider": [rider.length_m, rider.width_m, rider.centre_x_m],
        "corridor": threat.corridor_width_m,
        "horizon": threat.horizon_s,
        "ladder": [alert.notice_s, alert.caution_s, alert.danger_s],
        "stale": alert.stale_after_s,
        "act_on": alert.act_on,
        "arc": [ARC_S, STEP_S],
        "columns": COLUMNS,
        "about": {name: str(value) for name, value in about.items() if isinstance(value, str | int | float)},
        **more,
    })  # fmt: skip
