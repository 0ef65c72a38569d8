"""ROS messages <-> records, for ROS 1 and ROS 2, by rosbags' type stores: no ROS is needed.

The definitions of the types below have not changed on the wire since they exist (a Marker's has: it is only
read where outrider wrote it), so the definitions that a recording may carry are not needed, and types
that nobody knows do not hurt.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from outrider.errors import InputError
from outrider.io._recording import ODOMETRY_TYPE, POSE_TYPE, SCAN_TYPE, Message
from outrider.records import LaserScan, Pose

ECHO_TYPE = "sensor_msgs/msg/MultiEchoLaserScan"
COVARIANCE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM_TYPE = "geometry_msgs/msg/TransformStamped"
MARKER_TYPE = "visualization_msgs/msg/Marker"
SCAN_TYPES = (SCAN_TYPE, ECHO_TYPE)
POSE_TYPES = (POSE_TYPE, COVARIANCE_TYPE, TRANSFORM_TYPE, ODOMETRY_TYPE)

MARKER_TEXT = "outrider: body of known size"  # tells our markers from those drawn for other reasons
MARKER_HEIGHT = 1.5  # only for the eye [m]
NS = 10**9
LAST_NS = 2**31 * NS  # ROS keeps seconds in 32 bits, until 2038


def kind_of(ros_type: str) -> str:
    """ "scan", "pose" or "other" of a ROS type name."""
    return "scan" if ros_type in SCAN_TYPES else "pose" if ros_type in POSE_TYPES else "other"


@cache
def codec(generation: int) -> Codec:
    """Reader and writer of single messages of ROS 1 or ROS 2."""
    return Codec(generation)


class Codec:
    """Bytes of one message <-> record; `generation` is 1 or 2."""

    def __init__(self, generation: int) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.generation = generation
        self.store = get_typestore(Stores.ROS1_NOETIC if generation == 1 else Stores.ROS2_HUMBLE)

    def load(self, data: bytes, ros_type: str) -> Any:
        """The message as rosbags gives it."""
        store = self.store
        return (
            store.deserialize_ros1(data, ros_type)
            if self.generation == 1
            else store.deserialize_cdr(data, ros_type)
        )

    def decode(self, data: bytes, ros_type: str, topic: str, received_ns: int) -> Message:
        """The record of one message whose type is one of SCAN_TYPES, POSE_TYPES or our own MARKER_TYPE."""
        message = self.load(data, ros_type)
        return (_scan if ros_type in SCAN_TYPES else _pose)(message, ros_type, topic, received_ns)

    def is_body(self, data: bytes) -> bool:
        """Whether these bytes are a marker that outrider wrote for a pose whose extent is known."""
        try:
            return bool(self.load(data, MARKER_TYPE).text == MARKER_TEXT)
        except Exception:  # a marker as another ROS release defines it
            return False

    def definition(self, ros_type: str) -> str:
        """The type's definition and those of all it is made of."""
        return str(self.store.generate_msgdef(ros_type, ros_version=self.generation)[0])

    def encode(self, message: Message, types: Mapping[str, str]) -> tuple[str, bytes]:
        """Type and bytes of a record; `types` says which pose topics are odometry."""
        for stamp in (message.stamp_ns, message.received_ns):
            if not 0 <= stamp < LAST_NS:
                raise InputError(
                    f"{message.topic}: time {stamp} ns; ROS and MCAP want 1970 to 2038; use .parquet or .csv"
                )
        if not message.topic:
            raise InputError("message without topic; ROS bags and MCAP want one, such as /scan")
        if isinstance(message, LaserScan):
            ros_type, made = SCAN_TYPE, self._make_scan(message)
        else:
            ros_type, made = self._make_pose(message, types.get(message.topic, ""))
        store = self.store
        data = (
            store.serialize_ros1(made, ros_type)
            if self.generation == 1
            else store.serialize_cdr(made, ros_type)
        )
        return ros_type, bytes(data)

    def _type(self, name: str) -> Any:
        package, _, base = name.partition("/")
        return self.store.types[f"{package}/msg/{base}"]

    def _header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self._type("builtin_interfaces/Time")(sec=stamp_ns // NS, nanosec=stamp_ns % NS)
        sequence = {"seq": 0} if self.generation == 1 else {}
        return self._type("std_msgs/Header")(stamp=stamp, frame_id=frame, **sequence)

    def _make_scan(self, scan: LaserScan) -> Any:
        return self._type("sensor_msgs/LaserScan")(
            header=self._header(scan.stamp_ns, scan.frame),
            angle_min=scan.angle_min,
            angle_max=scan.angle_min + scan.angle_increment * max(len(scan.ranges) - 1, 0),
            angle_increment=scan.angle_increment,
            time_increment=scan.time_increment,
            scan_time=scan.scan_time,
            range_min=scan.range_min,
            range_max=scan.range_max,
            ranges=np.ascontiguousarray(scan.ranges, np.float32),
            intensities=np.ascontiguousarray(scan.intensities, np.float32),
        )

    def _make_pose(self, pose: Pose, ros_type: str) -> tuple[str, Any]:
        header = self._header(pose.stamp_ns, pose.frame)
        place = self._type("geometry_msgs/Point")(*map(float, pose.position))
        turn = self._type("geometry_msgs/Quaternion")(*map(float, pose.quaternion))
        geometry = self._type("geometry_msgs/Pose")(position=place, orientation=turn)
        if len(pose.extent):
            return MARKER_TYPE, self._make_marker(pose, header, geometry)
        if ros_type == ODOMETRY_TYPE:
            return ODOMETRY_TYPE, self._make_odometry(pose, header, geometry)
        if pose.body:
            shift = self._type("geometry_msgs/Vector3")(*map(float, pose.position))
            move = self._type("geometry_msgs/Transform")(translation=shift, rotation=turn)
            made = self._type("geometry_msgs/TransformStamped")(
                header, child_frame_id=pose.body, transform=move
            )
            return TRANSFORM_TYPE, made
        return POSE_TYPE, self._type("geometry_msgs/PoseStamped")(header=header, pose=geometry)

    def _make_odometry(self, pose: Pose, header: Any, geometry: Any) -> Any:
        zero = self._type("geometry_msgs/Vector3")(0.0, 0.0, 0.0)
        twist = self._type("geometry_msgs/Twist")(linear=zero, angular=zero)
        unknown = np.zeros(36)
        return self._type("nav_msgs/Odometry")(
            header=header,
            child_frame_id=pose.body,
            pose=self._type("geometry_msgs/PoseWithCovariance")(pose=geometry, covariance=unknown),
            twist=self._type("geometry_msgs/TwistWithCovariance")(twist=twist, covariance=unknown),
        )

    def _make_marker(self, pose: Pose, header: Any, geometry: Any) -> Any:
        length, width = map(float, pose.extent)
        Marker = self._type("visualization_msgs/Marker")
        given: dict[str, Any] = {
            "header": header,
            "ns": pose.body,
            "id": 0,
            "type": Marker.CUBE,
            "action": Marker.ADD,
            "pose": geometry,
            "scale": self._type("geometry_msgs/Vector3")(length, width, MARKER_HEIGHT),
            "color": self._type("std_msgs/ColorRGBA")(0.2, 0.7, 0.3, 0.5),
            "lifetime": self._type("builtin_interfaces/Duration")(0, 0),
            "frame_locked": False,
            "points": [],
            "colors": [],
            "text": MARKER_TEXT,
            "mesh_resource": "",
            "mesh_use_embedded_materials": False,
        }
        if self.generation == 2:
            nothing = np.zeros(0, np.uint8)
            empty = self._header(0, "")
            image = self._type("sensor_msgs/CompressedImage")(header=empty, format="", data=nothing)
            mesh = self._type("visualization_msgs/MeshFile")(filename="", data=nothing)
            given |= {"texture_resource": "", "texture": image, "uv_coordinates": [], "mesh_file": mesh}
        return Marker(**given)


def _stamp(header: Any) -> int:
    return int(header.stamp.sec) * NS + int(header.stamp.nanosec)


def _scan(message: Any, ros_type: str, topic: str, received_ns: int) -> LaserScan:
    ranges, intensities = message.ranges, message.intensities
    if ros_type == ECHO_TYPE:  # the first echo of each beam
        ranges = [beam.echoes[0] if len(beam.echoes) else np.inf for beam in ranges]
        intensities = [beam.echoes[0] if len(beam.echoes) else 0.0 for beam in intensities]
    return LaserScan(
        topic=topic,
        frame=message.header.frame_id,
        stamp_ns=_stamp(message.header),
        received_ns=received_ns,
        angle_min=float(message.angle_min),
        angle_increment=float(message.angle_increment),
        time_increment=float(message.time_increment),
        scan_time=float(message.scan_time),
        range_min=float(message.range_min),
        range_max=float(message.range_max),
        ranges=np.ascontiguousarray(ranges, np.float32),
        intensities=np.ascontiguousarray(intensities, np.float32),
    )


def _pose(message: Any, ros_type: str, topic: str, received_ns: int) -> Pose:
    body, extent = getattr(message, "child_frame_id", ""), np.zeros(0)
    if ros_type == TRANSFORM_TYPE:
        place, turn = message.transform.translation, message.transform.rotation
    else:
        pose = message.pose.pose if ros_type in (ODOMETRY_TYPE, COVARIANCE_TYPE) else message.pose
        place, turn = pose.position, pose.orientation
    if ros_type == MARKER_TYPE:
        body, extent = message.ns, np.array([message.scale.x, message.scale.y])
    return Pose(
        topic=topic,
        frame=message.header.frame_id,
        body=body,
        stamp_ns=_stamp(message.header),
        received_ns=received_ns,
        position=np.array([place.x, place.y, place.z]),
        quaternion=np.array([turn.x, turn.y, turn.z, turn.w]),
        extent=extent,
    )
