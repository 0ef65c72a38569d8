"""Rows of a table, shared by Parquet and CSV, read as messages."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from outrider.errors import InputError
from outrider.io._columns import (
    ANGLES,
    EXTENT,
    FLOATS,
    LISTS,
    PLACE,
    STAMPS,
    TIMES_AND_LIMITS,
    TURN,
    TYPES,
    WORDS,
)
from outrider.io._recording import Message, Recording, Topic
from outrider.records import LaserScan, Pose


@dataclass(frozen=True, slots=True)
class Table:
    """A file of rows: `scan(names)` gives its record batches with these columns only, in the file's order."""

    path: Path
    names: tuple[str, ...]  # columns that are there and known
    scan: Callable[[Collection[str]], Iterator[Any]]


def recording(table: Table, format: str) -> Recording:
    """A recording over a table; its index is one pass over the columns kind, topic and time."""
    default = _default_kind(table)
    counts: dict[tuple[str, str], int] = {}
    in_order, latest = True, np.iinfo(np.int64).min
    index_names = [n for n in table.names if n in (*WORDS, *STAMPS, "t")]
    for batch in table.scan(index_names):
        if not batch.num_rows:
            continue
        columns = _Columns(table.path, batch, default)
        for key in zip(columns.topics, columns.kinds, strict=True):
            counts[key] = counts.get(key, 0) + 1
        received = columns.received
        in_order = in_order and bool(received[0] >= latest) and bool(np.all(np.diff(received) >= 0))
        latest = received[-1]
    _check_columns(table, {kind for _, kind in counts} or {"scan"})
    topics: dict[str, Topic] = {}
    for (name, kind), count in sorted(counts.items()):
        before = topics[name].count if name in topics else 0
        topics[name] = Topic(name, "scan" if kind == "scan" else "pose", TYPES[kind], before + count)
    read = partial(_read if in_order else _read_sorted, table, default)
    return Recording(table.path, format, tuple(topics.values()), (), False, read)


def _read(table: Table, default: str, wanted: frozenset[str]) -> Iterator[Message]:
    for batch in table.scan(table.names):
        yield from _Columns(table.path, batch, default).messages(wanted)


def _read_sorted(table: Table, default: str, wanted: frozenset[str]) -> Iterator[Message]:
    """Of a file whose rows do not follow in time; it is held in memory."""
    yield from sorted(_read(table, default, wanted), key=lambda message: message.received_ns)


def _default_kind(table: Table) -> str:
    """The kind of all rows of a file without a column `kind`; "" with one."""
    if "kind" in table.names:
        return ""
    if "ranges" in table.names and "x" in table.names:
        raise InputError(f"{table.path}: column kind missing; want scan, pose or odometry in each row")
    return "pose" if "x" in table.names else "scan"


def _check_columns(table: Table, kinds: set[str]) -> None:
    have = set(table.names)
    missing = [] if have & {"t", *STAMPS} else ["t (or stamp_ns)"]
    if "scan" in kinds:
        missing += [name for name in ("ranges", *ANGLES) if name not in have]
    if kinds - {"scan"}:
        missing += [name for name in ("x", "y") if name not in have]
        missing += [] if "yaw" in have or have.issuperset(TURN) else ["yaw (or qx, qy, qz, qw)"]
    if missing:
        raise InputError(f"{table.path}: column missing: {', '.join(missing)}; see docs/formats.md")


class _Columns:
    """One record batch, decoded column by column on demand."""

    def __init__(self, path: Path, batch: Any, default_kind: str) -> None:
        self.path, self.batch, self.size = path, batch, batch.num_rows
        self.names = set(batch.schema.names)
        self.kinds = [default_kind] * self.size if default_kind else self.words("kind")
        for wrong in sorted(set(self.kinds) - set(TYPES)):
            raise InputError(f"{path}: kind {wrong!r}; want {', '.join(TYPES)}")
        self.bodies = self.words("body")
        given = self.words("topic")
        self.topics = [t or _topic(k, b) for t, k, b in zip(given, self.kinds, self.bodies, strict=True)]
        self.is_scan = np.array([kind == "scan" for kind in self.kinds], bool)

    def words(self, name: str) -> list[str]:
        if name not in self.names:
            return [""] * self.size
        return [word or "" for word in self._cast(name, pa.string()).to_pylist()]

    def _cast(self, name: str, type: Any) -> Any:
        column = self.batch.column(name)
        if pa.types.is_string(column.type) and type != pa.string():
            column = pc.utf8_trim_whitespace(column)
            column = pc.if_else(pc.equal(column, ""), pa.scalar(None, pa.string()), column)
        try:
            return column.cast(type)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
            raise InputError(f"{self.path}: column {name}: {error}; want {type}") from error

    def numbers(self, name: str, default: float | None, rows: Any = None) -> Any:
        """(size,) float64; with no default a missing value in `rows` is an error."""
        if name not in self.names:
            return np.full(self.size, np.nan if default is None else default)
        column = self._cast(name, pa.float64())
        if default is None and column.null_count:
            self._refuse_missing(name, column, rows)
        return pc.fill_null(column, np.nan if default is None else default).to_numpy(zero_copy_only=False)

    def _refuse_missing(self, name: str, column: Any, rows: Any) -> None:
        lost = int(np.sum(column.is_null().to_numpy(zero_copy_only=False) & rows))
        if lost:
            raise InputError(
                f"{self.path}: column {name} is empty in {lost} rows that need it; want a number"
            )

    def _stamps(self, name: str) -> Any | None:
        if name not in self.names:
            return None
        column = self._cast(name, pa.int64())
        self._refuse_missing(name, column, np.ones(self.size, bool))
        return column.to_numpy(zero_copy_only=False)

    @property
    def received(self) -> Any:
        """(size,) [ns]"""
        found = self._stamps("received_ns")
        return self.stamps if found is None else found

    @property
    def stamps(self) -> Any:
        """(size,) [ns]"""
        found = self._stamps("stamp_ns")
        if found is not None:
            return found
        if "t" not in self.names:
            return (
                np.zeros(self.size, np.int64)
                if "received_ns" not in self.names
                else self._stamps("received_ns")
            )
        seconds = self.numbers("t", None, np.ones(self.size, bool))
        if not np.all(np.abs(seconds) < 9.2e9):
            raise InputError(f"{self.path}: column t holds a value that is no time; want seconds")
        return np.round(seconds * 1e9).astype(np.int64)

    def lists(self, name: str) -> list[Any]:
        """Float32 arrays, an empty one where there is no value."""
        empty = np.zeros(0, np.float32)
        if name not in self.names:
            return [empty] * self.size
        column = self.batch.column(name)
        if pa.types.is_string(column.type):
            column = self._split(name, column)
        else:
            column = self._cast(name, FLOATS)
        offsets = column.offsets.to_numpy()
        values = (
            pc.fill_null(column.values, np.nan).to_numpy(zero_copy_only=False).astype(np.float32, copy=False)
        )
        there = column.is_valid().to_numpy(zero_copy_only=False)
        return [
            values[a:b] if ok else empty for a, b, ok in zip(offsets[:-1], offsets[1:], there, strict=True)
        ]

    def _split(self, name: str, column: Any) -> Any:
        """Lists from text such as "1.5 inf nan"; brackets, commas and semicolons are taken as spaces."""
        text = pc.utf8_trim_whitespace(pc.replace_substring_regex(column, r"[\[\],;\s]+", " "))
        text = pc.if_else(pc.equal(text, ""), pa.scalar(None, pa.string()), text)
        words = pc.split_pattern(text, " ")
        try:
            values = words.values.cast(pa.float32())
        except pa.ArrowInvalid as error:
            raise InputError(
                f"{self.path}: column {name}: {error}; want numbers with spaces between"
            ) from error
        return pa.ListArray.from_arrays(words.offsets, values, mask=words.is_null())

    def messages(self, wanted: frozenset[str]) -> Iterator[Message]:
        """The rows whose topic is wanted, in order."""
        if not wanted.intersection(self.topics):
            return
        makers: dict[bool, Callable[[int], Message]] = {True: self._scans(), False: self._poses()}
        for row, topic in enumerate(self.topics):
            if topic in wanted:
                yield makers[bool(self.is_scan[row])](row)

    def _scans(self) -> Callable[[int], LaserScan]:
        rows, frames, stamps, received = self.is_scan, self.words("frame"), self.stamps, self.received
        angles = {name: self.numbers(name, None, rows) for name in ANGLES}
        rest = {name: self.numbers(name, default) for name, default in TIMES_AND_LIMITS.items()}
        lists = {name: self.lists(name) for name in LISTS}

        def make(row: int) -> LaserScan:
            given = {name: float(column[row]) for name, column in (angles | rest).items()}
            return LaserScan(
                topic=self.topics[row],
                frame=frames[row],
                stamp_ns=int(stamps[row]),
                received_ns=int(received[row]),
                ranges=lists["ranges"][row],
                intensities=lists["intensities"][row],
                **given,
            )

        return make

    def _poses(self) -> Callable[[int], Pose]:
        rows, frames, stamps, received = ~self.is_scan, self.words("frame"), self.stamps, self.received
        place = np.column_stack([self.numbers(n, 0.0 if n == "z" else None, rows) for n in PLACE])
        if self.names.issuperset(TURN):
            turn = np.column_stack([self.numbers(name, None, rows) for name in TURN])
        else:
            yaw = self.numbers("yaw", None, rows)
            turn = np.column_stack([0.0 * yaw, 0.0 * yaw, np.sin(0.5 * yaw), np.cos(0.5 * yaw)])
        extent = np.column_stack([self.numbers(name, np.nan) for name in EXTENT])
        sized = np.all(np.isfinite(extent), axis=1)

        def make(row: int) -> Pose:
            return Pose(
                topic=self.topics[row],
                frame=frames[row],
                body=self.bodies[row],
                stamp_ns=int(stamps[row]),
                received_ns=int(received[row]),
                position=place[row],
                quaternion=turn[row],
                extent=extent[row] if sized[row] else np.zeros(0),
            )

        return make


def _topic(kind: str, body: str) -> str:
    """Topic of a row that names none."""
    if kind == "scan":
        return "/scan"
    return "/ego_pose" if body in ("", "ego") else f"/truth/{body}"
