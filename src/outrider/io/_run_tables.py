"""The tables of a run folder, in files that stay readable when they are cut.

While a run lasts, a table is an Arrow stream NAME.arrows; at its end it becomes NAME.parquet.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import ipc
from pyarrow import parquet as pq

from outrider.errors import InputError

_KINDS = {
    "track_id": pa.int64(),
    "hits": pa.int64(),
    "state": pa.string(),
    "level": pa.string(),
    "ego_known": pa.bool_(),
}
_COUNTS = ("beams", "valid", "detections", "tracks")


def _schema(names: str) -> pa.Schema:
    return pa.schema(
        [(n, pa.int64() if n in _COUNTS else _KINDS.get(n, pa.float64())) for n in names.split()]
    )


_MOTION = "t track_id x y vx vy speed acceleration course yaw slip yaw_rate length width state hits"
_BOUND = "bound_position bound_speed bound_course"
SCHEMAS = {
    "tracks": _schema(f"{_MOTION} ttc {_BOUND} ttc_earliest ttc_latest"),
    "lagged": _schema(f"{_MOTION} {_BOUND}"),
    "scans": _schema(
        "t ego_x ego_y ego_vx ego_vy ego_yaw ego_yaw_rate ego_known beams valid detections tracks level"
    ),
}


class ChunkedTable:
    """Rows appended in chunks to a file, every finished chunk of which stays readable."""

    def __init__(self, folder: Path, name: str) -> None:
        self._schema = SCHEMAS[name]
        self._rows: list[dict[str, Any]] = []
        self._file = (folder / f"{name}.arrows").open("wb")
        self._stream = ipc.new_stream(self._file, self._schema)
        self._file.flush()

    def add(self, columns: dict[str, Any]) -> None:
        """Columns (n,) of equal length, kept until flush."""
        self._rows.append(columns)

    def flush(self) -> None:
        """Writes what was added as one chunk."""
        rows, self._rows = self._rows, []
        columns = [np.concatenate([r[name] for r in rows]) for name in self._schema.names] if rows else []
        if columns and len(columns[0]):
            arrays = [pa.array(c, f.type) for c, f in zip(columns, self._schema, strict=True)]
            self._stream.write_batch(pa.record_batch(arrays, schema=self._schema))
            self._file.flush()

    def close(self) -> None:
        """Ends the stream and closes the file."""
        try:
            self._stream.close()
        finally:
            self._file.close()


def _chunks(path: Path) -> Iterator[pa.RecordBatch]:
    """The finished chunks of an Arrow stream, whole or cut."""
    with path.open("rb") as file, suppress(pa.ArrowInvalid, OSError, EOFError):
        yield from ipc.open_stream(file)


def seal(folder: Path, name: str) -> None:
    """NAME.arrows becomes NAME.parquet, by groups of rows that fit in memory; OSError where it cannot."""
    source, part, schema = folder / f"{name}.arrows", folder / f"{name}.part", SCHEMAS[name]
    try:
        with part.open("wb") as file, pq.ParquetWriter(file, schema) as parquet:
            group: list[pa.RecordBatch] = []
            for chunk in _chunks(source):
                group.append(chunk)
                if sum(c.num_rows for c in group) > 100_000:
                    parquet.write_table(pa.Table.from_batches(group))
                    group = []
            parquet.write_table(pa.Table.from_batches(group, schema))
        os.replace(part, folder / f"{name}.parquet")
    finally:
        part.unlink(missing_ok=True)
    source.unlink()


def read_table(folder: Path, name: str) -> pa.Table:
    """NAME.parquet, or what there is of NAME.arrows; InputError where neither can be read."""
    try:
        if (folder / f"{name}.parquet").exists():
            return pq.read_table(folder / f"{name}.parquet")
        return pa.Table.from_batches(_chunks(folder / f"{name}.arrows"), SCHEMAS[name])
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(
            f"{folder}: {name} not readable ({error}); want a folder written by outrider"
        ) from error
