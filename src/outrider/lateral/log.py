"""What a car logged of itself: frozen columns, read from CSV or Parquet, with what was wrong with them.

Body frame: x forward, y left; the centre of gravity. A unit may be part of a column's name in a file, as in
`vx_kmh` or `vx [km/h]`; without one it is SI.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from outrider import log_columns
from outrider.cars import Car
from outrider.lateral import LONGEST_GAP, Array
from outrider.log_columns import ACCELERATION, ANGLE, RATE, SPEED, TIME, G, Kind

KIND = Kind(
    {
        "t": (("t", "time"), TIME),
        "vx": (("vx", "speed"), SPEED),
        "yaw_rate": (("yaw_rate",), RATE),
        "ay": (("ay",), ACCELERATION),
        "steering": (("steering", "delta"), ANGLE),
        "vy": (("vy",), SPEED),
    },
    optional=("ay", "vy"),
)
COLUMNS = KIND.columns
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
        return log_columns.fingerprint({name: getattr(self, name) for name in COLUMNS})

    def part(self, begin: float, end: float) -> Log:
        """The rows with begin <= t < end [s]; InputError where there are fewer than two."""
        inside = log_columns.within(self.t, begin, end)
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
    path = Path(path)
    return checked(log_columns.read(path, KIND, columns or {}), str(path))


def write(log: Log, path: Path | str) -> None:
    """The log as a Parquet or CSV file, SI units; OutputError where that cannot be."""
    log_columns.write(Path(path), {name: getattr(log, name) for name in COLUMNS})


def checked(columns: Mapping[str, Array], where: str = "log") -> Log:
    """A log from columns (n,) in SI units, named as those of `Log`; InputError as `read`."""
    rows, faults = log_columns.checked(columns, KIND, where)
    if "ay" not in rows:
        faults.append("no ay: estimated without it")
        rows["ay"] = np.full(len(rows["t"]), np.nan)
    log = Log(**rows, faults=tuple(faults))
    return replace(log, faults=(*faults, *doubts(log)))


def doubts(log: Log, car: Car | None = None) -> tuple[str, ...]:
    """Units and signs that are hardly right, in words; of the steering only where the car is given.

    A car that does not skid has ay = vx yaw_rate, and steers by about its wheelbase times yaw_rate / vx.
    """
    return (*_turning(log), *(_steering(log, car) if car else ()))


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
