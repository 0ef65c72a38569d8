"""Parquet, by pyarrow: one row a message, written and read in row groups."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from outrider.io._recording import Format, Message, Recording

READ_ROWS = 512


def open_parquet(path: Path) -> Recording:
    """A Parquet file with the columns of docs/formats.md; other columns are not read."""
    import pyarrow.parquet as pq

    from outrider.io import _columns, _rows

    names = tuple(name for name in pq.read_schema(path).names if name in _columns.KNOWN)
    return _rows.recording(_rows.Table(path, names, partial(_scan, path)), "parquet")


def _scan(path: Path, names: Collection[str]) -> Iterator[Any]:
    import pyarrow.parquet as pq

    with pq.ParquetFile(path, pre_buffer=False) as file:
        yield from file.iter_batches(READ_ROWS, columns=list(names), use_threads=False)


def write_parquet(path: Path, messages: Iterable[Message], types: Mapping[str, str]) -> None:
    """A Parquet file, zstd; it is readable only when complete."""
    import pyarrow.parquet as pq

    from outrider.io import _columns

    with pq.ParquetWriter(path, _columns.SCHEMA, compression="zstd") as writer:
        for batch in _columns.batches(messages, types):
            writer.write_batch(batch)


FORMATS = (Format("parquet", "a Parquet file", (".parquet",), (".parquet",), open_parquet, write_parquet),)
