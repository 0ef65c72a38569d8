"""The street slices of the data set kitti0000, three Parquet files, as one recording."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from outrider.io._recording import POSE_TYPE, SCAN_TYPE, Message, Recording, Topic
from outrider.records import Array, LaserScan, Pose

_FRAME_S = 0.1036  # a turn of the lidar, from distances against the speed of the inertial system
_BINS = 720
_SLICE_M = (2.5, 60.0)  # range limits of the slices


def open_kitti(slices: Path, ego: Path, boxes: Path) -> Recording:
    """A recording whose scans are in the lidar's frame, ego and truth in one fixed frame."""
    import pyarrow.parquet as pq

    columns = ("frame", "type", "track_id", "x_w", "y_w", "yaw_w", "length", "width")
    truth = pq.read_table(boxes, columns=list(columns)).to_pylist()
    ego_rows = pq.read_table(ego, columns=["frame", "x_velo_w", "y_velo_w", "yaw_velo_w"]).to_pylist()
    poses = [_kitti_ego(row) for row in ego_rows] + [_kitti_box(row) for row in truth]
    poses.sort(key=lambda pose: pose.received_ns)
    counts: dict[str, int] = {}
    for pose in poses:
        counts[pose.topic] = counts.get(pose.topic, 0) + 1
    topics = [Topic(name, "pose", POSE_TYPE, count) for name, count in counts.items()]
    topics.append(Topic("/scan", "scan", SCAN_TYPE, pq.read_metadata(slices).num_rows))
    topics.sort(key=lambda topic: topic.name)
    read = partial(_read_kitti, slices, tuple(poses))
    return Recording(slices.parent, "kitti-slices", tuple(topics), (), False, read)


def _read_kitti(slices: Path, poses: tuple[Pose, ...], wanted: frozenset[str]) -> Iterator[Message]:
    """Poses come before the scan of the same instant."""
    used = (pose for pose in poses if pose.topic in wanted)
    scans = _kitti_scans(slices) if "/scan" in wanted else iter(())
    yield from heapq.merge(used, scans, key=lambda message: message.received_ns)


def _kitti_scans(slices: Path) -> Iterator[Message]:
    import pyarrow.parquet as pq

    increment = float(np.float32(2 * np.pi / _BINS))  # as ROS keeps it, so that no conversion changes it
    first = float(np.float32(-np.pi + np.pi / _BINS))  # centre of bin 0
    with pq.ParquetFile(slices) as file:
        for batch in file.iter_batches(16, columns=["frame", "ranges_h085"], use_threads=False):
            frames, ranges = batch.column("frame").to_pylist(), batch.column("ranges_h085")
            for row, frame in enumerate(frames):
                yield LaserScan(
                    topic="/scan",
                    frame="velodyne",
                    stamp_ns=_kitti_ns(frame),
                    received_ns=_kitti_ns(frame),
                    angle_min=first,
                    angle_increment=increment,
                    time_increment=0.0,
                    scan_time=float(np.float32(_FRAME_S)),
                    range_min=_SLICE_M[0],
                    range_max=_SLICE_M[1],
                    ranges=ranges[row].values.to_numpy().astype(np.float32, copy=False),
                    intensities=np.zeros(0, np.float32),
                )


def _kitti_ns(frame: int) -> int:
    return round(frame * _FRAME_S * 1e9)


def _kitti_ego(row: Mapping[str, Any]) -> Pose:
    place = row["x_velo_w"], row["y_velo_w"], row["yaw_velo_w"]
    return _kitti_pose("/ego_pose", "ego", row["frame"], place, np.zeros(0))


def _kitti_box(row: Mapping[str, Any]) -> Pose:
    body = f"{row['type']}_{row['track_id']}"
    place = row["x_w"], row["y_w"], row["yaw_w"]
    return _kitti_pose(f"/truth/{body}", body, row["frame"], place, np.array([row["length"], row["width"]]))


def _kitti_pose(topic: str, body: str, frame: int, place: tuple[float, float, float], extent: Array) -> Pose:
    x, y, yaw = place
    return Pose(
        topic=topic,
        frame="world",
        body=body,
        stamp_ns=_kitti_ns(frame),
        received_ns=_kitti_ns(frame),
        position=np.array([x, y, 0.0]),
        quaternion=np.array([0.0, 0.0, np.sin(0.5 * yaw), np.cos(0.5 * yaw)]),
        extent=extent,
    )
