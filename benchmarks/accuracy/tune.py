"""Random search: the same number of evaluations and the same seed for every method.

Half of them are spread evenly in the logarithm over the ranges, half are drawn around the best so far, nearer
and nearer. The first evaluation is the default. The score is compare's J: velocity RMSE + 5 x yaw RMSE.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from benchmarks.accuracy.methods import Method, Range

from outrider.compare import LOST_M, Estimate, Series
from outrider.geometry import wrap
from outrider.observers import Motion
from outrider.records import Array

SEED = 11
LOST = 100.0  # added to the score for each series that is lost


class Found(NamedTuple):
    """The best of a search."""

    values: dict[str, float]  # by name of the gain
    score: float  # on the training sets
    evaluations: int


class Judge:
    """J and the number of lost series, as `compare.judge` has them, of many estimates of the same series."""

    def __init__(self, series: Sequence[Series], skip_s: float = 1.0, moving_mps: float = 2.0) -> None:
        lengths = [len(s.t) for s in series]
        self._starts = np.cumsum([0, *lengths[:-1]])
        self._of = np.repeat(np.arange(len(series)), lengths)
        self._p, self._v = (np.concatenate([getattr(s.truth, k) for s in series]) for k in ("W_p", "W_v"))
        self._yaw = np.concatenate([s.truth.yaw for s in series])
        late = np.concatenate([s.t - s.t[0] >= skip_s for s in series])
        speed = np.hypot(*self._v.T)
        self._counted = late & np.isfinite(speed + self._p[:, 0])
        self._moving = np.nan_to_num(speed) > moving_mps

    def __call__(self, estimates: Sequence[Estimate]) -> tuple[float, int]:
        """J, infinite where an estimate is not finite after its first finite row; lost series."""
        rows: Array = np.concatenate([e.motion for e in estimates])
        m, index = Motion(*rows.T), np.arange(len(rows))
        finite = np.isfinite(rows).all(axis=1)
        first = np.minimum.reduceat(np.where(finite, index, len(rows)), self._starts) % len(rows)
        counted = self._counted & (index >= first[self._of])
        off = np.where(finite, np.hypot(*(rows[:, :2] - self._p).T), np.inf)
        lost = int(np.logical_or.reduceat(counted & ~(off < LOST_M), self._starts).sum())
        if not finite[counted].all():
            return np.inf, lost
        v = np.column_stack([m.speed * np.cos(m.course), m.speed * np.sin(m.course)])
        yaw = wrap(m.yaw - self._yaw)[counted & self._moving]
        return _rms(np.hypot(*(v - self._v)[counted].T)) + 5.0 * _rms(yaw), lost


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2))) if len(x) else np.nan


def score(method: Method, values: Mapping[str, float], training: Mapping[Judge, Sequence[Series]]) -> float:
    """Mean over the training sets of J; infinite where it is not a number."""
    gains = method.gains(values)
    total = 0.0
    for judge, series in training.items():
        with np.errstate(all="ignore"):
            J, lost = judge(method.estimates(gains, series, quick=True))
        total += J + LOST * lost
    return total / len(training) if np.isfinite(total) else np.inf


def search(method: Method, training: Sequence[Sequence[Series]], budget: int, seed: int = SEED) -> Found:
    """Best gains of a method on some sets, within `budget` evaluations."""
    rng, judged = np.random.default_rng(seed), {Judge(series): series for series in training}
    ranges = method.ranges()
    low, high = np.log(np.array(list(ranges.values()))).T
    default = method.gains()._asdict()
    best = np.clip(np.log([max(default[name], 1e-12) for name in ranges]), low, high)
    least = score(method, _named(ranges, best), judged)
    for k in range(1, budget):
        width = 0.25 * (high - low) * 0.05 ** (k / budget)
        trial = rng.uniform(low, high) if k <= budget // 2 else rng.normal(best, width)
        trial = np.clip(trial, low, high)
        found = score(method, _named(ranges, trial), judged)
        if found < least:
            best, least = trial, found
    return Found(_named(ranges, best), least, budget)


def _named(ranges: Mapping[str, Range], logs: Sequence[float]) -> dict[str, float]:
    return {name: float(f"{np.exp(x):.4g}") for name, x in zip(ranges, logs, strict=True)}
