"""The returns of a run, scan by scan, out of run.mcap; whole or cut off."""

from __future__ import annotations

import struct
from contextlib import suppress
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, MessageIndex
from mcap.stream_reader import breakup_chunk, get_chunk_data_stream
from zstandard import ZstdError

from outrider.records import Array

MAGIC_BYTES, HEAD_BYTES = 8, 9  # of a file; of a record: kind and size
TOPIC = "/points"
NONE: Array = np.zeros((0, 2))


class _Place(NamedTuple):
    """Where one message lies."""

    chunk: int  # offset in the file, of the record's content [bytes]
    size: int  # of the record [bytes]
    offset: int  # in the chunk, once decompressed [bytes]


class RunPoints:
    """Finds the returns of scan k without reading what lies before; a file that is cut has fewer scans."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._places: list[_Place] = []
        with suppress(OSError, struct.error), path.open("rb") as file:
            self._places = list(_places(file))
        self._open = lru_cache(4)(self._read)

    def __len__(self) -> int:
        return len(self._places)

    def at(self, k: int) -> Array:
        """(n, 2) returns of scan k, fixed frame, lengths of the recording [m]; none where it was not kept."""
        if not 0 <= k < len(self._places):
            return NONE
        place = self._places[k]
        with suppress(OSError, McapError, ZstdError, ValueError, IndexError, struct.error):
            stream = ReadDataStream(BytesIO(self._open(place.chunk, place.size)[place.offset :]))
            stream.read1()
            return _cloud(Message.read(stream, stream.read8()).data)
        return NONE

    def _read(self, offset: int, size: int) -> bytes:
        """The content of a chunk, decompressed."""
        with self._path.open("rb") as file:
            file.seek(offset)
            chunk = Chunk.read(ReadDataStream(BytesIO(file.read(size))))
        stream, length = get_chunk_data_stream(chunk)
        return bytes(stream.read(length))


def _places(file: BinaryIO) -> list[_Place]:
    """All messages of the topic in the order they were written: by the index behind each chunk."""
    places: list[_Place] = []
    channel, chunk, size = -1, 0, 0
    end = file.seek(0, 2)
    at = MAGIC_BYTES
    while at + HEAD_BYTES <= end:
        file.seek(at)
        kind, length = struct.unpack("<BQ", file.read(HEAD_BYTES))
        at += HEAD_BYTES
        if at + length > end or kind == Opcode.DATA_END:
            break  # the cut, or the summary
        if kind == Opcode.CHUNK:
            chunk, size = at, length
            if channel < 0:
                channel = _channel(file.read(length))
        elif kind == Opcode.MESSAGE_INDEX:
            index = MessageIndex.read(ReadDataStream(BytesIO(file.read(length))))
            if index.channel_id == channel:
                places += [_Place(chunk, size, offset) for _, offset in index.records]
        at += length
    return places


def _channel(content: bytes) -> int:
    """Number of the topic's channel, if this chunk names it; -1 otherwise."""
    with suppress(McapError, ZstdError):
        for record in breakup_chunk(Chunk.read(ReadDataStream(BytesIO(content)))):
            if isinstance(record, Channel) and record.topic == TOPIC:
                return int(record.id)
    return -1


# ------------------------------------------------------------------ what `points` of _foxglove wrote


def _cloud(data: bytes) -> Array:
    """(n, 2) points [m] of an encoded foxglove.PointCloud."""
    cloud = _fields(data)
    position = _fields(_fields(cloud.get(3, b"")).get(1, b""))
    origin = [struct.unpack("<d", position[i])[0] if i in position else 0.0 for i in (1, 2)]
    (stride,) = struct.unpack("<I", cloud[4])
    rows = np.frombuffer(cloud.get(6, b""), "<f4").reshape(-1, stride // 4)
    points: Array = rows[:, :2] + np.array(origin)
    return points


def _fields(data: bytes) -> dict[int, bytes]:
    """Last value of every field of a protobuf message that is not a variable-length integer."""
    found: dict[int, bytes] = {}
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        size = {1: 8, 5: 4}.get(key & 7, 0)
        if key & 7 == 2:
            size, at = _varint(data, at)
        elif key & 7 == 0:
            _, at = _varint(data, at)
            continue
        found[key >> 3] = data[at : at + size]
        at += size
    return found


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A variable-length integer, and where it ends."""
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
