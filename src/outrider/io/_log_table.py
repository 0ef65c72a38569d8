"""Columns of numbers in a CSV or Parquet file: what a car logs, one row an instant."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv
from pyarrow import parquet as pq

from outrider.errors import InputError
from outrider.io._folder import writing
from outrider.io._recording import one_line

SUFFIXES = (".csv", ".parquet")
Columns = dict[str, Any]  # name -> (n,) array


def names(path: Path) -> list[str]:
    """Names of the columns, in their order; InputError where the file cannot be read."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: suffix {path.suffix!r}; want a log as {' or '.join(SUFFIXES)}")
    try:
        if path.suffix.lower() == ".parquet":
            return [str(name) for name in pq.read_schema(path).names]
        return [word.strip().strip('"').strip() for word in _head(path).split(_delimiter(path))]
    except OSError as error:
        raise InputError(
            f"{path}: cannot be opened ({error.strerror or one_line(error)}); want a log"
        ) from error
    except (pa.ArrowException, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: cannot be read ({one_line(error)}); want a log with named columns"
        ) from error


def read(path: Path, wanted: Sequence[str]) -> Columns:
    """The wanted columns as float64 (n,), NaN where empty; InputError for what is no number."""
    try:
        table = pq.read_table(path, columns=list(wanted)) if path.suffix.lower() == ".parquet" else _csv(path)
    except (pa.ArrowException, OSError) as error:
        raise InputError(
            f"{path}: cannot be read ({one_line(error)}); want a log with named columns"
        ) from error
    return {name: _numbers(path, table, name) for name in wanted}


def write(path: Path, columns: Mapping[str, Any]) -> None:
    """Columns (n,) into a CSV or Parquet file, whole or not at all; InputError for a suffix, OutputError."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: suffix {path.suffix!r}; want {' or '.join(SUFFIXES)}")
    table = pa.table({name: np.ascontiguousarray(values) for name, values in columns.items()})
    with writing(path), tempfile.TemporaryDirectory(dir=path.parent, prefix=".outrider-") as folder:
        made = Path(folder) / path.name
        if path.suffix.lower() == ".parquet":
            pq.write_table(table, made, compression="zstd")
        else:
            csv.write_csv(table, made)
        made.replace(path)


def _head(path: Path) -> str:
    with path.open("rb") as file:
        return file.readline(1 << 16).decode("utf-8-sig").strip()


def _delimiter(path: Path) -> str:
    head = _head(path)
    return max(",;\t", key=head.count)


def _decimal_point(path: Path) -> str:
    """A comma where the first row has one that parts no columns."""
    with path.open("rb") as file:
        file.readline()
        return "," if _delimiter(path) != "," and b"," in file.readline(1 << 16) else "."


def _csv(path: Path) -> Any:
    """All columns of a CSV file; names as `names` gives them."""
    reading = csv.ReadOptions(skip_rows=1, column_names=names(path), use_threads=False)
    parsing = csv.ParseOptions(delimiter=_delimiter(path))
    return csv.read_csv(path, reading, parsing, csv.ConvertOptions(decimal_point=_decimal_point(path)))


def _numbers(path: Path, table: Any, name: str) -> Any:
    column = table.column(name)
    if pa.types.is_timestamp(column.type):
        column = column.cast(pa.timestamp("ns")).cast(pa.int64()).cast(pa.float64(), safe=False)
        return column.to_numpy() * 1e-9
    try:
        return column.cast(pa.float64(), safe=False).to_numpy().astype(float)
    except (pa.ArrowException, ValueError) as error:
        odd = (
            f"{word!r} in row {i + 1}" for i, word in enumerate(column.to_pylist()) if not _is_number(word)
        )
        raise InputError(f"{path}: column {name!r} has {next(odd, column.type)}; want numbers") from error


def _is_number(word: object) -> bool:
    try:
        float(str(word))
    except ValueError:
        return word is None
    return True
