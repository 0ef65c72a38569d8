"""One file of a live recording: MCAP that `ros2 bag play` plays, Foxglove opens, and outrider reads again.

Everything is CDR under the profile `ros2`, for a bag of several encodings does not play. The bytes of the
sensor are kept as they came, so that a ride can be decoded again bit by bit.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from mcap.exceptions import McapError
from mcap.records import Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from outrider import __version__
from outrider.errors import InputError
from outrider.io import _ros_scene
from outrider.io._folder import may_write
from outrider.io._recording import SCAN_TYPE
from outrider.io._ros_messages import codec
from outrider.io._run_rows import in_recording_lengths
from outrider.io._scene import nanoseconds
from outrider.records import Alert, Array, Frame, LaserScan, Raw, Scan
from outrider.settings import Settings

BYTES = "/lidar/bytes"
CHUNK_BYTES = 1 << 18  # at most this much waits for the next flush
ABOUT = "outrider.lidar"  # name of the metadata that says what the bytes are


class LiveFile:
    """Writes one file; OSError where the file system refuses. Not safe for several threads."""

    def __init__(self, path: Path, settings: Settings, about: Mapping[str, Any]) -> None:
        mount = settings.mount
        self.path = path
        self._settings, self._scale = settings, settings.recording.scale
        self._mount: Array = np.array([mount.x_m, mount.y_m, mount.yaw_rad])
        self._said: tuple[Any, ...] = ()
        self._channels: dict[str, int] = {}
        self._file = path.open("wb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES)
        self._writer.start(profile="ros2", library=f"outrider {__version__}")
        self._writer.add_metadata(ABOUT, {"about": msgspec.json.encode(dict(about)).decode()})

    @property
    def size(self) -> int:
        """Bytes that the file has so far."""
        return self._file.tell()

    def frame(self, frame: Frame) -> None:
        """The scan, and all that was made of it."""
        frame = in_recording_lengths(frame, self._scale)
        t = nanoseconds(frame.t)
        self._add("/scan", codec(2).encode(laser_scan(frame.scan, self._scale), {})[1], t)
        parts = _ros_scene.frame_messages(frame, self._settings, self._scale, self._mount)
        for topic, data in parts.items():
            self._add(topic, data, t)
        self._alert(frame.alert, t)

    def _alert(self, alert: Alert, t: int) -> None:
        said = (alert.level, alert.track, alert.degraded)
        if said != self._said:
            self._said = said
            self._add("/alerts", _ros_scene.log_message(alert), t)

    def raw(self, raw: Raw) -> None:
        """Bytes of the sensor."""
        self._add(BYTES, _ros_scene.raw_message(raw), nanoseconds(raw.received))

    def flush(self, sync: bool = True) -> None:
        """All that was given is in the file; with `sync` it also outlives the loss of power."""
        self._writer.flush()
        self._file.flush()
        if sync:
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Index and end."""
        try:
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
        finally:
            self._file.close()

    def _add(self, topic: str, data: bytes, t: int) -> None:
        if topic not in self._channels:
            self._channels[topic] = self._channel(topic)
        self._writer.add_message(self._channels[topic], t, data, t)

    def _channel(self, topic: str) -> int:
        if topic == "/scan":
            name, text = SCAN_TYPE, codec(2).definition(SCAN_TYPE)
        else:
            name, text = _ros_scene.TYPES[topic], _ros_scene.definition(topic)
        schema = self._writer.register_schema(name, "ros2msg", text.encode())
        return int(self._writer.register_channel(topic, "cdr", schema, {"offered_qos_profiles": ""}))


def laser_scan(scan: Scan, scale: float) -> LaserScan:
    """A scan as a ROS driver would write it, angles rising, metres of the recording.

    A sensor that turns clockwise measured the first beam of the row last: time_increment is negative.
    """
    order = slice(None) if len(scan.angle) < 2 or scan.angle[-1] > scan.angle[0] else slice(None, None, -1)
    angle, beam_t = scan.angle[order], scan.beam_t[order]
    ranges = np.where(scan.valid, scan.range / scale, np.inf)[order].astype(np.float32)
    steps = max(len(angle) - 1, 1)
    first = float(beam_t[0]) if len(angle) else scan.t
    return LaserScan(
        topic="/scan",
        frame="laser",
        stamp_ns=nanoseconds(first),
        received_ns=nanoseconds(scan.t),
        angle_min=float(angle[0]) if len(angle) else 0.0,
        angle_increment=float(angle[-1] - angle[0]) / steps if len(angle) else 0.0,
        time_increment=float(beam_t[-1] - beam_t[0]) / steps if len(angle) else 0.0,
        scan_time=abs(float(beam_t[-1] - beam_t[0])) * (steps + 1) / steps if len(angle) else 0.0,
        range_min=0.0,
        range_max=scan.range_max / scale,
        ranges=ranges,
        intensities=scan.intensity[order] if len(scan.intensity) else scan.intensity,
    )


def about(path: Path) -> dict[str, Any] | None:
    """What a live recording says of its sensor, None where the file is none or holds no bytes of one."""
    found: dict[str, Any] | None = None
    try:
        with path.open("rb") as file:
            for record in StreamReader(file).records:
                if isinstance(record, Metadata) and record.name == ABOUT:
                    found = msgspec.json.decode(record.metadata["about"])
                    break
    except (McapError, OSError, KeyError, msgspec.DecodeError):
        return None
    return found if found is not None and _has_bytes(path) else None


def _has_bytes(path: Path) -> bool:
    from outrider.io import open_recording

    return any(topic.name == BYTES and topic.count for topic in open_recording(path).others)


def raws(path: Path) -> Iterator[Raw]:
    """The bytes of the sensor in the order they came, as far as the file goes."""
    from outrider.io.mcap import messages_of

    for t, data in messages_of(path, BYTES):
        yield _ros_scene.raw_of(data, t)


def checked_new(path: Path, force: bool) -> Path:
    """The path of a recording to be made; InputError where it is there already, or no .mcap."""
    if path.suffix != ".mcap":
        raise InputError(f"{path}: a live recording is MCAP; want a name that ends in .mcap")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; make it first")
    may_write(path, force)
    return path
