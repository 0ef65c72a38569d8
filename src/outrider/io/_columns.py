"""The columns shared by Parquet and CSV (docs/formats.md), and messages written as rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from outrider.io._recording import ODOMETRY_TYPE, POSE_TYPE, SCAN_TYPE, Message
from outrider.records import LaserScan

TYPES = {"scan": SCAN_TYPE, "pose": POSE_TYPE, "odometry": ODOMETRY_TYPE}  # by the value of `kind`

WORDS = ("kind", "topic", "frame", "body")
STAMPS = ("stamp_ns", "received_ns")
ANGLES = ("angle_min", "angle_increment")
TIMES_AND_LIMITS = {"time_increment": 0.0, "scan_time": 0.0, "range_min": 0.0, "range_max": np.inf}  # default
LISTS = ("ranges", "intensities")
PLACE = ("x", "y", "z")
TURN = ("qx", "qy", "qz", "qw")
EXTENT = ("length", "width")
NUMBERS = (*ANGLES, *TIMES_AND_LIMITS, *PLACE, *TURN, *EXTENT)
ALIASES = ("t", "yaw")  # only read: seconds for stamp_ns, radians for the quaternion
FLOATS = pa.list_(pa.float32())

SCHEMA = pa.schema(
    [(name, pa.string()) for name in WORDS]
    + [(name, pa.int64()) for name in STAMPS]
    + [(name, pa.float64()) for name in NUMBERS[:6]]
    + [(name, FLOATS) for name in LISTS]
    + [(name, pa.float64()) for name in NUMBERS[6:]]
)
KNOWN = (*SCHEMA.names, *ALIASES)

BATCH_ROWS = 2048
BATCH_FLOATS = 1 << 20  # a batch is closed at this many ranges, so that memory stays flat


def batches(messages: Iterable[Message], types: Mapping[str, str]) -> Iterator[Any]:
    """Record batches of SCHEMA; an empty one if there are no messages."""
    rows: list[dict[str, Any]] = []
    floats = 0
    for message in messages:
        rows.append(_row(message, types))
        floats += len(rows[-1].get("ranges", ()))
        if len(rows) >= BATCH_ROWS or floats >= BATCH_FLOATS:
            yield _batch(rows)
            rows, floats = [], 0
    yield _batch(rows)


def _batch(rows: list[dict[str, Any]]) -> Any:
    columns = [pa.array([row.get(name) for row in rows], SCHEMA.field(name).type) for name in SCHEMA.names]
    return pa.RecordBatch.from_arrays(columns, schema=SCHEMA)


def _row(message: Message, types: Mapping[str, str]) -> dict[str, Any]:
    shared = ("topic", "frame", *STAMPS)
    row: dict[str, Any] = {name: getattr(message, name) for name in shared}
    if isinstance(message, LaserScan):
        row["kind"] = "scan"
        row |= {name: getattr(message, name) for name in (*ANGLES, *TIMES_AND_LIMITS, *LISTS)}
        return row
    row["kind"] = "odometry" if types.get(message.topic) == ODOMETRY_TYPE else "pose"
    row["body"] = message.body
    row |= dict(zip(PLACE, message.position, strict=True)) | dict(zip(TURN, message.quaternion, strict=True))
    if len(message.extent):
        row |= dict(zip(EXTENT, message.extent, strict=True))
    return row
