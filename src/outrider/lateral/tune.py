"""Tuning of the ultra-local model: how much of it, in bins of speed or of lateral acceleration.

Every value of a grid is tried on all logs, the same in all bins, and the error of vy is counted in each bin:

    greedy   from none of it upwards until the error stops falling: Fenyes et al. 2023, section 3.3
    grid     the value with the least error
    curve    through the grid's: level, then a slope, then level, as the source's fitted curve
    joint    from the grid's on, one bin after the other changed while the error of all rows falls

The greedy one may stop before a second, lower minimum. Bins tried alone do not know that the error made in
one is carried into the next; the joint one does, but fits the noise of its logs too: give it several.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import exp, isfinite
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from outrider import __version__, cars, lateral
from outrider.cars import Car
from outrider.errors import InputError, OutputError
from outrider.lateral import Array
from outrider.lateral._search import KINDS, LEAST_ROWS, METHODS, Ints, Kind, ramp, search
from outrider.lateral.estimators import ultra_local
from outrider.lateral.estimators._ultra import BINS, FIXED, SIDE, SPEED, middles
from outrider.lateral.log import Log
from outrider.models.single_track import linear, sampled


class Source(msgspec.Struct, frozen=True, kw_only=True):
    """A log that was tuned on."""

    rows: int  # that were counted
    sha256: str  # of its columns, see `Log.fingerprint`


class Tuned(msgspec.Struct, frozen=True, kw_only=True):
    """What was tried, what came out, on what; a row for each of the seven bins."""

    estimator: str
    gains: dict[str, float]  # for `lateral.gains_from`
    method: str
    over: str  # the bins are of "speed" [m/s] or of low-passed |"ay"| [m/s2]
    edges: list[float]  # (7,) lower edges; the last bin has no end
    rows: list[int]  # (7,) counted in each
    rms_vy_mps: list[float | None]  # (7,) what an estimate of 0 is wrong by
    grid: list[float]  # (m,) values tried, from none of it upwards: k [-], or alpha [m/s2 per rad]
    rmse_mps: list[list[float | None]]  # (m, 7) of vy, the same value in all bins
    values: dict[str, list[float]]  # method -> (7,) values
    rmse_of: dict[str, float]  # method, or "none" of it -> rmse of vy over all rows [m/s]
    dt_s: float  # usual step of the logs
    car: dict[str, float]
    logs: list[Source]
    version: str

    @property
    def middles(self) -> Array:
        """(7,) middles of the bins, [m/s] or [m/s2]."""
        return middles((*self.edges, np.inf))

    @property
    def curve(self) -> tuple[Array, Array]:
        """Points (200,) of the fitted curve, and its strength there: k, or 1 / alpha."""
        x = np.linspace(self.middles[0], self.middles[-1], 200)
        strength = KINDS[self.estimator].strength(self.values["grid"])
        return x, np.maximum(ramp(self.middles, strength, np.array(self.rows), x), 0.0)

    def alpha(self, strength: Array, x: Array) -> Array:
        """Alpha [m/s2 per rad] of strengths (n,) at bin quantities x (n,); inf where it is nothing.

        Of a share k it is Gamma1 / (dt k) at the speed, or at 10 m/s where the bins are of ay.
        """
        push = np.ones(len(x))
        if KINDS[self.estimator].gain == "k":
            car, speeds = Car(**self.car), x if self.over == "speed" else np.full(len(x), FIXED)
            push = np.array([sampled(linear(float(v), car), self.dt_s).b1 for v in speeds]) / self.dt_s
        made: Array = np.divide(push, strength, out=np.full(len(x), np.inf), where=strength > 0.0)
        return made


class _Try(NamedTuple):
    """One log, ready for the estimator."""

    samples: Array  # (n, 5)
    vy: Array  # (n,) [m/s]
    place: Ints  # (n,) its bin; -1 where nothing is counted
    source: Source

    def counted(self, e: Array) -> Array:
        """Sum of squares (7,) of e (n,) in each bin."""
        used = self.place >= 0
        return np.asarray(np.bincount(self.place[used], e[used] ** 2, BINS), float)


class _Trial(NamedTuple):
    """What is tried on what."""

    estimator: lateral.Estimator
    car: Car
    dt: float  # [s]
    fixed: dict[str, float]  # gains that are not tuned
    keys: list[str]  # those that are
    tries: list[_Try]

    def gains(self, values: Sequence[float]) -> dict[str, float]:
        """All gains that are not the defaults, for values (7,)."""
        return self.fixed | dict(zip(self.keys, values, strict=True))

    def squares(self, values: Sequence[float]) -> Array:
        """Sum of squared errors of vy in each bin (7,) [m2/s2], for values (7,)."""
        gains = lateral.gains_from(self.estimator, self.gains(values))
        run = (lateral.estimate(self.estimator, t.samples, self.car, gains, self.dt) for t in self.tries)
        total: Array = np.zeros(BINS)
        for t, track in zip(self.tries, run, strict=True):
            total += t.counted(track.estimate[:, 0] - t.vy)
        return total


def tune(
    logs: Sequence[Log],
    car: Car,
    estimator: str = "ultra_local",
    over: str = "",
    method: str = "grid",
    gains: Mapping[str, float] | None = None,
) -> Tuned:
    """Tune on logs that have vy; gains: what else is to differ from the estimator's defaults.

    estimator: "ultra_local", in bins over "ay" or "speed", or "ultra_local_published", over "speed"; "": the
    first of these. InputError for what is not known, for a gain that is tuned here, and for no log, a log
    without vy or without rows to count.
    """
    kind = _kind(estimator, method)
    over = over or kind.over[0]
    if over not in kind.over:
        raise InputError(f"over {over!r}; want one of {', '.join(kind.over)} for {estimator}")
    edges = SIDE if over == "ay" else SPEED
    tries = [_ready(log, i, car, edges, over) for i, log in enumerate(logs)]
    rows = _rows(tries, over)
    dt, keys = _usual(logs), [f"{kind.gain}{i + 1}" for i in range(BINS)]
    fixed = dict(gains or {}) | ({"over": float(over == "ay"), "dt": dt} if kind.gain == "k" else {})
    if taken := set(keys) & set(fixed):
        raise InputError(f"gain {min(taken)} is what is tuned; leave it out")
    trial = _Trial(lateral.get(estimator), car, dt, fixed, keys, tries)
    errors = np.array([trial.squares([value] * BINS) for value in kind.grid])
    values = search(trial.squares, errors, rows, middles(edges), kind)
    counted = {"none": [kind.grid[0]] * BINS, **values}
    return Tuned(
        estimator=estimator,
        gains=trial.gains(values[method]),
        method=method,
        over=over,
        edges=list(edges[:-1]),
        rows=rows.tolist(),
        rms_vy_mps=_roots(np.sum([t.counted(t.vy) for t in tries], axis=0), rows),
        grid=list(kind.grid),
        rmse_mps=[_roots(row, rows) for row in errors],
        values=values,
        rmse_of={name: float(np.sqrt(trial.squares(v).sum() / rows.sum())) for name, v in counted.items()},
        dt_s=dt,
        car=car._asdict(),
        logs=[t.source for t in tries],
        version=__version__,
    )


def save(tuned: Tuned, path: Path | str) -> None:
    """Write as JSON; OutputError where that cannot be."""
    try:
        Path(path).write_bytes(msgspec.json.format(msgspec.json.encode(tuned)) + b"\n")
    except OSError as error:
        raise OutputError(f"{path}: cannot write ({error.strerror}); choose another place") from error


def load(path: Path | str) -> Tuned:
    """What `save` wrote, its gains checked; InputError for what is none."""
    try:
        tuned = msgspec.json.decode(Path(path).read_bytes(), type=Tuned)
    except OSError as error:
        raise InputError(f"{path}: cannot read gains ({error.strerror}); want a file of `tune`") from error
    except msgspec.DecodeError as error:
        raise InputError(f"{path}: no gains ({error}); want a file of `tune`") from error
    try:
        car, estimator = cars.checked(Car(**tuned.car), "car"), lateral.get(tuned.estimator)
        estimator.prepare(car, lateral.gains_from(estimator, tuned.gains), tuned.dt_s)
    except (InputError, TypeError) as error:
        raise InputError(f"{path}: {error}") from error
    return tuned


# ------------------------------------------------------------------ what is counted


def _kind(estimator: str, method: str) -> Kind:
    if estimator not in KINDS:
        raise InputError(f"estimator {estimator!r} has no alpha to tune; want one of {', '.join(KINDS)}")
    if method not in METHODS:
        raise InputError(f"method {method!r} is not known; want one of {', '.join(METHODS)}")
    return KINDS[estimator]


def _usual(logs: Sequence[Log]) -> float:
    """The usual step of all logs together, to the nanosecond [s]."""
    steps = np.concatenate([np.diff(log.t) for log in logs])
    return round(float(np.median(steps[steps > 0.0])), 9)


def _ready(log: Log, i: int, car: Car, edges: Sequence[float], over: str) -> _Try:
    samples = log.samples(car)
    if log.vy is None or not np.isfinite(log.vy).any():
        raise InputError(f"log {i + 1} has no vy; tuning wants it measured or simulated: column vy [m/s]")
    x = np.abs(samples[:, 1] if over == "speed" else low_passed(samples))
    known = np.isfinite(x) & np.isfinite(log.vy)
    known &= ~lateral.estimate(lateral.get("ultra_local"), samples, car).held
    place: Ints = np.searchsorted(edges, np.where(known, x, -1.0), side="right") - 1
    place = np.where(known, place, -1)
    return _Try(samples, log.vy, place, Source(rows=int((place >= 0).sum()), sha256=log.fingerprint()))


def _rows(tries: Sequence[_Try], over: str) -> Ints:
    """Rows (7,) that are counted in each bin."""
    places = np.concatenate([t.place for t in tries]) if tries else np.zeros(0, int)
    rows: Ints = np.bincount(places[places >= 0], minlength=BINS)
    if not (rows >= LEAST_ROWS).any():
        raise InputError(f"no bin of {over} has {LEAST_ROWS} rows with vy; want logs, and longer ones")
    return rows


def low_passed(samples: Array) -> Array:
    """(n,) ay as `ultra_local` smooths it for its table, from samples (n, 5) [m/s2]; NaN before the first."""
    out, side = np.full(len(samples), np.nan), np.nan
    for i, (dt, ay) in enumerate(samples[:, [0, 3]].tolist()):
        if isfinite(ay):
            keep = exp(-dt / ultra_local.LAG) if dt > 0.0 else 1.0
            side = ay if side != side else keep * side + (1.0 - keep) * ay
        out[i] = side
    return out


def _roots(squares: Array, rows: Ints) -> list[float | None]:
    return [
        float(np.sqrt(s / n)) if n else None for s, n in zip(squares.tolist(), rows.tolist(), strict=True)
    ]
