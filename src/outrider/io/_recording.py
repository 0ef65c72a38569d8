"""What every format hands over (`Recording`) and what it states about itself (`Format`)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from outrider.errors import InputError, OutriderError
from outrider.extension import nearest
from outrider.records import LaserScan, Pose

Message = LaserScan | Pose

SCAN_TYPE = "sensor_msgs/msg/LaserScan"
POSE_TYPE = "geometry_msgs/msg/PoseStamped"
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"


@dataclass(frozen=True, slots=True)
class Topic:
    """One stream of messages of a recording."""

    name: str
    kind: str  # "scan", "pose", or "other": not used
    type: str  # as a ROS type name, also where the format is not ROS
    count: int  # messages, as the format's own index says


@dataclass(frozen=True, slots=True)
class Recording:
    """An opened recording; nothing but its index has been read."""

    path: Path
    format: str
    topics: tuple[Topic, ...]  # scans and poses, by name
    others: tuple[Topic, ...]  # all that is not used, by name
    truncated: bool  # cut off, as by a killed process: what is left is read
    read: Callable[[frozenset[str]], Iterator[Message]] = field(repr=False)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Messages of the named topics (None: all scans and poses), one at a time, sorted by `received_ns`.

        Messages received at the same instant keep the order of the file. Raises InputError for a topic that
        is not there, and where the file turns out to be damaged, after all before that was handed over.
        """
        known = {topic.name for topic in self.topics}
        wanted = frozenset(known if topics is None else topics)
        for name in sorted(wanted - known):
            raise InputError(f"{self.path}: no scan or pose topic {name!r}{nearest(name, sorted(known))}")
        return _guarded(self.path, self.read(wanted)) if wanted else iter(())


@dataclass(frozen=True, slots=True)
class Format:
    """What a file of this package states about a format it reads or writes."""

    name: str  # as in --format
    about: str
    reads: tuple[str, ...]  # suffixes; "/" stands for a folder
    writes: tuple[str, ...]  # suffixes that pick it for writing; "" stands for a path without one
    open: Callable[[Path], Recording]
    write: (
        Callable[[Path, Iterable[Message], Mapping[str, str]], None] | None
    )  # path, messages, types by topic


def _guarded(path: Path, messages: Iterator[Message]) -> Iterator[Message]:
    count = 0
    try:
        for message in messages:
            yield message
            count += 1
    except OutriderError:
        raise
    except Exception as error:  # what a parser makes of damaged bytes can be any exception
        raise InputError(f"{path}: damaged after {count} messages ({one_line(error)})") from error


def one_line(error: Exception) -> str:
    """An exception's text as one short line."""
    reason = error.strerror if isinstance(error, OSError) else None
    text = " ".join((reason or str(error)).split()) or type(error).__name__
    return text if len(text) <= 200 else text[:197] + "..."
