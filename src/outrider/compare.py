"""Observers side by side: the same measurements to each, one row of figures each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from outrider import observers
from outrider.geometry import wrap
from outrider.metrics import Truth
from outrider.observers import Motion, Spread
from outrider.records import Array

LOST_M = 5.0  # an estimate further off than this has diverged [m]
CHI2_95 = 9.488  # 95 % quantile of chi-square with 4 degrees of freedom


@dataclass(frozen=True, slots=True)
class Series:
    """What one vehicle looked like, scan by scan, and how it really moved; full-size lengths."""

    name: str
    t: Array  # (n,) increasing [s]
    y: Array  # (n, 9) observers.Measurement; NaN position: not seen
    truth: Truth  # at the times t


@dataclass(frozen=True, slots=True)
class Estimate:
    """What an observer made of a series; rows before its start, or within its lag of the end, are NaN."""

    motion: Array  # (n, 8) observers.Motion
    spread: Array  # (n, 10) observers.Spread; NaN where the observer keeps no covariance


@dataclass(frozen=True, slots=True)
class Figures:
    """Errors of one observer over some series, pooled over samples; RMS where nothing else is said."""

    samples: int
    position_m: float
    speed_mps: float
    velocity_mps: float  # length of the error of the vector
    course_rad: float  # moving bodies; direction of motion
    yaw_rad: float  # moving bodies
    divergences: int  # series with an estimate not finite or further off than LOST_M
    heading_flips: int  # samples, moving bodies, with the yaw wrong by more than 90 deg
    nees: float  # mean normalised squared error of position and velocity, 4 if consistent; NaN: no covariance
    outside: float  # share of samples outside the observer's own 95 % ellipsoid; NaN: no covariance

    @property
    def J(self) -> float:
        """Velocity RMSE [m/s] + 5 x yaw RMSE [rad]: one number to rank and tune by."""
        return self.velocity_mps + 5.0 * self.yaw_rad


def estimate(observer: Any, gains: Any, series: Series, lag: int = 0) -> Estimate:
    """The observer's motion and covariance at each sample, known `lag` samples later."""
    dt = np.diff(series.t, prepend=series.t[0])
    states = observers.batch(observer, series.y[None], dt[None], gains)
    if lag:
        states = observers.lagged(observer, states, dt[None], lag, gains)
    return Estimate(
        observers.described(observer, states[0], gains), observers.spreads(observer, states[0], gains)
    )


def judge(
    estimates: Sequence[Estimate], series: Sequence[Series], skip_s: float = 1.0, moving_mps: float = 2.0
) -> Figures:
    """Figures over all samples later than `skip_s` after the first sample of their series.

    Course and yaw count where the true speed is above `moving_mps`.
    """
    errors = [_errors(e, s, skip_s, moving_mps) for e, s in zip(estimates, series, strict=True) if len(s.t)]
    lost = sum(not bool((np.abs(e[:, 0]) < LOST_M).all()) for e in errors)  # NaN is lost too
    e = np.concatenate(errors) if errors else np.zeros((0, 7))
    position, speed, velocity, course, yaw, nees, _ = e.T
    known = np.isfinite(nees)
    return Figures(
        samples=len(e),
        position_m=_rms(position),
        speed_mps=_rms(speed),
        velocity_mps=_rms(velocity),
        course_rad=_rms(course[np.isfinite(e[:, 6])]),
        yaw_rad=_rms(yaw[np.isfinite(e[:, 6])]),
        divergences=lost,
        heading_flips=int((np.abs(yaw[np.isfinite(e[:, 6])]) > 0.5 * np.pi).sum()),
        nees=float(nees[known].mean()) if known.any() else np.nan,
        outside=float((nees[known] > CHI2_95).mean()) if known.any() else np.nan,
    )


def _errors(e: Estimate, s: Series, skip_s: float, moving_mps: float) -> Array:
    """Rows (m, 7): position, speed, velocity, course, yaw, NEES, and 0 where the body moves, else NaN.

    An estimate that is missing after the first and before the last finite one counts as lost: inf.
    """
    m = Motion(*e.motion.T)
    v = np.column_stack([m.speed * np.cos(m.course), m.speed * np.sin(m.course)])
    dp, dv = e.motion[:, :2] - s.truth.W_p, v - s.truth.W_v
    true_speed = np.hypot(*s.truth.W_v.T)
    reverse = np.where(m.speed < 0.0, np.pi, 0.0)
    course = wrap(m.course + reverse - np.arctan2(s.truth.W_v[:, 1], s.truth.W_v[:, 0]))
    rows = np.column_stack(
        [
            np.hypot(*dp.T),
            np.abs(m.speed) - true_speed,
            np.hypot(*dv.T),
            course,
            wrap(m.yaw - s.truth.yaw),
            _nees(np.column_stack([dp, dv]), e.spread),
            np.where(true_speed > moving_mps, 0.0, np.nan),
        ]
    )
    counted = (s.t - s.t[0] >= skip_s) & np.isfinite(true_speed + s.truth.W_p[:, 0])
    found = np.flatnonzero(np.isfinite(e.motion).all(axis=1))
    if not len(found):
        return np.full((int(counted.sum()), 7), np.nan)
    counted &= (np.arange(len(s.t)) >= found[0]) & (np.arange(len(s.t)) <= found[-1])
    kept: Array = rows[counted]
    return kept


def _nees(error: Array, spread: Array) -> Array:
    """Errors (n, 4) of position and velocity, squared and normalised by the covariance; NaN: none."""
    out = np.full(len(error), np.nan)
    known = np.isfinite(spread).all(axis=1) & np.isfinite(error).all(axis=1)
    c = Spread(*spread[known].T)
    half = [
        [c.xx, c.xy, c.xu, c.xv],
        [c.xy, c.yy, c.yu, c.yv],
        [c.xu, c.yu, c.uu, c.uv],
        [c.xv, c.yv, c.uv, c.vv],
    ]
    P = np.array(half).transpose(2, 0, 1)
    e = error[known]
    out[known] = np.einsum("ni,ni->n", e, np.linalg.solve(P, e[..., None])[..., 0])
    return out


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2))) if len(error) else np.nan
