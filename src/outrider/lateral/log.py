"""What a car logged of itself: frozen columns, read from CSV or Parquet, with what was wrong with them.

Body frame: x forward, y left; the centre of gravity. A unit may be part of a column's name in a file, as in
`vx_kmh` or `vx [km/h]`; without one it is SI.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from outrider.cars import Car
from outrider.errors import InputError
from outrider.lateral import LONGEST_GAP, Array

G = 9.81  # [m/s2]

TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
SPEED = {"m/s": 1.0, "mps": 1.0, "km/h": 1 / 3.6, "kmh": 1 / 3.6, "kph": 1 / 3.6}
RATE = {"rad/s": 1.0, "radps": 1.0, "deg/s": pi / 180.0, "degps": pi / 180.0}
ACCELERATION = {"m/s2": 1.0, "mps2": 1.0, "m/s^2": 1.0, "g": G}
ANGLE = {"rad": 1.0, "deg": pi / 180.0}

# Column of a log -> the names it goes by in a file, and the units it may have there, SI first.
COLUMNS: dict[str, tuple[tuple[str, ...], dict[str, float]]] = {
    "t": (("t", "time"), TIME),
    "vx": (("vx", "speed"), SPEED),
    "yaw_rate": (("yaw_rate",), RATE),
    "ay": (("ay",), ACCELERATION),
    "steering": (("steering", "delta"), ANGLE),
    "vy": (("vy",), SPEED),
}
OPTIONAL = ("ay", "vy")
LARGEST = 1e4  # nothing of a car is more, in SI units
ALIKE = 0.7  # two columns that should agree but for a factor correlate at least so much
ROWS = 50  # fewer rows of turning say nothing about units


@dataclass(frozen=True, slots=True)
class Log:
    """A car's own sensors over time, as read: NaN where missing, t rising."""

    t: Array  # (n,) [s], not falling
    vx: Array  # (n,) forward, negative in reverse [m/s]
    yaw_rate: Array  # (n,) [rad/s], to the left
    ay: Array  # (n,) what the sensor reads, to the left [m/s2]
    steering: Array  # (n,) as logged, before the car's gain and offset [rad]
    vy: Array | None = None  # (n,) measured or true lateral velocity, to the left [m/s]
    faults: tuple[str, ...] = ()  # what was wrong and what became of it, in words

    def samples(self, car: Car) -> Array:
        """(n, 5) as `lateral.Sample`: the car's steering gain and offset applied, ay freed of roll."""
        steps = np.diff(self.t, prepend=self.t[:1])
        wheels = car.steering_gain * self.steering + car.steering_offset
        level = self.ay / (1.0 + G * car.roll_gain)
        return np.column_stack([steps, self.vx, self.yaw_rate, level, wheels])

    def fingerprint(self) -> str:
        """SHA-256 of the columns, in hexadecimal; the same for the same numbers from any format."""
        made = hashlib.sha256()
        for name in COLUMNS:
            values = getattr(self, name)
            if values is not None:
                clean = np.where(np.isnan(values), np.nan, values) + 0.0
                made.update(name.encode() + clean.astype("<f8").tobytes())
        return made.hexdigest()

    def part(self, begin: float, end: float) -> Log:
        """The rows with begin <= t < end [s]; InputError where there are fewer than two."""
        inside = (self.t >= begin) & (self.t < end)
        if inside.sum() < 2:
            raise InputError(f"{inside.sum()} rows from {begin:g} to {end:g} s; want at least 2")
        cut = {name: None if (v := getattr(self, name)) is None else v[inside] for name in COLUMNS}
        return Log(**cut, faults=self.faults)  # type: ignore[arg-type]

    def halves(self) -> tuple[Log, Log]:
        """The first and the second half by time."""
        middle = 0.5 * (self.t[0] + self.t[-1])
        return self.part(self.t[0], middle), self.part(middle, np.inf)


def read(path: Path | str, columns: Mapping[str, str] | None = None) -> Log:
    """A log from a CSV or Parquet file.

    columns: which column of the file is which of the log, where their names do not tell, such as
    {"steering": "wheel angle [deg]"}. InputError for a file that cannot be read, a column that is missing
    or there twice, time that goes backwards, or fewer than two rows. Bad values become NaN and are counted.
    """
    from outrider.io import _log_table

    path = Path(path)
    chosen = _choose(path, _log_table.names(path), dict(columns or {}))
    found = _log_table.read(path, [name for name, _ in chosen.values()])
    return checked({own: found[name] * unit for own, (name, unit) in chosen.items()}, str(path))


def write(log: Log, path: Path | str) -> None:
    """The log as a Parquet or CSV file, SI units; OutputError where that cannot be."""
    from outrider.io import _log_table

    columns = {name: getattr(log, name) for name in COLUMNS}
    _log_table.write(Path(path), {name: v for name, v in columns.items() if v is not None})


def checked(columns: Mapping[str, Array], where: str = "log") -> Log:
    """A log from columns (n,) in SI units, named as those of `Log`; InputError as `read`."""
    rows = {name: np.array(values, float).ravel() for name, values in columns.items() if name in COLUMNS}
    absent = [name for name in COLUMNS if name not in rows and name not in OPTIONAL]
    if absent or len({len(values) for values in rows.values()}) > 1:
        wrong = f"column {absent[0]} missing" if absent else "columns of different length"
        raise InputError(f"{where}: {wrong}; want {described()}")
    faults: list[str] = []
    timed = np.isfinite(rows["t"])
    if not timed.all():
        faults.append(f"{_count(~timed)} without a time: left out")
    rows = {name: values[timed] for name, values in rows.items()}
    t = rows["t"]
    _in_order(t, np.flatnonzero(timed), where)
    if (np.diff(t) == 0.0).any():
        faults.append(f"{_count(np.diff(t) == 0.0)} at the time of the row before: not used")
    for name, values in rows.items():
        if name == "t":
            continue
        wild = np.abs(values) > LARGEST
        if wild.any():
            faults.append(f"{name} impossibly large in {_count(wild)}: taken as missing")
        values[wild] = np.nan
        faults.extend(_missing(name, values, t))
    if "ay" not in rows:
        faults.append("no ay: estimated without it")
        rows["ay"] = np.full(len(t), np.nan)
    log = Log(**rows, faults=tuple(faults))
    return replace(log, faults=(*faults, *doubts(log)))


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


def doubts(log: Log, car: Car | None = None) -> tuple[str, ...]:
    """Units and signs that are hardly right, in words; of the steering only where the car is given.

    A car that does not skid has ay = vx yaw_rate, and steers by about its wheelbase times yaw_rate / vx.
    """
    return (*_turning(log), *(_steering(log, car) if car else ()))


# ------------------------------------------------------------------ which column is which


def described() -> str:
    """The columns of a log with their units, for messages."""
    words = [f"{name} [{next(iter(units))}]" for name, (_, units) in COLUMNS.items() if name not in OPTIONAL]
    return f"{', '.join(words)}, and, where known, ay [m/s2] and vy [m/s]"


def _choose(path: Path, names: list[str], given: Mapping[str, str]) -> dict[str, tuple[str, float]]:
    """Column of the log -> its name in the file, and the size of its unit in SI."""
    for own, name in given.items():
        if own not in COLUMNS:
            raise InputError(f"column {own!r} is none of a log; want one of {', '.join(COLUMNS)}")
        if names.count(name) != 1:
            raise InputError(f"{path}: column {name!r} missing or there twice; has {', '.join(names)}")
    chosen = {}
    for own, (aliases, units) in COLUMNS.items():
        hits = {name: size for name in names if (size := _unit(name, aliases, units)) is not None}
        if own in given:
            chosen[own] = given[own], units.get(_split(given[own], units)[1], 1.0)
        elif own in names and names.count(own) == 1:
            chosen[own] = own, 1.0
        elif len(hits) == 1 and names.count(next(iter(hits))) == 1:
            chosen[own] = next(iter(hits.items()))
        elif hits:
            raise InputError(f"{path}: more than one column for {own}: {', '.join(hits)}; name one of them")
        elif own not in OPTIONAL:
            raise InputError(
                f"{path}: column {own} [{next(iter(units))}] missing; want {described()}; "
                f"has {', '.join(names)}"
            )
    return chosen


def _unit(name: str, aliases: tuple[str, ...], units: dict[str, float]) -> float | None:
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


# ------------------------------------------------------------------ what is wrong with it


def _count(rows: Any) -> str:
    n = int(rows.sum())
    return f"{n} row{'' if n == 1 else 's'}"


def _missing(name: str, values: Array, t: Array) -> Iterator[str]:
    """How often a column has no number, and for how long at most."""
    bad = np.isnan(values)
    if not bad.any():
        return
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(np.int8)))
    begin, end = edges[::2], np.minimum(edges[1::2], len(t) - 1)
    longest = float((t[end] - t[begin]).max())
    yield f"{name} missing in {_count(bad)}, at most {longest:.2f} s on end"


def _turning(log: Log) -> Iterator[str]:
    """Doubts about t, vx, yaw rate and ay, from ay = vx yaw_rate."""
    step = float(np.median(np.diff(log.t)))
    if step > LONGEST_GAP:
        yield f"{step:.3g} s between rows: t in ms?"
    turn = log.vx * log.yaw_rate
    turning = np.abs(turn[np.isfinite(turn)])
    if len(turning) and np.percentile(turning, 95.0) > 4.0 * G:
        yield "vx yaw_rate is more than a car can: yaw_rate in deg/s instead of rad/s, or vx in km/h?"
        return
    size, alike = _compared(turn, log.ay, 1.0)
    hints = {57.3: "yaw_rate in deg/s instead of rad/s", 9.81: "ay in g", 3.6: "vx in km/h"}
    near = min(hints, key=lambda factor: abs(np.log(size / factor)))
    if alike < -ALIKE:
        yield "yaw_rate and ay have opposite signs: are both positive to the left?"
    elif alike > ALIKE and size > 2.5:
        yield f"vx yaw_rate is {size:.2g} times ay: {hints[near]}?"
    elif alike > ALIKE and size < 0.4:
        yield f"vx yaw_rate is {size:.2g} times ay: is one of them in another unit?"


def _steering(log: Log, car: Car) -> Iterator[str]:
    """Doubts about the steering, from the angle that the wheelbase asks for."""
    moving = np.abs(log.vx) > 3.0
    curvature = np.divide(log.yaw_rate, log.vx, out=np.full(len(log.t), np.nan), where=moving)
    size, alike = _compared(log.samples(car)[:, 4], (car.front + car.rear) * curvature, 0.01)
    what = f"steering is {size:.2g} times what the wheelbase asks for"
    if alike < -ALIKE:
        yield "steering and yaw_rate have opposite signs: is steering positive to the left?"
    elif alike > ALIKE and size > 6.0:
        yield f"{what}: deg instead of rad, or the hand wheel without the car's steering_gain?"
    elif alike > ALIKE and size < 0.15:
        yield f"{what}: another unit, or a wrong steering_gain of the car?"


def _compared(a: Array, b: Array, least: float) -> tuple[float, float]:
    """How many times more a varies than b, and their correlation; 1 and 0 where there is too little of them.

    Only rows count where |a| + |b| is at least `least`.
    """
    both = np.isfinite(a) & np.isfinite(b)
    both[both] = np.abs(a[both]) + np.abs(b[both]) > least
    if both.sum() < ROWS:
        return 1.0, 0.0
    u, v = a[both] - a[both].mean(), b[both] - b[both].mean()
    size_u, size_v = float(np.sqrt(np.mean(u * u))), float(np.sqrt(np.mean(v * v)))
    if min(size_u, size_v) < 1e-9:
        return 1.0, 0.0
    return size_u / size_v, float(np.mean(u * v)) / (size_u * size_v)
