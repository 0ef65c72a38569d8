"""run.mcap: every frame as Foxglove messages and as plain JSON, in a file that opens in Foxglove as it is."""

from __future__ import annotations

import os
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np
from foxglove import messages as fg
from mcap.exceptions import McapError
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from zstandard import ZstdError

from outrider.io._foxglove import log, points, scene, transforms
from outrider.io._run_rows import alert_row, tracks_columns
from outrider.io._run_tables import SCHEMAS
from outrider.io._scene import nanoseconds
from outrider.records import Frame, Level
from outrider.settings import Settings

CHUNK_BYTES = 128 * 1024  # what a killed process may lose: one to two seconds of a 10 Hz scanner

_TEXT = ("state", "level")
_NUMBER = {"type": ["number", "null"]}
_TRACK = {n: {"type": "string"} if n in _TEXT else _NUMBER for n in SCHEMAS["tracks"].names if n != "t"}
TRACKS_SCHEMA: dict[str, Any] = {
    "title": "outrider.Tracks",
    "type": "object",
    "properties": {
        "t": {"type": "number"},
        "tracks": {"type": "array", "items": {"type": "object", "properties": _TRACK}},
    },
}
ALERT_SCHEMA: dict[str, Any] = {
    "title": "outrider.Alert",
    "type": "object",
    "properties": {
        "t": {"type": "number"},
        "level": {"type": "string"},
        "number": {"type": "integer"},
        "track_id": _NUMBER,
        "ttc": _NUMBER,
        "degraded": {"type": "array", "items": {"type": "string"}},
    },
}


def track_rows(frame: Frame) -> dict[str, Any]:
    """The tracks as plain values, for plots against time."""
    columns = tracks_columns(frame)
    del columns["t"]
    values = zip(*(c.tolist() for c in columns.values()), strict=True)
    return {"t": float(frame.t), "tracks": [dict(zip(columns, row, strict=True)) for row in values]}


class McapSink:
    """Writes frames, given in the recording's own lengths, to an open binary file; OSError where it cannot.

    Chunks are complete in the file as soon as they are full, so a killed process loses the last one only.
    """

    def __init__(self, file: BinaryIO, settings: Settings, scale: float, metadata: dict[str, str]) -> None:
        mount = settings.mount
        self._file, self._settings, self._scale = file, settings, scale
        self._mount = np.array([mount.x_m, mount.y_m, mount.yaw_rad])
        self._said: tuple[Level, int, tuple[str, ...]] = (Level.NONE, -1, ())
        self._writer = Writer(file, chunk_size=CHUNK_BYTES)
        self._writer.start(library="outrider")
        self._writer.add_metadata("outrider", metadata)
        self._points = self._protobuf("/points", fg.PointCloud)
        self._scene = self._protobuf("/scene", fg.SceneUpdate)
        self._tf = self._protobuf("/tf", fg.FrameTransforms)
        self._log = self._protobuf("/alerts", fg.Log)
        self._alert = self._json("/alert", ALERT_SCHEMA)
        self._tracks = self._json("/tracks", TRACKS_SCHEMA)
        file.flush()

    def _protobuf(self, topic: str, message: Any) -> int:
        schema = message.get_schema()
        known = self._writer.register_schema(schema.name, schema.encoding, schema.data)
        return int(self._writer.register_channel(topic, "protobuf", known))

    def _json(self, topic: str, schema: dict[str, Any]) -> int:
        known = self._writer.register_schema(schema["title"], "jsonschema", msgspec.json.encode(schema))
        return int(self._writer.register_channel(topic, "json", known))

    def write(self, frame: Frame) -> None:
        """All messages of one frame."""
        now, alert = nanoseconds(frame.t), frame.alert
        add = self._writer.add_message
        placed = transforms(frame.t, frame.scan.ego.W_pose, self._mount)
        add(self._tf, now, placed.encode(), now)
        add(self._points, now, points(frame.scan).encode(), now)
        add(self._scene, now, scene(frame, self._settings, self._scale).encode(), now)
        add(self._tracks, now, msgspec.json.encode(track_rows(frame)), now)
        add(self._alert, now, msgspec.json.encode({**alert_row(alert), "number": int(alert.level)}), now)
        said = (alert.level, alert.track, alert.degraded)
        if said != self._said:
            self._said = said
            add(self._log, now, log(alert).encode(), now)
        self._file.flush()

    def close(self) -> None:
        """Index and footer; the file itself stays open."""
        self._writer.finish()
        self._file.flush()


def recover(path: Path) -> int:
    """Rewrite an MCAP file that was cut, so that it has its index again; returns the messages kept.

    Raises OSError where it cannot write; the file is replaced at the very end only.
    """
    part = path.with_suffix(".part")
    try:
        with path.open("rb") as source, part.open("wb") as target:
            kept = _copy(source, target)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
    return kept


def _copy(source: BinaryIO, target: BinaryIO) -> int:
    kept, writer = 0, Writer(target, chunk_size=CHUNK_BYTES)
    writer.start(library="outrider")
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    with suppress(McapError, ZstdError, struct.error):  # the cut
        for record in StreamReader(source).records:
            if isinstance(record, Schema) and record.id not in schemas:
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.id not in channels:
                known = schemas.get(record.schema_id, 0)
                channels[record.id] = writer.register_channel(record.topic, record.message_encoding, known)
            elif isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                writer.add_message(channel, record.log_time, record.data, record.publish_time)
                kept += 1
    writer.finish()
    return kept
