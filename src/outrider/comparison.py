"""Observers compared on recordings: the rows of the table, and the folder that keeps them.

Every observer gets the same measurements. What the columns mean is in docs/compare.md.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from outrider import __version__, observers
from outrider.compare import Estimate, Figures, Series, estimate, judge, promise, step_time
from outrider.errors import InputError
from outrider.interrupt import Interrupts
from outrider.io._folder import writing
from outrider.measured import Measured
from outrider.observers import Variant

TABLES = ("compare.json", "table.csv", "table.md")


class Column(NamedTuple):
    """One column of the table, of the field of the same name."""

    head: str
    form: str
    factor: float  # what is shown is the value times this
    best: float | None  # the best value there is; None: none is better than another


COLUMNS = {
    "samples": Column("samples", "d", 1, None),
    "position_m": Column("position [m]", ".2f", 1.0, 0.0),
    "speed_mps": Column("speed [m/s]", ".2f", 1.0, 0.0),
    "velocity_mps": Column("velocity [m/s]", ".2f", 1.0, 0.0),
    "course_rad": Column("course [deg]", ".1f", 180.0 / np.pi, 0.0),
    "yaw_rad": Column("yaw [deg]", ".1f", 180.0 / np.pi, 0.0),
    "J": Column("J", ".2f", 1.0, 0.0),
    "divergences": Column("diverged", "d", 1, None),
    "heading_flips": Column("flips", "d", 1, None),
    "nees": Column("NEES", ".1f", 1.0, 4.0),
    "outside": Column("outside [%]", ".0f", 100.0, 0.05),
    "beyond": Column("beyond [%]", ".1f", 100.0, 0.0),
    "step_us": Column("us a step", ".2f", 1.0, 0.0),
}
MARK = "*"  # behind the best figure of a column


@dataclass(frozen=True, slots=True)
class Row:
    """One observer on some series."""

    label: str  # as asked for: NAME, NAME:GAINS, +lagN
    lag: int  # [scans]
    figures: Figures
    step_us: float  # time of one step in a batch, compiled, on one core [us]

    def values(self) -> dict[str, Any]:
        """Plain numbers by name, as in `COLUMNS`."""
        return {**asdict(self.figures), "J": self.figures.J, "step_us": self.step_us}


@dataclass(frozen=True, slots=True)
class Compared:
    """All observers on one recording."""

    measured: Measured
    rows: tuple[Row, ...]
    estimates: tuple[tuple[Estimate, ...], ...]  # of each row: one a series


@dataclass(frozen=True, slots=True)
class Comparison:
    """All observers on all recordings."""

    recordings: tuple[Compared, ...]
    pooled: tuple[Row, ...]  # over all series of all recordings
    skip_s: float

    def tables(self) -> list[tuple[str, tuple[Row, ...]]]:
        """Name and rows of each recording that holds a series; last all of them, where there are several."""
        each = [(name_of(c.measured), c.rows) for c in self.recordings if c.measured.series]
        return [*each, ("all recordings", self.pooled)] if len(each) > 1 else each

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name; NaN and infinity stay what they are."""
        return {
            "version": __version__,
            "skip_s": self.skip_s,
            "recordings": [_told(c) for c in self.recordings],
            "pooled": [{"observer": row.label, "lag": row.lag, **row.values()} for row in self.pooled],
        }


def compare(
    recordings: Sequence[Measured],
    chosen: str = "all",
    skip_s: float = 1.0,
    watch: Callable[[str], None] | None = None,
) -> Comparison:
    """The same measurements to each of the observers `chosen`, as `observers.variants` takes them.

    An observer has its default gains, with what the recording's settings say in `observer.gains`. The first
    `skip_s` seconds of a series do not count. watch is called with the label of each observer that is done.
    InputError for an unknown observer, a `skip_s` below 0, or where there is no series at all.
    """
    if not 0.0 <= skip_s < np.inf:
        raise InputError(f"skip = {skip_s} s; want 0 or more")
    labels = labels_of(recordings, chosen)
    every = [s for m in recordings for s in m.series]
    if not every:
        raise InputError(_nothing(recordings))
    rows: list[list[Row]] = [[] for _ in recordings]
    made: list[list[tuple[Estimate, ...]]] = [[] for _ in recordings]
    pooled: list[Row] = []
    with Interrupts() as ctrl_c:
        for label in labels:
            with ctrl_c.held():  # a compiler at work does not bear an exception
                variants = [observers.variant(label, m.settings.observer.gains) for m in recordings]
                step_us = step_time(variants[0].observer, variants[0].gains, every, variants[0].lag)
                for i, (v, m) in enumerate(zip(variants, recordings, strict=True)):
                    made[i].append(_estimates(v, m.series))
                    rows[i].append(Row(label, v.lag, judge(made[i][-1], m.series, skip_s), step_us))
                figures = judge([e for part in made for e in part[-1]], every, skip_s)
                pooled.append(Row(label, variants[0].lag, figures, step_us))
            if watch:
                watch(label)
    found = (Compared(m, tuple(r), tuple(e)) for m, r, e in zip(recordings, rows, made, strict=True))
    return Comparison(tuple(found), tuple(pooled), skip_s)


def labels_of(recordings: Sequence[Measured], chosen: str) -> list[str]:
    """Labels of the observers that `chosen` names, each once; InputError as of `observers.variants`."""
    return list(
        dict.fromkeys(
            v.label for m in recordings for v in observers.variants(chosen, m.settings.observer.gains)
        )
    )


def _estimates(v: Variant, series: Sequence[Series]) -> tuple[Estimate, ...]:
    known = promise(v.observer, v.gains, v.lag)
    return tuple(replace(estimate(v.observer, v.gains, s, v.lag), promise=known) for s in series)


def _nothing(recordings: Sequence[Measured]) -> str:
    n = sum(len(m.left_out) for m in recordings)
    return (
        f"none of {n} bodies with truth was measured in two scans in a row; want one that is seen for longer"
    )


# ------------------------------------------------------------------ shown


def name_of(measured: Measured) -> str:
    """What a recording is called in tables: the name of the data set, or that of the file."""
    return measured.name if ":" in measured.name else Path(measured.name).name


def cells(rows: Sequence[Row]) -> list[list[str]]:
    """A table's rows as text; the best figure of a column is marked where the rows differ.

    What looks back knows more: rows with a lag have a best one of their own.
    """
    best = {(key, row.lag > 0): _best(key, rows, row.lag > 0) for key in COLUMNS for row in rows}
    shown = []
    for row in rows:
        values = row.values()
        texts = (_cell(key, values[key], values[key] in best[key, row.lag > 0]) for key in COLUMNS)
        shown.append([row.label, *texts])
    return shown


def _best(key: str, rows: Sequence[Row], looks_back: bool) -> set[Any]:
    """The values nearest to the best there is, of several that are not all alike."""
    target = COLUMNS[key].best
    every = [row.values()[key] for row in rows if (row.lag > 0) == looks_back]
    values = {v for v in every if not np.isnan(v)}
    if target is None or len(values) < 2:
        return set()
    off = {v: abs(v - target) for v in values}
    return {v for v, d in off.items() if d == min(off.values())}


def _cell(key: str, value: Any, best: bool) -> str:
    column = COLUMNS[key]
    if np.isnan(value):
        return "-"
    return f"{column.factor * value:{column.form}}" + MARK * best


def head() -> list[str]:
    """Heads of the columns of `cells`."""
    return ["observer", *(column.head for column in COLUMNS.values())]


def markdown(comparison: Comparison) -> str:
    """All tables as Markdown."""
    lines: list[str] = []
    for name, rows in comparison.tables():
        lines += [f"## {name}", "", _line(head()), _line(["---", *["---:"] * len(COLUMNS)])]
        lines += [*(_line(row) for row in cells(rows)), ""]
    return "\n".join([*lines, f"`{MARK}`: best of its column; rows with a lag among themselves."]) + "\n"


def _line(row: Sequence[str]) -> str:
    return "| " + " | ".join(row) + " |"


# ------------------------------------------------------------------ kept


def save(comparison: Comparison, folder: Path) -> None:
    """Write compare.json, table.csv and table.md into a folder; OutputError where it cannot."""
    told = msgspec.json.encode(comparison.to_dict(), enc_hook=lambda v: v.tolist())
    table = io.StringIO()
    sheet = csv.writer(table, lineterminator="\n")
    sheet.writerow(["recording", "observer", "lag", *COLUMNS])
    for name, rows in comparison.tables():
        sheet.writerows([name, r.label, r.lag, *(r.values()[key] for key in COLUMNS)] for r in rows)
    contents = (msgspec.json.format(told), table.getvalue().encode(), markdown(comparison).encode())
    for name, content in zip(TABLES, contents, strict=True):
        with writing(folder / name):
            (folder / name).write_bytes(content)


def _told(c: Compared) -> dict[str, Any]:
    m = c.measured
    gains = m.settings.observer.gains
    return {
        "name": m.name,
        "settings": msgspec.to_builtins(m.settings),
        "left_out": list(m.left_out),
        "series": [
            {"name": s.name, "scans": len(s.t), "seen": int(np.isfinite(s.y[:, 0]).sum())} for s in m.series
        ],
        "observers": [
            {
                "observer": row.label,
                "lag": row.lag,
                "gains": observers.variant(row.label, gains).gains._asdict(),
                **row.values(),
            }
            for row in c.rows
        ],
    }
