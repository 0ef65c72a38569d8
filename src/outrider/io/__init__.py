"""Recordings in and out: the suffix picks the format, and a new format is one new file in this folder.

A format's file states `FORMATS`, a tuple of `Format`. A file whose name starts with an underscore is none.
Formats, topics and columns are described in docs/formats.md.
"""

from __future__ import annotations

import importlib
import pkgutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

from outrider.errors import InputError, OutputError, OutriderError
from outrider.io._choose import Chosen, choose_topics
from outrider.io._folder import may_write
from outrider.io._info import Info, ScanInfo, TopicInfo, describe_recording
from outrider.io._recording import Format, Message, Recording, Topic, one_line

__all__ = [
    "Chosen",
    "Format",
    "Info",
    "Message",
    "Recording",
    "ScanInfo",
    "Topic",
    "TopicInfo",
    "choose_topics",
    "convert",
    "describe",
    "formats",
    "open_recording",
    "write_recording",
]


@cache
def formats() -> tuple[Format, ...]:
    """All formats, by name."""
    found: list[Format] = []
    for module in pkgutil.iter_modules(__path__):
        if not module.name.startswith("_"):
            found.extend(getattr(importlib.import_module(f"{__name__}.{module.name}"), "FORMATS", ()))
    return tuple(sorted(found, key=lambda f: f.name))


def open_recording(path: Path | str) -> Recording:
    """The recording at `path`, a file or the folder of a ROS 2 bag; only its index is read.

    Raises InputError when it is absent, empty, unreadable, of no known format or damaged.
    """
    path = Path(path)
    is_folder = _check_readable(path)
    found = _by_suffix(
        path, "/" if is_folder else path.name.lower(), [(f, f.reads) for f in formats()], "read"
    )
    try:
        return found.open(path)
    except OutriderError:
        raise
    except Exception as error:  # what a parser makes of damaged bytes can be any exception
        raise InputError(f"{path}: cannot be read as {found.about} ({one_line(error)})") from error


def write_recording(
    path: Path | str,
    messages: Iterable[Message],
    force: bool = False,
    *,
    format: str = "",
    types: Mapping[str, str] | None = None,
) -> int:
    """Write `messages` to `path` and return their number; `format` names one where the suffix does not tell.

    `types` gives the ROS type of a topic where it matters (odometry). The recording is written beside `path`
    and moved there when complete, so a failure leaves what was at `path` before, and no half of a file.
    Raises InputError when `path` exists and `force` is False, OutputError when it cannot be written.
    """
    path = Path(path)
    chosen = _named(format) if format else _by_suffix(path, path.name.lower(), _writers(), "write")
    write = chosen.write
    if write is None:
        raise InputError(f"{path}: {chosen.name} can be read, not written; want {_known(_writers())}")
    try:
        _check_target(path, force)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({one_line(error)}); nothing was changed") from error
    source = _Counted(messages)
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".outrider-") as folder:
            made = Path(folder) / path.name
            write(made, source, types or {})
            if path.exists() and (path.is_dir() or made.is_dir()):
                path.rename(Path(folder) / "replaced")
            made.replace(path)
    except OutriderError:
        raise
    except Exception as error:  # a full disk is another exception in each library
        if error is source.error:
            raise
        raise OutputError(f"{path}: cannot be written ({one_line(error)}); nothing was changed") from error
    return source.count


def convert(src: Path | str | Recording, dst: Path | str, force: bool = False, *, format: str = "") -> int:
    """Copy all scans and poses of `src` into `dst`, in another format, and return their number."""
    recording = src if isinstance(src, Recording) else open_recording(src)
    types = {topic.name: topic.type for topic in recording.topics}
    return write_recording(dst, recording.messages(), force, format=format, types=types)


def describe(source: Path | str | Recording) -> Info:
    """What is inside a recording, all of it read once."""
    return describe_recording(source if isinstance(source, Recording) else open_recording(source))


class _Counted:
    """Messages on their way to a writer: how many went through, and whether the source itself failed."""

    def __init__(self, messages: Iterable[Message]) -> None:
        self.messages, self.count = messages, 0
        self.error: Exception | None = None

    def __iter__(self) -> Iterator[Message]:
        try:
            for message in self.messages:
                self.count += 1
                yield message
        except Exception as error:
            self.error = error
            raise


def _writers() -> list[tuple[Format, tuple[str, ...]]]:
    return [(f, f.writes) for f in formats() if f.write]


def _known(choices: list[tuple[Format, tuple[str, ...]]]) -> str:
    names = sorted({s for _, suffixes in choices for s in suffixes})
    return ", ".join({"/": "the folder of a ROS 2 bag", "": "no suffix (ROS 2 bag)"}.get(s, s) for s in names)


def _by_suffix(path: Path, name: str, choices: list[tuple[Format, tuple[str, ...]]], verb: str) -> Format:
    hits = [(len(s), f) for f, suffixes in choices for s in suffixes if s and name.endswith(s)]
    if not hits and not path.suffix:
        hits = [(0, f) for f, suffixes in choices if "" in suffixes]
    if not hits:
        raise InputError(f"{path}: no format to {verb} for suffix {path.suffix!r}; want {_known(choices)}")
    return max(hits, key=lambda hit: hit[0])[1]


def _named(name: str) -> Format:
    for candidate in formats():
        if candidate.name == name:
            return candidate
    raise InputError(f"no format {name!r}; want {', '.join(f.name for f in formats() if f.write)}")


def _check_readable(path: Path) -> bool:
    """Whether it is a folder; raises InputError where it cannot be opened or is empty."""
    try:
        if path.is_dir():
            return True
        with path.open("rb") as file:
            if not file.read(1):
                raise InputError(f"{path}: empty file; want a recording")
    except OSError as error:
        raise InputError(f"{path}: cannot be opened ({error.strerror}); want a recording") from error
    return False


def _check_target(path: Path, force: bool) -> None:
    if not path.name or path.name == "..":
        raise InputError(f"{path}: not a name for a recording")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: there is no folder {path.parent}; make it first")
    may_write(path, force)
    if path.is_dir() and any(path.iterdir()) and not (path / "metadata.yaml").is_file():
        raise InputError(f"{path}: a folder that is no ROS 2 bag is never replaced; choose another name")
