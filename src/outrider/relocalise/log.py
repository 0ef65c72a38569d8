"""What a robot with two range sensors logged of itself, from CSV or Parquet, with what was wrong with it.

The robot's axes: x forward, y left. Fixed frame W, that of the wall. A unit may be part of a column's name in
a file, as in `range_1_mm` or `w [deg/s]`; without one it is SI.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from outrider import log_columns
from outrider.errors import InputError
from outrider.log_columns import ANGLE, LENGTH, RATE, SPEED, TIME, Kind
from outrider.relocalise import Array

if TYPE_CHECKING:
    from outrider.relocalise.room import Room

KIND = Kind(
    {
        "t": (("t", "time"), TIME),
        "v": (("v", "speed"), SPEED),
        "w": (("w", "yaw_rate", "omega"), RATE),
        "range_1": (("range_1", "range1"), LENGTH),
        "range_2": (("range_2", "range2"), LENGTH),
        "angle_1": (("angle_1", "angle1"), ANGLE),
        "angle_2": (("angle_2", "angle2"), ANGLE),
        "x": (("x",), LENGTH),
        "y": (("y",), LENGTH),
        "theta": (("theta", "heading", "yaw"), ANGLE),
    },
    optional=("angle_1", "angle_2", "x", "y", "theta"),
)
ANGLES, TRUTH = ("angle_1", "angle_2"), ("x", "y", "theta")
FASTEST_TURN = 30.0  # no robot turns faster for long [rad/s]
SLOWEST_ROWS = 5.0  # longer between rows is hardly meant [s]


@dataclass(frozen=True, slots=True)
class Log:
    """A robot's odometry and its two ranges over time, as read: NaN where missing, t rising."""

    t: Array  # (n,) [s], not falling
    v: Array  # (n,) mean over the interval that ends at the row, forward, negative in reverse [m/s]
    w: Array  # (n,) yaw rate, likewise, to the left [rad/s]
    ranges: Array  # (n, 2) [m]; NaN: no return
    angles: Array | None = None  # (n, 2) of the sensors, from straight ahead [rad]; None: those of the room
    truth: Array | None = None  # (n, 3) measured or true pose of the robot, x, y [m], theta [rad]
    faults: tuple[str, ...] = ()  # what was wrong and what became of it, in words

    def columns(self) -> dict[str, Array]:
        """The columns of a file, by name, those that are known."""
        found = {"t": self.t, "v": self.v, "w": self.w, "range_1": self.ranges[:, 0]}
        found["range_2"] = self.ranges[:, 1]
        for names, values in ((ANGLES, self.angles), (TRUTH, self.truth)):
            if values is not None:
                found |= dict(zip(names, values.T, strict=True))
        return found

    def fingerprint(self) -> str:
        """SHA-256 of the columns, in hexadecimal; the same for the same numbers from any format."""
        return log_columns.fingerprint(self.columns())

    def part(self, begin: float, end: float) -> Log:
        """The rows with begin <= t < end [s]; InputError where there are fewer than two."""
        inside = log_columns.within(self.t, begin, end)
        return _log({name: values[inside] for name, values in self.columns().items()}, self.faults)


def read(path: Path | str, columns: Mapping[str, str] | None = None) -> Log:
    """A log from a CSV or Parquet file.

    columns: which column of the file is which of the log, where their names do not tell, such as
    {"range_1": "left [mm]"}. InputError for a file that cannot be read, a column that is missing or there
    twice, time that goes backwards, or fewer than two rows. Bad values become NaN and are counted.
    """
    path = Path(path)
    return checked(log_columns.read(path, KIND, columns or {}), str(path))


def write(log: Log, path: Path | str) -> None:
    """The log as a Parquet or CSV file, SI units; OutputError where that cannot be."""
    log_columns.write(Path(path), log.columns())


def checked(columns: Mapping[str, Array], where: str = "log") -> Log:
    """A log from columns (n,) in SI units, named as those of `KIND`; InputError as `read`.

    A range that is not positive, or infinite, is no return.
    """
    found, faults = {name: np.array(values, float) for name, values in columns.items()}, []
    for names in (ANGLES, TRUTH):
        if 0 < len(there := [name for name in names if name in found]) < len(names):
            raise InputError(f"{where}: {', '.join(there)} without the rest of {', '.join(names)}")
    for name in ("range_1", "range_2"):
        if name in found:
            values = found[name]
            if (negative := values <= 0.0).any():
                faults.append(f"{name} not positive in {log_columns.count(negative)}: taken as no return")
            values[negative | np.isinf(values)] = np.nan
    rows, others = log_columns.checked(found, KIND, where)
    log = _log(rows, (*faults, *others))
    return replace(log, faults=(*log.faults, *_rates(log)))


def doubts(log: Log, room: Room) -> tuple[str, ...]:
    """Units that are hardly right for this room, in words."""
    return tuple(_lengths(log, room))


def _log(rows: Mapping[str, Array], faults: tuple[str, ...]) -> Log:
    def stacked(*names: str) -> Array | None:
        return np.column_stack([rows[name] for name in names]) if names[0] in rows else None

    ranges = np.column_stack([rows["range_1"], rows["range_2"]])
    return Log(rows["t"], rows["v"], rows["w"], ranges, stacked(*ANGLES), stacked(*TRUTH), faults)


def _rates(log: Log) -> Iterator[str]:
    step = float(np.median(np.diff(log.t)))
    if step > SLOWEST_ROWS:
        yield f"{step:.3g} s between rows: t in ms?"
    turns = np.abs(log.w[np.isfinite(log.w)])
    if len(turns) and np.percentile(turns, 95.0) > FASTEST_TURN:
        yield f"w is {np.percentile(turns, 95.0):.3g} rad/s and more: deg/s instead of rad/s?"


def _lengths(log: Log, room: Room) -> Iterator[str]:
    for i, values in enumerate(log.ranges.T):
        good = values[np.isfinite(values)]
        if len(good) and np.median(good) > 2.0 * room.wall.diameter:
            yield (
                f"range_{i + 1} is mostly over twice the room's {room.wall.diameter:.3g} m: "
                "another unit, such as mm, or another room?"
            )
        elif len(good) and np.percentile(good, 99.0) < 0.02 * room.wall.diameter:
            yield f"range_{i + 1} is never over {np.percentile(good, 99.0):.2g} m: another unit?"
