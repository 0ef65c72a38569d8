"""CSV, by pyarrow: one row a message, a list as numbers with spaces between; may be written by hand."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from outrider.errors import InputError
from outrider.io._recording import Format, Message, Recording

BLOCK_BYTES = 1 << 21


def open_csv(path: Path) -> Recording:
    """A CSV file whose first line names the columns of docs/formats.md; other columns are not read."""
    from outrider.io import _columns, _rows

    with path.open("rb") as file:
        head = file.readline(1 << 16)
    try:
        header = [name.strip().strip('"').strip() for name in head.decode("utf-8-sig").split(",")]
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not text; want a CSV file whose first line names the columns") from error
    known = [name for name in header if name in _columns.KNOWN]
    for name in known:
        if known.count(name) > 1:
            raise InputError(f"{path}: column {name} is there twice; want each once")
    table = _rows.Table(path, tuple(known), partial(_scan, path, header))
    return _rows.recording(table, "csv")


def _scan(path: Path, header: list[str], names: Collection[str]) -> Iterator[Any]:
    import pyarrow as pa
    from pyarrow import csv

    numbered = [name if name in names else f"{place} {name}" for place, name in enumerate(header)]
    reading = csv.ReadOptions(use_threads=False, block_size=1 << 30, column_names=numbered)
    converting = csv.ConvertOptions(
        include_columns=list(names),
        column_types=dict.fromkeys(names, pa.string()),
        strings_can_be_null=False,
    )
    for block in _blocks(path):
        try:
            table = csv.read_csv(pa.BufferReader(block), reading, convert_options=converting)
        except pa.ArrowInvalid as error:
            raise InputError(f"{path}: {error}; want as many fields in each row as in the first") from error
        yield from table.combine_chunks().to_batches()


def _blocks(path: Path) -> Iterator[bytes]:
    """Whole lines after the first, some megabytes at a time; pyarrow's own stream reads far ahead."""
    with path.open("rb") as file:
        file.readline()
        while block := file.read(BLOCK_BYTES):
            block += file.readline()
            if block.strip():
                yield block


def write_csv(path: Path, messages: Iterable[Message], types: Mapping[str, str]) -> None:
    """A CSV file with all columns; numbers are written with as many digits as bring them back exactly."""
    import pyarrow as pa
    from pyarrow import csv

    from outrider.io import _columns

    fields = [(f.name, pa.string() if f.name in _columns.LISTS else f.type) for f in _columns.SCHEMA]
    schema = pa.schema(fields)
    with csv.CSVWriter(path, schema) as writer:
        for batch in _columns.batches(messages, types):
            columns = [_text(column) if pa.types.is_list(column.type) else column for column in batch.columns]
            writer.write_batch(pa.RecordBatch.from_arrays(columns, schema=schema))


def _text(lists: Any) -> Any:
    """ "1.5 inf nan" from [1.5, inf, nan], for each row."""
    import pyarrow as pa
    import pyarrow.compute as pc

    words = pc.cast(lists.values, pa.string())
    return pc.binary_join(pa.ListArray.from_arrays(lists.offsets, words, mask=lists.is_null()), " ")


FORMATS = (Format("csv", "a CSV file", (".csv",), (".csv",), open_csv, write_csv),)
