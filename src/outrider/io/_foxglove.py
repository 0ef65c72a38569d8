"""Frames as Foxglove messages (https://docs.foxglove.dev/docs/sdk/schemas), in Protobuf.

Every message is stamped with the recording's own clock.
"""

from __future__ import annotations

import math

import numpy as np
from foxglove import messages as fg

from outrider.io import _scene
from outrider.io._scene import MAP, Place, Rgba, nanoseconds, say
from outrider.records import Alert, Array, Frame, Level, Scan
from outrider.settings import Settings

LOG_LEVEL = {
    Level.NONE: fg.LogLevel.Info,
    Level.NOTICE: fg.LogLevel.Info,
    Level.CAUTION: fg.LogLevel.Warning,
    Level.DANGER: fg.LogLevel.Error,
}


def _stamp(t: float) -> fg.Timestamp:
    sec, nsec = divmod(nanoseconds(t), 1_000_000_000)
    return fg.Timestamp(sec=sec, nsec=nsec)


def _color(rgba: Rgba) -> fg.Color:
    r, g, b, a = rgba
    return fg.Color(r=r, g=g, b=b, a=a)


def _vector(x: float, y: float, z: float = 0.0) -> fg.Vector3:
    return fg.Vector3(x=x, y=y, z=z)


def _turn(yaw: float) -> fg.Quaternion:
    return fg.Quaternion(x=0.0, y=0.0, z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw))


def _pose(place: Place) -> fg.Pose:
    return fg.Pose(position=_vector(place.x, place.y, place.z), orientation=_turn(place.yaw))


def transforms(t: float, W_body: Array, mount: Array) -> fg.FrameTransforms:
    """Where the body is in `map` and the sensor on the body; both (3,) x, y [m], yaw [rad]."""
    stamp = _stamp(t)
    return fg.FrameTransforms(
        transforms=[
            fg.FrameTransform(
                timestamp=stamp,
                parent_frame_id=parent,
                child_frame_id=child,
                translation=_vector(place.x, place.y),
                rotation=_turn(place.yaw),
            )
            for parent, child, place in _scene.links(W_body, mount)
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
        pose=_pose(Place(float(origin[0]), float(origin[1]), 0.0, 0.0)),
        point_stride=4 * len(names),
        fields=[fg.PackedElementField(name=n, offset=4 * i, type=kind) for i, n in enumerate(names)],
        data=data.tobytes(),
    )


def scene(frame: Frame, settings: Settings, scale: float) -> fg.SceneUpdate:
    """Every track and the rider's footprint, in place of what was shown before; as `_scene.entities`."""
    stamp = _stamp(frame.t)
    everything = fg.SceneEntityDeletion(timestamp=stamp, type=fg.SceneEntityDeletionType.All)
    drawn = [_entity(stamp, entity) for entity in _scene.entities(frame, settings, scale)]
    return fg.SceneUpdate(deletions=[everything], entities=drawn)


def _entity(stamp: fg.Timestamp, entity: _scene.Entity) -> fg.SceneEntity:
    return fg.SceneEntity(
        timestamp=stamp,
        frame_id=entity.frame,
        id=entity.name,
        frame_locked=entity.frame != MAP,
        cubes=[_cube(box) for box in entity.boxes],
        arrows=[_arrow(arrow) for arrow in entity.arrows],
        lines=[_line(line) for line in entity.lines],
        texts=[_text(text) for text in entity.texts],
    )


def _cube(box: _scene.Box) -> fg.CubePrimitive:
    return fg.CubePrimitive(pose=_pose(box.place), size=_vector(*box.size), color=_color(box.color))


def _arrow(arrow: _scene.Arrow) -> fg.ArrowPrimitive:
    (length, diameter), (head, width) = arrow.shaft, arrow.head
    return fg.ArrowPrimitive(
        pose=_pose(arrow.place),
        shaft_length=length,
        shaft_diameter=diameter,
        head_length=head,
        head_diameter=width,
        color=_color(arrow.color),
    )


def _line(line: _scene.Line) -> fg.LinePrimitive:
    kinds = fg.LinePrimitiveLineType
    ground = [fg.Point3(x=x, y=y, z=0.0) for x, y in line.xy.tolist()]
    return fg.LinePrimitive(
        type=kinds.LineLoop if line.closed else kinds.LineStrip,
        thickness=line.pixels,
        scale_invariant=True,
        points=ground,
        color=_color(line.color),
    )


def _text(text: _scene.Text) -> fg.TextPrimitive:
    return fg.TextPrimitive(
        pose=_pose(text.place),
        billboard=True,
        font_size=text.pixels,
        scale_invariant=True,
        color=_color(text.color),
        text=text.words,
    )


def log(alert: Alert) -> fg.Log:
    """The alert in words, as an entry of the log."""
    level = LOG_LEVEL[alert.level]
    return fg.Log(timestamp=_stamp(alert.t), level=level, message=say(alert), name="outrider")
