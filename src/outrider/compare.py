"""Observers side by side: the same measurements to each, one row of figures each."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from outrider import observers
from outrider.certificate import Bound
from outrider.errors import InputError
from outrider.geometry import wrap
from outrider.metrics import Truth
from outrider.observers import Motion, Spread
from outrider.records import Array

LOST_M = 5.0  # an estimate further off than this has diverged [m]
CHI2_95 = 9.488  # 95 % quantile of chi-square with 4 degrees of freedom
LEAST = 1e-3  # standard deviation below which none is believed [m, m/s]
DISTURBANCES = ("position", "position along", "position across")  # errors of the measurement
ERRORS = (*DISTURBANCES, "speed", "course")  # of the estimate, which a certificate may bound by these


@dataclass(frozen=True, slots=True)
class Series:
    """What one vehicle looked like, scan by scan, and how it really moved; full-size lengths."""

    name: str
    t: Array  # (n,) increasing [s]
    y: Array  # (n, 9) observers.Measurement; NaN position: not seen
    truth: Truth  # at the times t


class Promise(NamedTuple):
    """What a certificate says of the errors that measured positions cause."""

    bounds: tuple[Bound, ...]
    speeds: tuple[float, float]  # from, to: where it holds [m/s]


@dataclass(frozen=True, slots=True)
class Estimate:
    """What an observer made of a series; rows before its start, or within its lag of the end, are NaN."""

    motion: Array  # (n, 8) observers.Motion
    spread: Array  # (n, 10) observers.Spread; NaN where the observer keeps no covariance
    lag: int = 0  # how many scans later it was made
    promise: Promise | None = None  # what a certificate says of its errors


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
    nees: float  # moving bodies: mean normalised squared error of position and velocity, 4 if consistent
    outside: float  # share of these samples outside the observer's own 95 % ellipsoid; NaN: no covariance
    beyond: float = np.nan  # share of samples with an error beyond a certificate's bound; NaN: no bound

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
    motion = observers.described(observer, states[0], gains)
    return Estimate(motion, observers.spreads(observer, states[0], gains), lag)


def promise(observer: Any, gains: Any, lag: int = 0) -> Promise | None:
    """What the observer's certificate says of the errors that measured positions cause, with these gains.

    None where it says nothing: it holds for the default gains, for no smoothed estimate, and if it is proven.
    """
    certificate = None if lag or gains != observer.Gains() else observer.certificate()
    if certificate is None or not certificate.proven():
        return None
    known = (b for b in certificate.bounds if b.of in ERRORS and b.by in DISTURBANCES and b.kind == "peak")
    low, high = certificate.region.get("speed [m/s]", (0.0, np.inf))
    bounds = tuple(known)
    return Promise(bounds, (low, high)) if bounds else None


def step_time(
    observer: Any, gains: Any, series: Sequence[Series], lag: int = 0, steps: int = 20_000
) -> float:
    """Time of one step [us], over at least so many of them: the longest series, repeated; best of five.

    On one core, in a batch, compiled before. InputError where there is no series.
    """
    if not series:
        raise InputError("no series to time the observer on; want at least one")
    longest = max(series, key=lambda s: len(s.t))
    n = -(-steps // len(longest.t))
    dt = np.tile(np.diff(longest.t, prepend=longest.t[0]), (n, 1))
    y = np.tile(longest.y, (n, 1, 1))
    taken = []
    for _ in range(6):  # the first one compiles, or finds what was compiled
        begin = time.perf_counter()
        states = observers.batch(observer, y, dt, gains)
        if lag:
            observers.lagged(observer, states, dt, lag, gains)
        taken.append(time.perf_counter() - begin)
    return 1e6 * min(taken[1:]) / dt.size


def judge(
    estimates: Sequence[Estimate], series: Sequence[Series], skip_s: float = 1.0, moving_mps: float = 2.0
) -> Figures:
    """Figures over all samples later than `skip_s` after the first sample of their series.

    Course, yaw and covariance count where the true speed is above `moving_mps`. An estimate that is not
    finite is infinitely wrong.
    """
    errors = [_errors(e, s, skip_s, moving_mps) for e, s in zip(estimates, series, strict=True) if len(s.t)]
    lost = sum(not bool((e[:, 0] < LOST_M).all()) for e in errors)
    e = np.concatenate(errors) if errors else np.zeros((0, 8))
    position, speed, velocity, course, yaw, nees, beyond, moving = e.T
    course, yaw, nees = course[moving > 0.0], yaw[moving > 0.0], nees[moving > 0.0]
    flipped = np.abs(yaw[np.isfinite(yaw)]) > 0.5 * np.pi
    known, bounded = np.isfinite(nees), np.isfinite(beyond)
    return Figures(
        samples=len(e),
        position_m=_rms(position),
        speed_mps=_rms(speed),
        velocity_mps=_rms(velocity),
        course_rad=_rms(course),
        yaw_rad=_rms(yaw),
        divergences=lost,
        heading_flips=int(flipped.sum()),
        nees=float(nees[known].mean()) if known.any() else np.nan,
        outside=float((nees[known] > CHI2_95).mean()) if known.any() else np.nan,
        beyond=float(beyond[bounded].mean()) if bounded.any() else np.nan,
    )


def _errors(e: Estimate, s: Series, skip_s: float, moving_mps: float) -> Array:
    """Rows (m, 8): position, speed, velocity, course, yaw, NEES, whether beyond a bound, whether moving.

    From the first estimate on, without the last ones that only a lag leaves open. The first five are inf
    where the estimate is not finite; NEES and bound are NaN where there is none.
    """
    true_speed = np.hypot(*s.truth.W_v.T)
    counted = (s.t - s.t[0] >= skip_s) & np.isfinite(true_speed + s.truth.W_p[:, 0])
    finite = np.isfinite(e.motion).all(axis=1)
    begun = int(finite.argmax()) if finite.any() else 0
    counted &= (np.arange(len(s.t)) >= begun) & (np.arange(len(s.t)) < len(s.t) - e.lag)
    speed, course, yaw = e.motion[:, [Motion._fields.index(name) for name in ("speed", "course", "yaw")]].T
    v = speed[:, None] * np.column_stack([np.cos(course), np.sin(course)])
    dp, dv = e.motion[:, :2] - s.truth.W_p, v - s.truth.W_v
    reverse = np.where(speed < 0.0, np.pi, 0.0)
    turn = wrap(course + reverse - np.arctan2(s.truth.W_v[:, 1], s.truth.W_v[:, 0]))
    moving = true_speed > moving_mps
    columns = np.column_stack(
        [np.hypot(*dp.T), np.abs(speed) - true_speed, np.hypot(*dv.T), turn, wrap(yaw - s.truth.yaw)]
    )
    columns[~finite] = np.inf
    nees = _nees(np.column_stack([dp, dv]), e.spread)
    rows: Array = np.column_stack([columns, nees, _beyond(columns, dp, e, s), moving])[counted]
    return rows


def _beyond(columns: Array, dp: Array, e: Estimate, s: Series) -> Array:
    """(n,) 1 where an error is beyond a bound for the largest measurement error of the series, else 0.

    NaN where nothing is bounded: no certificate, or a speed outside its region. Along and across: of the true
    course.
    """
    if e.promise is None:
        return np.full(len(s.t), np.nan)
    speed = np.hypot(*s.truth.W_v.T)
    low, high = e.promise.speeds
    held = (speed >= low) & (speed <= high) & (speed > 0.0)
    ahead = np.divide(s.truth.W_v, speed[:, None], out=np.zeros_like(dp), where=held[:, None])
    off = dict(zip(DISTURBANCES, _parts(s.y[:, :2] - s.truth.W_p, ahead), strict=True))
    errors = dict(zip(ERRORS, (*_parts(dp, ahead), columns[:, 1], columns[:, 3]), strict=True))
    out = np.where(held, 0.0, np.nan)
    for bound in e.promise.bounds:
        known = held & np.isfinite(off[bound.by])
        largest = np.max(np.abs(off[bound.by]), where=known, initial=0.0)
        out = np.where(held & ~(np.abs(errors[bound.of]) <= bound.gain * largest), 1.0, out)
    return out


def _parts(d: Array, ahead: Array) -> tuple[Array, Array, Array]:
    """Length of d (n, 2), and its parts along and across the directions `ahead` (n, 2)."""
    return (
        np.hypot(*d.T),
        d[:, 0] * ahead[:, 0] + d[:, 1] * ahead[:, 1],
        d[:, 1] * ahead[:, 0] - d[:, 0] * ahead[:, 1],
    )


def _nees(error: Array, spread: Array) -> Array:
    """Errors (n, 4) of position and velocity, squared and normalised by the covariance.

    NaN where there is none, or it is singular, as where a bicycle stands: its velocity has one direction.
    """
    out = np.full(len(error), np.nan)
    known = np.flatnonzero(np.isfinite(spread).all(axis=1) & np.isfinite(error).all(axis=1))
    c = Spread(*spread[known].T)
    half = [
        [c.xx, c.xy, c.xu, c.xv],
        [c.xy, c.yy, c.yu, c.yv],
        [c.xu, c.yu, c.uu, c.uv],
        [c.xv, c.yv, c.uv, c.vv],
    ]
    P = np.array(half).transpose(2, 0, 1) + LEAST**2 * np.eye(4)
    spectrum = np.linalg.eigvalsh(P)
    regular = spectrum[:, 0] > 1e-12 * spectrum[:, 3]
    known, P = known[regular], P[regular]
    e = error[known]
    out[known] = np.einsum("ni,ni->n", e, np.linalg.solve(P, e[..., None])[..., 0])
    return out


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2))) if len(error) else np.nan
