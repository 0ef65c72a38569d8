"""Every estimator on every drive: RMSE of vy, kept as JSON."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.lateral import cases

from outrider import lateral
from outrider.lateral import Array
from outrider.lateral.plant import NOISES

Row = dict[str, Any]


def estimate(method: cases.Method, truth: str, ride: cases.Ride, noise: str, roll: bool = True) -> Array:
    """vy (n,) as estimated [m/s]; NaN where it was held."""
    car, estimator = cases.told(truth, roll), lateral.get(method.estimator)
    samples = cases.log_of(truth, ride, noise).samples(car)
    gains = lateral.gains_from(estimator, method.values(noise))
    track = lateral.estimate(estimator, samples, car, gains)
    return np.where(track.held, np.nan, track.estimate[:, 0])


def rmse(vy: Array, truth: Array) -> float:
    """Root mean square of the difference where both are known [m/s]."""
    e = vy - truth
    return round(float(np.sqrt(np.nanmean(e * e))), 5)


def judge(truth: str, ride: cases.Ride, noise: str, roll: bool = True) -> Row:
    """One row: the drive, and the error of each method, whole and in its first and second half by way."""
    drive = cases.driven(truth, ride)
    second = drive.s > 0.5 * cases.way(ride.course).length
    errors, halves = {}, {}
    for method in cases.methods():
        vy = estimate(method, truth, ride, noise, roll)
        errors[method.label] = rmse(vy, drive.vy)
        halves[method.label] = [rmse(vy[part], drive.vy[part]) for part in (~second, second) if part.any()]
    return {
        "truth": truth,
        "roll": roll,
        **ride._asdict(),
        "noise": noise,
        "seconds": round(float(drive.t[-1]), 1),
        "whole": drive.whole,
        "largest_ay": round(float(np.abs(drive.vx * drive.yaw_rate).max()), 2),
        "rms_vy": rmse(np.zeros(len(drive.vy)), drive.vy),
        "rmse": errors,
        "halves": halves,
    }


def run(path: Path) -> None:
    """All rows and the tuned gains, to `path`."""
    rows: list[Row] = []
    begin = time.monotonic()
    for truth in cases.TRUTHS:
        for ride in cases.DRIVES:
            for noise in NOISES:
                rows.append(judge(truth, ride, noise))
                if truth == "multibody":
                    rows.append(judge(truth, ride, noise, roll=False))
            print(f"{time.monotonic() - begin:5.0f} s  {truth}, {ride.name}", file=sys.stderr)
    tuned = {m.label: {n: cases.tuned(m, n).gains for n in NOISES} for m in cases.methods() if m.tuned}
    path.write_text(json.dumps({"tuned": tuned, "rows": rows}, indent=1) + "\n")


def read(path: Path) -> dict[str, Any]:
    """What `run` wrote."""
    kept: dict[str, Any] = json.loads(path.read_text())
    return kept
