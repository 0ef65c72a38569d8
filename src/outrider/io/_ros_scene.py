"""Frames as ROS 2 messages: what `ros2 bag play` can play, and Foxglove opens as it is.

A bag plays only where all its channels are CDR; so the Foxglove scene is written as the ROS package
`foxglove_msgs` defines it. Where that package is absent, the player leaves out this one topic.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import msgspec
import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from outrider.io import _scene
from outrider.io._run_mcap import track_rows
from outrider.io._run_rows import alert_row
from outrider.io._scene import Place, Rgba, nanoseconds
from outrider.records import Alert, Array, Frame, Level, Raw
from outrider.settings import Settings

# Fields of foxglove_msgs that have been the same since release 2.1 (2022); P: its prefix.
PRIMITIVES = {
    "Color": "float64 r\nfloat64 g\nfloat64 b\nfloat64 a",
    "KeyValuePair": "string key\nstring value",
    "ArrowPrimitive": "geometry_msgs/Pose pose\nfloat64 shaft_length\nfloat64 shaft_diameter\n"
    "float64 head_length\nfloat64 head_diameter\nP/Color color",
    "CubePrimitive": "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 size\nP/Color color",
    "SpherePrimitive": "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 size\nP/Color color",
    "CylinderPrimitive": "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 size\n"
    "float64 bottom_scale\nfloat64 top_scale\nP/Color color",
    "LinePrimitive": "uint8 LINE_STRIP=0\nuint8 LINE_LOOP=1\nuint8 LINE_LIST=2\nuint8 type\n"
    "geometry_msgs/Pose pose\nfloat64 thickness\nbool scale_invariant\ngeometry_msgs/Point[] points\n"
    "P/Color color\nP/Color[] colors\nuint32[] indices",
    "TriangleListPrimitive": "geometry_msgs/Pose pose\ngeometry_msgs/Point[] points\n"
    "P/Color color\nP/Color[] colors\nuint32[] indices",
    "TextPrimitive": "geometry_msgs/Pose pose\nbool billboard\nfloat64 font_size\nbool scale_invariant\n"
    "P/Color color\nstring text",
    "ModelPrimitive": "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nP/Color color\n"
    "bool override_color\nstring url\nstring media_type\nuint8[] data",
    "SceneEntityDeletion": "uint8 MATCHING_ID=0\nuint8 ALL=1\nbuiltin_interfaces/Time timestamp\n"
    "uint8 type\nstring id",
    "SceneEntity": "builtin_interfaces/Time timestamp\nstring frame_id\nstring id\n"
    "builtin_interfaces/Duration lifetime\nbool frame_locked\nP/KeyValuePair[] metadata\n"
    "P/ArrowPrimitive[] arrows\nP/CubePrimitive[] cubes\nP/SpherePrimitive[] spheres\n"
    "P/CylinderPrimitive[] cylinders\nP/LinePrimitive[] lines\nP/TriangleListPrimitive[] triangles\n"
    "P/TextPrimitive[] texts\nP/ModelPrimitive[] models",
    "SceneUpdate": "P/SceneEntityDeletion[] deletions\nP/SceneEntity[] entities",
}
TYPES = {  # topic -> its type
    "/tf": "tf2_msgs/msg/TFMessage",
    "/scene": "foxglove_msgs/msg/SceneUpdate",
    "/alerts": "rcl_interfaces/msg/Log",
    "/alert": "std_msgs/msg/String",
    "/tracks": "std_msgs/msg/String",
    "/lidar/bytes": "std_msgs/msg/UInt8MultiArray",
}
NS = 1_000_000_000


@cache
def types() -> Any:
    """The type store of ROS 2 with the scene's types in it."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, fields in PRIMITIVES.items():
        text = fields.replace("P/", "foxglove_msgs/")
        store.register(get_types_from_msg(text, f"foxglove_msgs/msg/{name}"))
    return store


def definition(topic: str) -> str:
    """Definition of a topic's type and of all it is made of."""
    return str(types().generate_msgdef(TYPES[topic], ros_version=2)[0])


def encoded(topic: str, message: Any) -> bytes:
    """The message as CDR."""
    return bytes(types().serialize_cdr(message, TYPES[topic]))


def frame_messages(frame: Frame, settings: Settings, scale: float, mount: Array) -> dict[str, bytes]:
    """Topic -> message of one frame, lengths of the recording; mount (3,) of the sensor [m, m, rad]."""
    alert = {**alert_row(frame.alert), "number": int(frame.alert.level)}
    made = {
        "/tf": _transforms(frame.t, frame.scan.ego.W_pose, mount),
        "/scene": _scene_update(frame, settings, scale),
        "/alert": _json(alert),
        "/tracks": _json(track_rows(frame)),
    }
    return {topic: encoded(topic, message) for topic, message in made.items()}


def log_message(alert: Alert) -> bytes:
    """The alert in words, for /alerts."""
    level = {Level.CAUTION: 30, Level.DANGER: 40}.get(alert.level, 20)
    words = {"name": "outrider", "msg": _scene.say(alert), "file": "", "function": "", "line": 0}
    return encoded("/alerts", _type("rcl_interfaces/Log")(stamp=_time(alert.t), level=level, **words))


def raw_message(raw: Raw) -> bytes:
    """Bytes of the sensor as they came, for /lidar/bytes."""
    layout = _type("std_msgs/MultiArrayLayout")(dim=[], data_offset=0)
    data = np.frombuffer(raw.data, np.uint8)
    return encoded("/lidar/bytes", _type("std_msgs/UInt8MultiArray")(layout=layout, data=data))


def raw_of(data: bytes, received_ns: int) -> Raw:
    """The bytes of a sensor from a message of /lidar/bytes."""
    message = types().deserialize_cdr(data, TYPES["/lidar/bytes"])
    return Raw(received_ns / NS, bytes(message.data))  # the very float that was written: ns are finer


def _type(name: str) -> Any:
    package, _, base = name.partition("/")
    return types().types[f"{package}/msg/{base}"]


def _foxglove(name: str, **fields: Any) -> Any:
    return _type(f"foxglove_msgs/{name}")(**fields)


def _json(values: dict[str, Any]) -> Any:
    return _type("std_msgs/String")(data=msgspec.json.encode(values).decode())


def _time(t: float) -> Any:
    sec, nanosec = divmod(nanoseconds(t), NS)
    return _type("builtin_interfaces/Time")(sec=sec, nanosec=nanosec)


def _vector(x: float, y: float, z: float) -> Any:
    return _type("geometry_msgs/Vector3")(x=x, y=y, z=z)


def _point(x: float, y: float, z: float) -> Any:
    return _type("geometry_msgs/Point")(x=x, y=y, z=z)


def _yaw(yaw: float) -> Any:
    return _type("geometry_msgs/Quaternion")(x=0.0, y=0.0, z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw))


def _pose(place: Place) -> Any:
    position = _point(place.x, place.y, place.z)
    return _type("geometry_msgs/Pose")(position=position, orientation=_yaw(place.yaw))


def _color(rgba: Rgba) -> Any:
    r, g, b, a = rgba
    return _foxglove("Color", r=r, g=g, b=b, a=a)


def _transforms(t: float, W_body: Array, mount: Array) -> Any:
    made = []
    for parent, child, place in _scene.links(W_body, mount):
        header = _type("std_msgs/Header")(stamp=_time(t), frame_id=parent)
        shift = _vector(place.x, place.y, place.z)
        moved = _type("geometry_msgs/Transform")(translation=shift, rotation=_yaw(place.yaw))
        stamped = _type("geometry_msgs/TransformStamped")
        made.append(stamped(header=header, child_frame_id=child, transform=moved))
    return _type("tf2_msgs/TFMessage")(transforms=made)


def _scene_update(frame: Frame, settings: Settings, scale: float) -> Any:
    stamp = _time(frame.t)
    everything = _foxglove("SceneEntityDeletion", timestamp=stamp, type=1, id="")
    drawn = [_entity(stamp, entity) for entity in _scene.entities(frame, settings, scale)]
    return _foxglove("SceneUpdate", deletions=[everything], entities=drawn)


def _entity(stamp: Any, entity: _scene.Entity) -> Any:
    return _foxglove(
        "SceneEntity",
        timestamp=stamp,
        frame_id=entity.frame,
        id=entity.name,
        lifetime=_type("builtin_interfaces/Duration")(sec=0, nanosec=0),
        frame_locked=entity.frame != _scene.MAP,
        metadata=[],
        arrows=[_arrow(arrow) for arrow in entity.arrows],
        cubes=[_cube(box) for box in entity.boxes],
        spheres=[],
        cylinders=[],
        lines=[_line(line) for line in entity.lines],
        triangles=[],
        texts=[_text(text) for text in entity.texts],
        models=[],
    )


def _arrow(arrow: _scene.Arrow) -> Any:
    (length, diameter), (head, width) = arrow.shaft, arrow.head
    sizes = {"shaft_length": length, "shaft_diameter": diameter, "head_length": head, "head_diameter": width}
    return _foxglove("ArrowPrimitive", pose=_pose(arrow.place), color=_color(arrow.color), **sizes)


def _cube(box: _scene.Box) -> Any:
    return _foxglove("CubePrimitive", pose=_pose(box.place), size=_vector(*box.size), color=_color(box.color))


def _line(line: _scene.Line) -> Any:
    return _foxglove(
        "LinePrimitive",
        type=int(line.closed),
        pose=_pose(Place(0.0, 0.0, 0.0, 0.0)),
        thickness=line.pixels,
        scale_invariant=True,
        points=[_point(x, y, 0.0) for x, y in line.xy.tolist()],
        color=_color(line.color),
        colors=[],
        indices=np.zeros(0, np.uint32),
    )


def _text(text: _scene.Text) -> Any:
    return _foxglove(
        "TextPrimitive",
        pose=_pose(text.place),
        billboard=True,
        font_size=text.pixels,
        scale_invariant=True,
        color=_color(text.color),
        text=text.words,
    )
