"""ROS 1 bags (`.bag`, `.bag.xz`) and ROS 2 bags (folder with sqlite3 or MCAP, bare `.db3`), by rosbags."""

from __future__ import annotations

import lzma
import os
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from outrider.errors import InputError, OutputError
from outrider.io._recording import Format, Message, Recording, Topic
from outrider.io._ros_messages import MARKER_TYPE, Codec, codec, kind_of

MCAP, SQLITE = "ros2-mcap", "ros2-sqlite3"


def open_ros1(path: Path) -> Recording:
    """A ROS 1 bag; one that was not closed has no index and is refused by name."""
    from rosbags.rosbag1 import Reader

    make = partial(Reader, path)
    try:
        return _open(path, "ros1", make, codec(1))
    except Exception as error:
        if "not indexed" in str(error) or "index looks damaged" in str(error):
            raise InputError(
                f"{path}: cut off, has no index; want it closed: `rosbag reindex` repairs it"
            ) from error
        raise


class _Unpacked:
    """A temporary file that goes when this object does."""

    def __init__(self, path: Path) -> None:
        handle, name = tempfile.mkstemp(suffix=".bag", prefix="outrider-")
        self.path = Path(name)
        self._finalizer = weakref.finalize(self, _remove, name)
        try:
            with lzma.open(path) as packed, os.fdopen(handle, "wb") as file:
                shutil.copyfileobj(packed, file, 1 << 20)
        except (EOFError, lzma.LZMAError) as error:
            self._finalizer()
            raise InputError(f"{path}: cut off or no .xz ({error}); want a whole .bag.xz") from error
        except OSError as error:
            self._finalizer()
            raise OutputError(
                f"{path}: cannot be unpacked to {name} ({error.strerror}); set TMPDIR"
            ) from error

    def reader(self) -> Any:
        """A reader of the unpacked bag; whoever holds this method keeps the file."""
        from rosbags.rosbag1 import Reader

        return Reader(self.path)


def _remove(name: str) -> None:
    with suppress(OSError):
        os.unlink(name)


def open_xz(path: Path) -> Recording:
    """A ROS 1 bag in xz: unpacked to a temporary file that lives as long as the recording."""
    return _open(path, "ros1-xz", _Unpacked(path).reader, codec(1))


def open_ros2(path: Path) -> Recording:
    """A ROS 2 bag: its folder, or the bare sqlite3 file."""
    from rosbags.rosbag2 import Reader

    if path.is_dir() and not (path / "metadata.yaml").is_file():
        inside = [p.name for p in sorted(path.iterdir()) if p.suffix in (".db3", ".mcap", ".bag")]
        hint = f"; {inside[0]} in it may open by itself" if inside else ""
        raise InputError(f"{path}: a folder without metadata.yaml is no ROS 2 bag{hint}")
    for file in [path] if path.is_file() else sorted(path.glob("*.db3")):
        _check_length(file)
    return _open(path, SQLITE if _is_sqlite(path) else MCAP, partial(Reader, path), codec(2))


def _check_length(file: Path) -> None:
    """sqlite3 reads what is missing of a file as zeros; its header knows the length."""
    with file.open("rb") as opened:
        head = opened.read(32)
    page = int.from_bytes(head[16:18], "big")
    want = (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big")
    have = file.stat().st_size
    if have < want:
        raise InputError(f"{file}: cut off, {have} of {want} bytes; `sqlite3 {file.name} .recover` may help")


def _is_sqlite(path: Path) -> bool:
    return (
        path.suffix == ".db3" if path.is_file() else "sqlite3" in (path / "metadata.yaml").read_text("utf8")
    )


def _open(path: Path, name: str, make: Callable[[], Any], ros: Codec) -> Recording:
    found: dict[str, Topic] = {}
    with make() as reader:
        for connection in reader.connections:
            kind = kind_of(connection.msgtype)
            if connection.msgtype == MARKER_TYPE and _holds_bodies(reader, connection, ros):
                kind = "pose"
            before = found.get(connection.topic)
            if (
                before and before.kind != "other" and kind != "other"
            ):  # one topic, several publishers or types
                found[before.name] = Topic(
                    before.name, before.kind, before.type, before.count + connection.msgcount
                )
            elif not before or before.kind == "other":
                found[connection.topic] = Topic(
                    connection.topic, kind, connection.msgtype, connection.msgcount
                )
    topics = sorted(found.values(), key=lambda topic: topic.name)
    return Recording(
        path=path,
        format=name,
        topics=tuple(t for t in topics if t.kind != "other"),
        others=tuple(t for t in topics if t.kind == "other"),
        truncated=False,
        read=partial(_read, make, ros),
    )


def _holds_bodies(reader: Any, connection: Any, ros: Codec) -> bool:
    return any(ros.is_body(data) for _, _, data in _first(reader.messages([connection])))


def _first(messages: Iterator[Any]) -> Iterator[Any]:
    for message in messages:
        yield message
        return


def _read(make: Callable[[], Any], ros: Codec, wanted: frozenset[str]) -> Iterator[Message]:
    with make() as reader:
        used = [c for c in reader.connections if c.topic in wanted and _is_used(c.msgtype)]
        if not used:
            return
        for connection, received_ns, data in reader.messages(used):
            if connection.msgtype != MARKER_TYPE or ros.is_body(data):
                yield ros.decode(data, connection.msgtype, connection.topic, received_ns)


def _is_used(ros_type: str) -> bool:
    return ros_type == MARKER_TYPE or kind_of(ros_type) != "other"


def _write(writer: Any, ros: Codec, messages: Iterable[Message], types: Mapping[str, str]) -> None:
    connections: dict[tuple[str, str], Any] = {}
    with writer:
        for message in messages:
            ros_type, data = ros.encode(message, types)
            key = message.topic, ros_type
            if key not in connections:
                connections[key] = writer.add_connection(message.topic, ros_type, typestore=ros.store)
            writer.write(connections[key], message.received_ns, data)


def write_ros1(path: Path, messages: Iterable[Message], types: Mapping[str, str]) -> None:
    """A ROS 1 bag, version 2.0, not compressed."""
    from rosbags.rosbag1 import Writer

    _write(Writer(path), codec(1), messages, types)


def write_mcap(path: Path, messages: Iterable[Message], types: Mapping[str, str]) -> None:
    """The folder of a ROS 2 bag with MCAP storage."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    _write(Writer(path, version=8, storage_plugin=StoragePlugin.MCAP), codec(2), messages, types)


def write_sqlite(path: Path, messages: Iterable[Message], types: Mapping[str, str]) -> None:
    """The folder of a ROS 2 bag with sqlite3 storage; for a path that ends in `.db3` the bare file."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    bare = path.suffix.lower() == ".db3"
    folder = path.with_suffix("") if bare else path
    _write(Writer(folder, version=8, storage_plugin=StoragePlugin.SQLITE3), codec(2), messages, types)
    if bare:
        (folder / f"{folder.name}.db3").rename(path)
        shutil.rmtree(folder)


FORMATS = (
    Format("ros1", "a ROS 1 bag", (".bag",), (".bag",), open_ros1, write_ros1),
    Format("ros1-xz", "a ROS 1 bag packed by xz", (".bag.xz",), (".bag.xz",), open_xz, None),
    Format(MCAP, "a ROS 2 bag", ("/",), ("",), open_ros2, write_mcap),
    Format(SQLITE, "a ROS 2 bag's sqlite3 file", (".db3",), (".db3",), open_ros2, write_sqlite),
)
