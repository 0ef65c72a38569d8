"""What the peers have in common: how they start, what they are told of a sample, and what is read off them.

A peer has `Gains`, `reference` and `estimate(gains, series) -> Estimate`: the shape of `compare.estimate`.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from outrider.compare import Estimate, Series
from outrider.geometry import wrap
from outrider.observers import Measurement
from outrider.records import Array

NAMES = ("filterpy_ekf", "filterpy_ukf", "filterpy_imm", "stonesoup_turn", "stonesoup_acceleration")
SLOW_MPS = 0.5  # below this the direction of a velocity says nothing about the yaw


def get(name: str) -> Any:
    """The peer of that name."""
    library, model = name.split("_")
    return getattr(import_module(f"benchmarks.accuracy.peers_{library}"), model)


class Start(NamedTuple):
    """What the first two neighbouring samples with a position say."""

    index: int  # of the second one
    p: Array  # (2,) position then [m]
    v: Array  # (2,) velocity between them [m/s]
    dt: float  # between them [s]
    heading: float  # of the rectangle, else of the velocity [rad]


def start(series: Series) -> Start | None:
    """The first two neighbouring samples with a position; None where there are none."""
    seen = np.isfinite(series.y[:, :2]).all(axis=1)
    both = np.flatnonzero(seen[1:] & seen[:-1])
    if not len(both):
        return None
    k = int(both[0]) + 1
    dt = float(series.t[k] - series.t[k - 1])
    v = (series.y[k, :2] - series.y[k - 1, :2]) / dt
    known = np.isfinite(series.y[k, 6])
    return Start(k, series.y[k, :2], v, dt, float(series.y[k, 5] if known else np.arctan2(v[1], v[0])))


class Sample(NamedTuple):
    """One sample after the start."""

    index: int
    dt: float  # since the last one [s]
    z: Array | None  # (2,) position, or (3,) with the heading of the rectangle; None: not seen
    R: Array  # (2, 2) or (3, 3), the measurement's own covariance and `noise` [m] on the position


def samples(series: Series, first: int, noise: float, heading_noise: float = 0.0) -> Iterator[Sample]:
    """The samples after `first`; where the heading is not known, or `heading_noise` is inf, position only."""
    dt = np.diff(series.t, prepend=series.t[0])
    for k in range(first + 1, len(series.t)):
        y = Measurement(*series.y[k])
        var = y.heading_variance + heading_noise**2
        P = np.array([[y.xx + noise**2, y.xy], [y.xy, y.yy + noise**2]])
        z: Array | None = None
        if np.isfinite(y.x + y.y):
            z = np.array([y.x, y.y, y.heading] if np.isfinite(var) else [y.x, y.y])
        if z is not None and len(z) == 3:
            R = np.zeros((3, 3))
            R[:2, :2], R[2, 2] = P, var
            P = R
        yield Sample(k, float(dt[k]), z, P)


def from_velocity(series: Series, x: Array, P: Array, heading: float) -> Estimate:
    """Estimate from positions and velocities x (n, 4), and their covariances P (n, 4, 4).

    The yaw is the direction of the velocity, held where it is slow; `heading` [rad] before it ever moved.
    """
    speed = np.hypot(x[:, 2], x[:, 3])
    course = np.arctan2(x[:, 3], x[:, 2])
    latest = np.maximum.accumulate(np.where(speed > SLOW_MPS, np.arange(len(x)), -1))
    yaw = np.where(latest >= 0, course[np.maximum(latest, 0)], heading)
    zero = np.zeros(len(x))
    motion = np.column_stack([x[:, :2], speed, zero, course, wrap(yaw), wrap(course - yaw), zero])
    motion[~np.isfinite(x).all(axis=1)] = np.nan
    return Estimate(motion, halves(P))


def halves(P: Array) -> Array:
    """Rows (n, 10) of observers.Spread from covariances (n, 4, 4) of x, y, u, v."""
    i, j = np.tril_indices(4)
    return np.ascontiguousarray(P[:, i, j])
