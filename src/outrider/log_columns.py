"""Columns that a vehicle logs of itself, whatever kind of vehicle: their names, units, and what is wrong.

A unit may be part of a column's name in a file, as in `vx_kmh` or `vx [km/h]`; without one it is SI. Each
kind of log says which columns it has by a `Kind`.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from math import pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.errors import InputError

Array = npt.NDArray[np.float64]
Units = dict[str, float]  # as it may stand in a column's name -> its size in SI, SI first

G = 9.81  # [m/s2]
TIME: Units = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
LENGTH: Units = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
SPEED: Units = {"m/s": 1.0, "mps": 1.0, "km/h": 1 / 3.6, "kmh": 1 / 3.6, "kph": 1 / 3.6}
RATE: Units = {"rad/s": 1.0, "radps": 1.0, "deg/s": pi / 180.0, "degps": pi / 180.0}
ACCELERATION: Units = {"m/s2": 1.0, "mps2": 1.0, "m/s^2": 1.0, "g": G}
ANGLE: Units = {"rad": 1.0, "deg": pi / 180.0}
LARGEST = 1e4  # nothing of a vehicle is more, in SI units


class Kind(NamedTuple):
    """What a log of one kind has; `t` is always one of its columns."""

    columns: Mapping[str, tuple[tuple[str, ...], Units]]  # column -> names it goes by in a file, and units
    optional: tuple[str, ...] = ()
    largest: float = LARGEST  # what is larger is taken as missing, in SI units; but for t

    def described(self) -> str:
        """The columns with their units, for messages."""
        words = {name: f"{name} [{next(iter(units))}]" for name, (_, units) in self.columns.items()}
        needed = ", ".join(word for name, word in words.items() if name not in self.optional)
        others = [words[name] for name in self.optional]
        known = " and ".join(filter(None, [", ".join(others[:-1]), *others[-1:]]))
        return f"{needed}, and, where known, {known}" if others else needed


def read(path: Path, kind: Kind, given: Mapping[str, str]) -> dict[str, Array]:
    """Columns (n,) of a CSV or Parquet file in SI units, those that are there.

    given: which column of the file is which, where their names do not tell. InputError for a file that
    cannot be read, or a column that is missing or there twice.
    """
    from outrider.io import _log_table

    chosen = _choose(path, _log_table.names(path), given, kind)
    found = _log_table.read(path, [name for name, _ in chosen.values()])
    return {own: found[name] * unit for own, (name, unit) in chosen.items()}


def write(path: Path, columns: Mapping[str, Any]) -> None:
    """Columns (n,) as a Parquet or CSV file, None left out; OutputError where that cannot be."""
    from outrider.io import _log_table

    _log_table.write(path, {name: values for name, values in columns.items() if values is not None})


def fingerprint(columns: Mapping[str, Array | None]) -> str:
    """SHA-256 of the columns, in hexadecimal; the same for the same numbers from any format."""
    made = hashlib.sha256()
    for name, values in columns.items():
        if values is not None:
            clean = np.where(np.isnan(values), np.nan, values) + 0.0
            made.update(name.encode() + clean.astype("<f8").tobytes())
    return made.hexdigest()


def checked(columns: Mapping[str, Array], kind: Kind, where: str) -> tuple[dict[str, Array], list[str]]:
    """The columns of the rows that have a time, NaN for what cannot be, and what was wrong, in words.

    InputError for a column that is missing or of another length, time that goes backwards, or fewer than two
    rows.
    """
    rows = {name: np.array(v, float).ravel() for name, v in columns.items() if name in kind.columns}
    absent = [name for name in kind.columns if name not in rows and name not in kind.optional]
    if absent or len({len(values) for values in rows.values()}) > 1:
        wrong = f"column {absent[0]} missing" if absent else "columns of different length"
        raise InputError(f"{where}: {wrong}; want {kind.described()}")
    faults: list[str] = []
    timed = np.isfinite(rows["t"])
    if not timed.all():
        faults.append(f"{count(~timed)} without a time: left out")
    rows = {name: values[timed] for name, values in rows.items()}
    t = rows["t"]
    _in_order(t, np.flatnonzero(timed), where)
    if (np.diff(t) == 0.0).any():
        faults.append(f"{count(np.diff(t) == 0.0)} at the time of the row before: not used")
    for name, values in rows.items():
        if name == "t":
            continue
        wild = np.abs(values) > kind.largest
        if wild.any():
            faults.append(f"{name} impossibly large in {count(wild)}: taken as missing")
        values[wild] = np.nan
        faults.extend(missing(name, values, t))
    return rows, faults


def within(t: Array, begin: float, end: float) -> npt.NDArray[np.bool_]:
    """The rows (n,) with begin <= t < end [s]; InputError where there are fewer than two."""
    inside = (t >= begin) & (t < end)
    if inside.sum() < 2:
        raise InputError(f"{inside.sum()} rows from {begin:g} to {end:g} s; want at least 2")
    return inside


def count(rows: Any) -> str:
    """How many rows are marked, in words: "1 row", "3 rows"."""
    n = int(rows.sum())
    return f"{n} row{'' if n == 1 else 's'}"


def missing(name: str, values: Array, t: Array) -> Iterator[str]:
    """How often a column (n,) has no number, and for how long at most, in words; else nothing."""
    bad = np.isnan(values)
    if not bad.any():
        return
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(np.int8)))
    begin, end = edges[::2], np.minimum(edges[1::2], len(t) - 1)
    longest = float((t[end] - t[begin]).max())
    yield f"{name} missing in {count(bad)}, at most {longest:.2f} s on end"


def _in_order(t: Array, rows: npt.NDArray[np.intp], where: str) -> None:
    """InputError where there is no time to speak of, or it goes backwards; rows (n,) of the file, from 0."""
    if len(t) < 2 or t[0] == t[-1]:
        raise InputError(f"{where}: {len(t)} rows with a time; want at least 2, at different times")
    back = np.flatnonzero(np.diff(t) < 0.0)
    if len(back):
        k = int(back[0])
        raise InputError(
            f"{where}: time goes back from {t[k]:.12g} to {t[k + 1]:.12g} s at row {int(rows[k + 1]) + 1}; "
            "want rows in order of time, one drive a file"
        )


# ------------------------------------------------------------------ which column is which


def _choose(
    path: Path, names: list[str], given: Mapping[str, str], kind: Kind
) -> dict[str, tuple[str, float]]:
    """Column of the log -> its name in the file, and the size of its unit in SI."""
    for own, name in given.items():
        if own not in kind.columns:
            raise InputError(f"column {own!r} is none of a log; want one of {', '.join(kind.columns)}")
        if names.count(name) != 1:
            raise InputError(f"{path}: column {name!r} missing or there twice; has {', '.join(names)}")
    chosen = {}
    for own, (aliases, units) in kind.columns.items():
        hits = {name: size for name in names if (size := _unit(name, aliases, units)) is not None}
        if own in given:
            chosen[own] = given[own], units.get(_split(given[own], units)[1], 1.0)
        elif own in names and names.count(own) == 1:
            chosen[own] = own, 1.0
        elif len(hits) == 1 and names.count(next(iter(hits))) == 1:
            chosen[own] = next(iter(hits.items()))
        elif hits:
            raise InputError(f"{path}: more than one column for {own}: {', '.join(hits)}; name one of them")
        elif own not in kind.optional:
            raise InputError(
                f"{path}: column {own} [{next(iter(units))}] missing; want {kind.described()}; "
                f"has {', '.join(names)}"
            )
    return chosen


def _unit(name: str, aliases: tuple[str, ...], units: Units) -> float | None:
    """Size of the unit that a column's name states, 1 where none; None where it is another column."""
    head, stated = _split(name, units)
    return units.get(stated, 1.0) if head in aliases else None


def _split(word: str, units: Iterable[str]) -> tuple[str, str]:
    """Name and unit of "vx_km/h", "vx [km/h]" or "vx (km/h)"; no unit where none of `units` is at the end."""
    plain = word.strip().lower().replace("°", "deg").replace("²", "2")
    for unit in sorted(units, key=len, reverse=True):
        if found := re.fullmatch(rf"(.*?)[_\s\[(]+{re.escape(unit)}[\])]?", plain):
            return found[1], unit
    return plain, ""
