"""The vehicle of the papers' simulations: exact motion of the bicycle, and what two positions tell of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.models import bicycle
from outrider.reproduce.published import Estimate, Seen, wrap

Array = npt.NDArray[np.float64]

STEERING_MAX = 36.0  # [MS 9]; what would turn further is held there [deg]
COLUMNS = ("w [m]", "V_x [m/s]", "V_y [m/s]", "psi [rad]")  # of the papers' tables


class Drive(NamedTuple):
    """What the driver of each run does; a number or an array (N,)."""

    V: Any  # speed at the beginning [m/s]
    A: Any = 0.0  # acceleration [m/s2]
    steering: Any = 0.0  # front wheel at the beginning [deg]
    steering_rate: Any = 0.0  # [deg/s]
    jerk: Any = 0.0  # [m/s3]
    psi: Any = 0.0  # yaw at the beginning [rad]


class Truth(NamedTuple):
    """Motion over time, (T, N) each but t; SI units and rad."""

    t: Array  # (T,)
    x: Array
    y: Array
    V: Array
    psi: Array
    beta: Array
    S: Array  # way since the beginning


def drive(d: Drive, duration: float, dt: float) -> Truth:
    """Truth at every dt [s] up to `duration` [s]: speed and slip in closed form, the rest by trapezoids."""
    t: Array = dt * np.arange(round(duration / dt) + 1, dtype=float)
    d = Drive(*np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, float)) for v in d)))
    T = t[:, None]
    V = d.V + d.A * T + 0.5 * d.jerk * T * T
    steering = np.clip(d.steering + d.steering_rate * T, -STEERING_MAX, STEERING_MAX)
    beta = bicycle.slip(np.radians(steering))
    psi = d.psi + _integral(V * np.sin(beta) / bicycle.REAR_AXLE, dt)
    chi = psi + beta
    return Truth(
        t, _integral(V * np.cos(chi), dt), _integral(V * np.sin(chi), dt), V, psi, beta, _integral(V, dt)
    )


def _integral(f: Array, dt: float) -> Array:
    out = np.zeros_like(f)
    out[1:] = np.cumsum(0.5 * dt * (f[1:] + f[:-1]), axis=0)
    return out


def measured(x: Array, y: Array) -> Seen:
    """What positions (T, N) tell: lengths of the ways between consecutive ones summed, and their course."""
    dx, dy = np.diff(x, axis=0), np.diff(y, axis=0)
    way = np.concatenate([np.zeros_like(x[:1]), np.cumsum(np.hypot(dx, dy), axis=0)])
    course = np.unwrap(np.arctan2(dy, dx), axis=0)
    return Seen(way, np.concatenate([course[:1], course]), x, y)


def rmse(truth: Truth, e: Estimate) -> Array:
    """RMSE (T, N, 4) from the beginning up to each time, columns as in `COLUMNS`; inf where a run is lost."""
    chi = truth.psi + truth.beta
    squares = np.stack(
        [
            (e.x - truth.x) ** 2 + (e.y - truth.y) ** 2,
            (e.V_x - truth.V * np.cos(chi)) ** 2,
            (e.V_y - truth.V * np.sin(chi)) ** 2,
            wrap(e.psi - truth.psi) ** 2,
        ],
        axis=-1,
    )
    mean = np.cumsum(squares, axis=0) / np.arange(1, len(squares) + 1)[:, None, None]
    return np.where(e.lost[:, None], np.inf, np.sqrt(mean))
