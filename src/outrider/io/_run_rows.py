"""What of a frame goes into the tables of a run folder, in the lengths of the recording."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from outrider.records import Alert, Frame, Tracks, TrackState

STATES = np.array([state.name.lower() for state in TrackState], dtype=object)


def in_recording_lengths(frame: Frame, scale: float) -> Frame:
    """The frame with every length that is reported divided by scale (full-size length / recorded length)."""
    if scale == 1.0:
        return frame
    s, ego, threats = 1.0 / scale, frame.scan.ego, frame.threats
    ego = replace(ego, W_pose=ego.W_pose * [s, s, 1.0], W_v=ego.W_v * s)
    scan = replace(frame.scan, W_p=frame.scan.W_p * s, ego=ego)
    threats = replace(
        threats,
        closest_distance=threats.closest_distance * s,
        required_deceleration=threats.required_deceleration * s,
        closing_speed=threats.closing_speed * s,
    )
    lagged = None if frame.lagged is None else _resized(frame.lagged, s)
    return replace(frame, scan=scan, tracks=_resized(frame.tracks, s), threats=threats, lagged=lagged)


def _resized(tracks: Tracks, s: float) -> Tracks:
    """The tracks with every length times s."""
    return replace(
        tracks,
        W_p=tracks.W_p * s,
        speed=tracks.speed * s,
        acceleration=tracks.acceleration * s,
        extent=tracks.extent * s,
        cov=tracks.cov * s**2,
        bound=tracks.bound * s,
    )


def tracks_columns(frame: Frame) -> dict[str, Any]:
    """The rows of TRACKS that one frame gives: a column (n,) each."""
    times = {name: getattr(frame.threats, name) for name in ("ttc", "ttc_earliest", "ttc_latest")}
    return {**track_columns(frame.tracks), **times}


def track_columns(tracks: Tracks) -> dict[str, Any]:
    """The rows of LAGGED that some tracks give, and those of TRACKS but for times to collision, (n,) each."""
    (x, y), (vx, vy), (length, width) = tracks.W_p.T, tracks.W_v.T, tracks.extent.T
    columns = {"t": np.full(len(x), tracks.t), "track_id": tracks.id, "x": x, "y": y, "vx": vx, "vy": vy}
    for name in ("speed", "acceleration", "course", "yaw", "slip", "yaw_rate", "hits"):
        columns[name] = getattr(tracks, name)
    return {
        **columns,
        "length": length,
        "width": width,
        "bound_position": tracks.bound[:, 0],
        "bound_speed": tracks.bound[:, 1],
        "bound_course": tracks.course_bound,
        "state": STATES[tracks.state],
    }


def scan_columns(frame: Frame) -> dict[str, Any]:
    """The row of SCANS that one frame gives: columns (1,)."""
    scan, ego = frame.scan, frame.scan.ego
    (x, y, yaw), (vx, vy) = ego.W_pose, ego.W_v
    row = {"t": frame.t, "ego_x": x, "ego_y": y, "ego_yaw": yaw, "ego_vx": vx, "ego_vy": vy}
    row |= {"ego_yaw_rate": ego.yaw_rate, "ego_known": ego.known}
    row |= {
        "beams": len(scan.valid),
        "valid": int(scan.valid.sum()),
        "detections": len(frame.detections.hits),
    }
    row |= {"tracks": len(frame.tracks.id), "level": frame.alert.level.name.lower()}
    return {name: [value] for name, value in row.items()}


def alert_row(alert: Alert) -> dict[str, Any]:
    """The alert as a line of alerts.jsonl: level by name; None for no track and no contact ahead."""
    return {
        "t": float(alert.t),
        "level": alert.level.name.lower(),
        "track_id": int(alert.track) if alert.track >= 0 else None,
        "ttc": float(alert.ttc) if np.isfinite(alert.ttc) else None,
        "degraded": list(alert.degraded),
    }
