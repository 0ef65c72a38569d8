"""Frames as Foxglove messages (https://docs.foxglove.dev/docs/sdk/schemas).

Frames of reference: `map` (fixed), `base_link` (the rider's body), `laser` (the sensor on it). Every message
is stamped with the recording's own clock.
"""

from __future__ import annotations

import math

import numpy as np
from foxglove import messages as fg

from outrider.geometry import corners
from outrider.records import Alert, Array, Frame, Level, Scan, Tracks, TrackState
from outrider.settings import Settings
from outrider.threat import predict_arc

MAP, BODY, LASER = "map", "base_link", "laser"
ARC_HORIZON_S, ARC_STEP_S = 3.0, 0.25

# red, green, blue, opacity; Okabe and Ito's palette, which colour-blind readers can tell apart
STATE_COLOR = {
    TrackState.TENTATIVE: (0.34, 0.71, 0.91, 0.35),
    TrackState.CONFIRMED: (0.0, 0.45, 0.70, 0.7),
    TrackState.COASTING: (0.80, 0.47, 0.65, 0.6),
    TrackState.STATIC: (0.6, 0.6, 0.6, 0.3),
}
LEVEL_COLOR = {
    Level.NONE: (0.0, 0.62, 0.45, 0.8),
    Level.NOTICE: (0.94, 0.89, 0.26, 0.8),
    Level.CAUTION: (0.90, 0.62, 0.0, 0.9),
    Level.DANGER: (0.84, 0.37, 0.0, 1.0),
}
LOG_LEVEL = {
    Level.NONE: fg.LogLevel.Info,
    Level.NOTICE: fg.LogLevel.Info,
    Level.CAUTION: fg.LogLevel.Warning,
    Level.DANGER: fg.LogLevel.Error,
}


def nanoseconds(t: float) -> int:
    """Time t [s] as MCAP counts it [ns]; times before zero, which MCAP cannot hold, become zero."""
    return max(round(t * 1e9), 0)


def _stamp(t: float) -> fg.Timestamp:
    sec, nsec = divmod(nanoseconds(t), 1_000_000_000)
    return fg.Timestamp(sec=sec, nsec=nsec)


def _color(rgba: tuple[float, float, float, float]) -> fg.Color:
    r, g, b, a = rgba
    return fg.Color(r=r, g=g, b=b, a=a)


def _vector(x: float, y: float, z: float = 0.0) -> fg.Vector3:
    return fg.Vector3(x=x, y=y, z=z)


def _turn(yaw: float) -> fg.Quaternion:
    return fg.Quaternion(x=0.0, y=0.0, z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw))


def _pose(x: float, y: float, z: float, yaw: float) -> fg.Pose:
    return fg.Pose(position=_vector(x, y, z), orientation=_turn(yaw))


def _line(xy: Array, thickness: float, color: fg.Color, closed: bool = False) -> fg.LinePrimitive:
    """A line through xy (n, 2) on the ground; thickness in pixels."""
    kind = fg.LinePrimitiveLineType.LineLoop if closed else fg.LinePrimitiveLineType.LineStrip
    ground = [fg.Point3(x=x, y=y, z=0.0) for x, y in xy.tolist()]
    return fg.LinePrimitive(type=kind, thickness=thickness, scale_invariant=True, points=ground, color=color)


def transforms(t: float, W_body: Array, mount: Array) -> fg.FrameTransforms:
    """Where the body is in `map` and the sensor on the body; both (3,) x, y [m], yaw [rad]."""
    stamp = _stamp(t)
    links = ((MAP, BODY, W_body), (BODY, LASER, mount))
    return fg.FrameTransforms(
        transforms=[
            fg.FrameTransform(
                timestamp=stamp,
                parent_frame_id=parent,
                child_frame_id=child,
                translation=_vector(float(pose[0]), float(pose[1])),
                rotation=_turn(float(pose[2])),
            )
            for parent, child, pose in links
        ]
    )


def points(scan: Scan) -> fg.PointCloud:
    """The returns of a scan, each placed at its own time, in `map`; counted from the rider to stay exact."""
    origin = scan.ego.W_pose[:2]
    columns = [scan.W_p[scan.valid] - origin]
    names = ["x", "y"]
    if len(scan.intensity) == len(scan.valid):
        columns.append(scan.intensity[scan.valid, None].astype(float))
        names.append("intensity")
    data = np.hstack(columns).astype("<f4")
    kind = fg.PackedElementFieldNumericType.Float32
    return fg.PointCloud(
        timestamp=_stamp(scan.t),
        frame_id=MAP,
        pose=_pose(float(origin[0]), float(origin[1]), 0.0, 0.0),
        point_stride=4 * len(names),
        fields=[fg.PackedElementField(name=n, offset=4 * i, type=kind) for i, n in enumerate(names)],
        data=data.tobytes(),
    )


def _entity(
    stamp: fg.Timestamp, i: int, tracks: Tracks, arc: Array, ttc: float, scale: float
) -> fg.SceneEntity:
    """Box, arrow, predicted path and label of track i; all but the box only where it may move."""
    x, y = tracks.W_p[i].tolist()
    length, width = tracks.extent[i].tolist()
    state, speed = TrackState(int(tracks.state[i])), float(tracks.speed[i])
    color, height, name = _color(STATE_COLOR[state]), 1.5 / scale, f"track {int(tracks.id[i])}"
    box = fg.CubePrimitive(
        pose=_pose(x, y, 0.5 * height, float(tracks.yaw[i])),
        size=_vector(length, width, height),
        color=color,
    )
    if state is TrackState.STATIC:
        return fg.SceneEntity(timestamp=stamp, frame_id=MAP, id=name, cubes=[box])
    arrow = fg.ArrowPrimitive(
        pose=_pose(x, y, height, float(tracks.course[i]) + (math.pi if speed < 0.0 else 0.0)),
        shaft_length=abs(speed),
        shaft_diameter=0.15 / scale,
        head_length=0.5 / scale,
        head_diameter=0.4 / scale,
        color=color,
    )
    label = f"{int(tracks.id[i])}  {abs(speed):.1f} m/s" + (f"  {ttc:.1f} s" if math.isfinite(ttc) else "")
    text = fg.TextPrimitive(
        pose=_pose(x, y, 1.4 * height, 0.0),
        billboard=True,
        font_size=14.0,
        scale_invariant=True,
        color=_color((*STATE_COLOR[state][:3], 1.0)),
        text=label,
    )
    path = _line(arc[:, :2], 2.0, color)
    return fg.SceneEntity(
        timestamp=stamp, frame_id=MAP, id=name, cubes=[box], arrows=[arrow], lines=[path], texts=[text]
    )


def scene(frame: Frame, settings: Settings, scale: float) -> fg.SceneUpdate:
    """Every track and the rider's footprint, in place of what was shown before.

    frame: lengths of the recording; settings: lengths of the full-size world; scale: their ratio.
    """
    stamp, tracks, rider = _stamp(frame.t), frame.tracks, settings.rider
    size = np.array([rider.length_m, rider.width_m]) / scale
    outline = corners(np.array([rider.centre_x_m / scale, 0.0, 0.0]), size)
    footprint = _line(outline, 4.0, _color(LEVEL_COLOR[frame.alert.level]), closed=True)
    entities = [
        fg.SceneEntity(timestamp=stamp, frame_id=BODY, id="rider", frame_locked=True, lines=[footprint])
    ]
    arcs = predict_arc(tracks, ARC_HORIZON_S, ARC_STEP_S)
    for i, ttc in enumerate(frame.threats.ttc.tolist()):
        entities.append(_entity(stamp, i, tracks, arcs[i], ttc, scale))
    everything = fg.SceneEntityDeletion(timestamp=stamp, type=fg.SceneEntityDeletionType.All)
    return fg.SceneUpdate(deletions=[everything], entities=entities)


def say(alert: Alert) -> str:
    """The alert in words, one line."""
    text = alert.level.name.lower()
    if alert.track >= 0:
        text += f": track {alert.track}" + (f" in {alert.ttc:.1f} s" if np.isfinite(alert.ttc) else "")
    return text + (f" (degraded: {', '.join(alert.degraded)})" if alert.degraded else "")


def log(alert: Alert) -> fg.Log:
    """The alert in words, as an entry of the log."""
    level = LOG_LEVEL[alert.level]
    return fg.Log(timestamp=_stamp(alert.t), level=level, message=say(alert), name="outrider")
