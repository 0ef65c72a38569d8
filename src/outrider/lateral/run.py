"""One log through one estimator: the estimate, its error where vy was measured, and a folder for both."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from outrider import __version__, cars
from outrider import lateral as estimators
from outrider.cars import Car
from outrider.errors import InputError
from outrider.lateral import LEAST_SPEED, LONGEST_GAP, Array, Bools, Track
from outrider.lateral.log import Log, doubts

DEFAULT = "kalman"  # estimator


@dataclass(frozen=True, slots=True)
class Run:
    """A log and what an estimator made of it."""

    log: Log
    car: Car
    estimator: str
    gains: Any  # the estimator's Gains
    track: Track  # a row for each of the log
    seconds: float  # that the estimate took, compilation apart
    doubts: tuple[str, ...]  # about units and signs, in words

    @property
    def slip(self) -> Array:
        """(n,) angle from the body's axis to the velocity [rad], NaN below LEAST_SPEED: atan(vy / vx)."""
        moving = np.abs(self.log.vx) >= LEAST_SPEED
        ratio = np.divide(
            self.track.estimate[:, 0], self.log.vx, out=np.full(len(moving), np.nan), where=moving
        )
        slip: Array = np.arctan(ratio)
        return slip

    def columns(self) -> dict[str, Array | Bools]:
        """The columns of estimate.parquet, by name."""
        vy, yaw_rate, bias = self.track.estimate.T
        head = {"t": self.log.t, "vx": self.log.vx, "vy": vy, "slip": self.slip}
        return {**head, "yaw_rate": yaw_rate, "bias": bias, "held": self.track.held}

    def errors(self) -> Array:
        """(n,) vy estimated minus measured [m/s]; NaN where it was held or not measured."""
        if self.log.vy is None:
            return np.full(len(self.log.t), np.nan)
        return np.where(self.track.held, np.nan, self.track.estimate[:, 0] - self.log.vy)

    def summary(self) -> dict[str, Any]:
        """What came out, in figures that JSON can hold."""
        t, held = self.log.t, self.track.held
        steps = np.diff(t)
        return {
            "version": __version__,
            "estimator": self.estimator,
            "rows": len(t),
            "duration_s": float(t[-1] - t[0]),
            "rate_hz": float(1.0 / np.median(steps[steps > 0.0])) if (steps > 0.0).any() else None,
            "longest_gap_s": float(steps.max()),
            "gaps": int((steps > LONGEST_GAP).sum()),
            "held_rows": int(held.sum()),
            "held_s": float(steps[held[1:]].sum()),
            "slow_rows": int((np.abs(self.log.vx) < LEAST_SPEED).sum()),
            "faults": list(self.log.faults),
            "doubts": list(self.doubts),
            "vy": _spread(self.track.estimate[~held, 0]),
            "slip": _spread(self.slip[~held]),
            "bias_radps": float(self.track.estimate[-1, 2]),
            "error": score(self.errors(), self.log.vy),
            "log_sha256": self.log.fingerprint(),
            "seconds": self.seconds,
        }


def run(log: Log, car: Car, estimator: str = DEFAULT, gains: Mapping[str, float] | None = None) -> Run:
    """The estimate for a log; InputError for an unknown estimator or gain, or a car that cannot be."""
    chosen = estimators.get(estimator)
    values = estimators.gains_from(chosen, gains or {})
    cars.checked(car, "car")
    samples = log.samples(car)
    estimators.estimate(chosen, samples[:2], car, values)  # compiles
    begin = time.perf_counter()
    track = estimators.estimate(chosen, samples, car, values)
    took = time.perf_counter() - begin
    wrong = tuple(text for text in doubts(log, car) if text not in log.faults)
    return Run(log, car, estimator, values, track, took, wrong)


def chosen(path: Path | str) -> tuple[str, dict[str, float]]:
    """Estimator and gains of an earlier run, by its settings.toml; InputError where that is none."""
    path = Path(path)
    try:
        made = msgspec.toml.decode(path.read_bytes(), type=_Chosen)
    except OSError as error:
        raise InputError(f"{path}: cannot read ({error.strerror}); want settings.toml of a run") from error
    except msgspec.DecodeError as error:
        raise InputError(f"{path}: no settings ({error}); want estimator and [gains]") from error
    return made.estimator, made.gains


class _Chosen(msgspec.Struct, frozen=True):
    """What settings.toml of a run says of the estimator."""

    estimator: str
    gains: dict[str, float]


def score(errors: Array, vy: Array | None) -> dict[str, float] | None:
    """RMS and largest error of vy, beside the RMS of vy itself, which is the error of always 0 [m/s]."""
    good = np.isfinite(errors)
    if vy is None or not good.any():
        return None
    e, truth = errors[good], vy[good]
    return {
        "rmse_mps": _rms(e),
        "rms_vy_mps": _rms(truth),
        "mean_mps": float(e.mean()),
        "largest_mps": float(np.abs(e).max()),
        "rows": int(good.sum()),
    }


def save(made: Run, folder: Path | str, force: bool = False, about: Mapping[str, Any] | None = None) -> None:
    """Write estimate.parquet, summary.json, settings.toml and car.toml.

    about: what else settings.toml says, text or numbers. InputError for a folder that may not be used,
    OutputError where the file system refuses.
    """
    from outrider.io import _log_table
    from outrider.io._folder import describe, prepare

    folder = Path(folder)
    prepare(folder, force)
    _log_table.write(folder / "estimate.parquet", made.columns())
    cars.save(made.car, folder / "car.toml")
    told = {"version": __version__, **(about or {}), "estimator": made.estimator, "car": "car.toml"}
    describe(folder, made.summary(), told, made.gains._asdict())


def _spread(values: Array) -> dict[str, float] | None:
    good = values[np.isfinite(values)]
    return {"rms": _rms(good), "least": float(good.min()), "most": float(good.max())} if len(good) else None


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values * values)))
