"""Our own `.mcap` file: ROS 2 messages with their definitions, which Foxglove and `ros2 bag` open.

Files by others are read too (ROS 1 or ROS 2 messages). A file that was cut off, or never got its index, is
searched record by record, so that every finished chunk is read.
"""

from __future__ import annotations

import heapq
import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from outrider.errors import InputError
from outrider.io._recording import Format, Message, Recording, Topic
from outrider.io._ros_messages import MARKER_TYPE, codec, kind_of

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 1 << 18  # at most this much is lost when the process that writes is killed
SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 3, 4, 5, 6, 15  # record kinds of the MCAP specification
HEAD_BYTES = 9  # of a record: its kind and the size of its content
GENERATIONS = {"ros1": 1, "cdr": 2}  # message encodings that are read


@dataclass(frozen=True, slots=True)
class _Channel:
    topic: str
    type: str
    generation: int  # of ROS; 0: an encoding that is not read


@dataclass(frozen=True, slots=True)
class _Block:
    """Messages that lie together: a chunk, or a run of messages outside chunks."""

    start_ns: int
    offset: int  # of the first byte in the file
    size: int
    bare: bool  # messages outside chunks


@dataclass(slots=True)
class _Index:
    blocks: list[_Block] = field(default_factory=list)
    schemas: dict[int, str] = field(default_factory=dict)
    channels: dict[int, _Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    truncated: bool = False

    def note(self, record: Any) -> None:
        """Remember a schema or a channel."""
        if hasattr(record, "schema_id"):
            name = self.schemas.get(record.schema_id, "")
            package, _, base = name.partition("/")
            full = name if "/msg/" in name or not base else f"{package}/msg/{base}"
            generation = GENERATIONS.get(record.message_encoding, 0)
            self.channels[record.id] = _Channel(record.topic, full or "unknown", generation)
        else:
            self.schemas[record.id] = record.name

    def add(self, records: list[Any], offset: int, size: int, bare: bool) -> None:
        """Remember what one block holds."""
        times: list[int] = []
        for record in records:
            if hasattr(record, "log_time"):
                self.counts[record.channel_id] += 1
                times.append(record.log_time)
            else:
                self.note(record)
        if times:
            self.blocks.append(_Block(min(times), offset, size, bare))


def open_mcap(path: Path) -> Recording:
    """An MCAP file, whole or cut off."""
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise InputError(f"{path}: does not start as an MCAP file does; want .mcap to hold MCAP")
        index = _summary(file) or _search(file)
        bodies = _bodies(file, index)
    found: dict[str, Topic] = {}
    for key, channel in sorted(index.channels.items()):
        kind = "pose" if key in bodies else kind_of(channel.type) if channel.generation else "other"
        before = found.get(channel.topic)
        if before and (kind == "other") == (before.kind == "other"):
            found[channel.topic] = Topic(
                before.name, before.kind, before.type, before.count + index.counts[key]
            )
        elif not before or before.kind == "other":
            found[channel.topic] = Topic(channel.topic, kind, channel.type, index.counts[key])
    topics = sorted(found.values(), key=lambda topic: topic.name)
    return Recording(
        path=path,
        format="mcap",
        topics=tuple(t for t in topics if t.kind != "other"),
        others=tuple(t for t in topics if t.kind == "other"),
        truncated=index.truncated,
        read=partial(_read, path, index, bodies),
    )


def messages_of(path: Path, topic: str) -> Iterator[tuple[int, bytes]]:
    """Log time [ns] and bytes of all messages of one topic, in order of time, also of a file that was cut."""
    with path.open("rb") as file:
        index = _summary(file) or _search(file)
        used = {key: channel for key, channel in index.channels.items() if channel.topic == topic}
        for record in _in_order(file, index.blocks, used):
            yield record.log_time, record.data


def _bodies(file: BinaryIO, index: _Index) -> frozenset[int]:
    """Channels of markers that outrider wrote for poses with an extent; told by their first message."""
    asked = {
        k for k, c in index.channels.items() if c.type == MARKER_TYPE and c.generation and index.counts[k]
    }
    found: set[int] = set()
    for block in index.blocks:
        if not asked:
            break
        for record in _messages(file, block):
            if record.channel_id in asked:
                asked.discard(record.channel_id)
                if codec(index.channels[record.channel_id].generation).is_body(record.data):
                    found.add(record.channel_id)
    return frozenset(found)


def _read(path: Path, index: _Index, bodies: frozenset[int], wanted: frozenset[str]) -> Iterator[Message]:
    used = {
        key: channel
        for key, channel in index.channels.items()
        if channel.topic in wanted
        and channel.generation
        and (key in bodies or kind_of(channel.type) != "other")
    }
    with path.open("rb") as file:
        for record in _in_order(file, index.blocks, used):
            channel = used[record.channel_id]
            ros = codec(channel.generation)
            if record.channel_id not in bodies or ros.is_body(record.data):
                yield ros.decode(record.data, channel.type, channel.topic, record.log_time)


def _in_order(file: BinaryIO, blocks: list[_Block], used: Mapping[int, Any]) -> Iterator[Any]:
    """Messages of the used channels by log time, then by place; a block waits until its time has come."""
    waiting: list[tuple[int, int, int, Any]] = []
    for block in sorted(blocks, key=lambda b: (b.start_ns, b.offset)):
        while waiting and waiting[0][0] < block.start_ns:
            yield heapq.heappop(waiting)[3]
        for place, record in enumerate(_messages(file, block)):
            if record.channel_id in used:
                heapq.heappush(waiting, (record.log_time, block.offset, place, record))
    while waiting:
        yield heapq.heappop(waiting)[3]


def _messages(file: BinaryIO, block: _Block) -> Iterator[Any]:
    file.seek(block.offset)
    return (r for r in _unpack(file.read(block.size), block.bare) if hasattr(r, "log_time"))


def _unpack(data: bytes, bare: bool) -> list[Any]:
    """Schemas, channels and messages of a chunk's content or of a run of bare records."""
    from mcap.data_stream import ReadDataStream
    from mcap.records import Chunk
    from mcap.stream_reader import breakup_chunk

    if bare:
        chunk = Chunk("", data, 0, 0, 0, len(data))
    else:
        chunk = Chunk.read(ReadDataStream(BytesIO(data)))
    records: list[Any] = breakup_chunk(chunk, validate_crc=True)
    return records


def _summary(file: BinaryIO) -> _Index | None:
    """The index at the end of a whole file; None where there is none, or it does not cover all messages."""
    from mcap.reader import SeekingReader

    try:
        file.seek(0)
        summary = SeekingReader(file).get_summary()
    except Exception:  # cut off anywhere, or overwritten: the search tells what is left
        return None
    if summary is None or summary.statistics is None:
        return None
    if not summary.chunk_indexes and summary.statistics.message_count:
        return None
    index = _Index()
    for record in (*summary.schemas.values(), *summary.channels.values()):
        index.note(record)
    index.counts.update(summary.statistics.channel_message_counts)
    for chunk in summary.chunk_indexes:
        offset, size = chunk.chunk_start_offset + HEAD_BYTES, chunk.chunk_length - HEAD_BYTES
        index.blocks.append(_Block(chunk.message_start_time, offset, size, False))
    return index if set(index.counts) <= set(index.channels) else None


def _search(file: BinaryIO) -> _Index:
    """The index that reading all records gives; truncated unless all chunks and the end of data are sound."""
    index = _Index(truncated=True)
    damaged = False
    for opcode, offset, size in _walk(file):
        if opcode == DATA_END:
            index.truncated = damaged
            break
        bare = opcode in (SCHEMA, CHANNEL, MESSAGE)
        if bare:
            offset, size = offset - HEAD_BYTES, size + HEAD_BYTES
        elif opcode != CHUNK:
            continue
        file.seek(offset)
        try:
            index.add(_unpack(file.read(size), bare), offset, size, bare)
        except Exception:  # as a chunk is that was being written when the process was killed
            damaged = True
    return index


def _walk(file: BinaryIO) -> Iterator[tuple[int, int, int]]:
    """Kind, offset and size of the content of each whole record after the magic."""
    end = file.seek(0, 2)
    offset = len(MAGIC) + HEAD_BYTES
    while offset <= end:
        file.seek(offset - HEAD_BYTES)
        opcode, size = struct.unpack("<BQ", file.read(HEAD_BYTES))
        if offset + size > end or not opcode:
            return
        yield opcode, offset, size
        offset += size + HEAD_BYTES


def write_mcap(path: Path, messages: Iterable[Message], types: Mapping[str, str]) -> None:
    """An MCAP file of ROS 2 messages, in chunks of a quarter of a megabyte."""
    from mcap.writer import Writer

    ros = codec(2)
    schemas: dict[str, int] = {}
    channels: dict[tuple[str, str], int] = {}
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES)
        writer.start(profile="ros2", library="outrider")
        for message in messages:
            ros_type, data = ros.encode(message, types)
            if ros_type not in schemas:
                definition = ros.definition(ros_type).encode()
                schemas[ros_type] = writer.register_schema(ros_type, "ros2msg", definition)
            key = message.topic, ros_type
            if key not in channels:
                qos = {"offered_qos_profiles": ""}
                channels[key] = writer.register_channel(message.topic, "cdr", schemas[ros_type], qos)
            writer.add_message(channels[key], message.received_ns, data, message.received_ns)
        writer.finish()


FORMATS = (Format("mcap", "an MCAP file", (".mcap",), (".mcap",), open_mcap, write_mcap),)
