"""Gradient observer of the configuration p = (s1, s2, theta), with the motion of p fed forward.

    dp/dt = f(p) - ks (dz/dp)' z - ka (dF/dp)' F        f = (s1', s2', w) of eq. 13

z says that both ranges put the robot at one place, F that the ranges change as they were measured to. Without
f (feedforward = 0) it is eq. 27 as printed, whose error stays about as large as |dp/dt| over the gain. It is
stiff: one linearly implicit step a sample, which no gain makes diverge; explicit Euler does.

    predict  Heun's step of f              correct  p -= (I + dt Q)^-1 dt g
                                           or       p -= (1 - exp(-kappa dt)) (Q + damping I)^-1 g
    g = ks (dz/dp)' z + ka (dF/dp)' F      Q = ks (dz/dp)' dz/dp + ka (dF/dp)' dF/dp

The second form (kappa > 0), normalised as Gauss and Newton do, has one rate in all directions that are seen.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from outrider.geometry import TAU, wrap
from outrider.relocalise import Array, Bools, Sample
from outrider.relocalise import equations as eq
from outrider.relocalise.observers._inside import kept_inside

if TYPE_CHECKING:
    from outrider.relocalise.room import Room

reference = "S. Cedervall, X. Hu, Nonlinear Observers for Unicycle Robots with Range Sensors, eq. 27"

GRAZING = 0.15  # in f, a ray meets the wall at no smaller sine: p may be what no robot can have [-]
FASTEST = 5.0  # rate of the slow direction at most: rates are measured over 0.3 s [1/s]
SAME = 1e-9  # two angles of a sensor that differ by less are one [rad]


class State(NamedTuple):
    """What is kept from sample to sample, n at a time."""

    p: Array  # (n, 3) s1, s2 [rad], not wrapped, and theta [rad]
    ranges: Array  # (n, 2) last ones; where there was none, carried on by eq. 14 [m]
    angles: Array  # (n, 2) of the sensors [rad]


class Gains(NamedTuple):
    """The defaults suit a room of 8 m by 5 m and 0.5 m/s; `rule` says what suits another."""

    ks: float = 3.0  # on z [1/(m2 s)]
    ka: float = 0.1  # on F [s/m4]
    feedforward: float = 1.0  # share of f: 1 all, 0 as published [-]
    kappa: float = 0.0  # rate of the normalised form; 0: the gradient [1/s]
    damping: float = 0.07  # of the normalised form [m2 ks]


def rule(
    room: Room, dt: float, v: float, w: float, odometry: float = 0.02, normalised: bool = False
) -> Gains:
    """Gains for a robot that samples every dt [s] and drives at about v [m/s], w [rad/s].

    odometry: its relative error [-]. Range rates by a parabola over 0.3 s. The slow direction has the rate of
    a Kalman filter for a random walk, how much is drifted over how well is measured; docs/relocalise.md.
    """
    size = room.wall.perimeter / TAU
    pace = np.hypot(v, size * w)
    kappa = min(FASTEST, 0.15 * odometry * pace / (room.sigma * np.sqrt(dt)))
    if normalised:
        return Gains(1.0, 0.09 / pace**2, 1.0, 0.6 * kappa, 0.0065 * size**2)
    return Gains(33.0 * kappa / size**2, kappa / (size * pace) ** 2)


def start(pose: Array, angles: Array, room: Room, gains: Gains) -> State:
    """State from guesses of the pose (n, 3); one outside the wall is taken to the nearest inside."""
    pose = kept_inside(room.wall, np.atleast_2d(np.asarray(pose, float)))
    hit = room.wall.ray(pose[:, None, :2], pose[:, 2:] + angles)
    p = np.column_stack([hit.s, pose[:, 2]])
    return State(p, hit.range, np.broadcast_to(np.asarray(angles, float), hit.range.shape))


def step(state: State, sample: Sample, room: Room, gains: Gains) -> State:
    """State at the next sample; a range that is missing, or ends on no known wall, corrects nothing."""
    before = sample.before
    if np.any(np.abs(state.angles - sample.angles) > SAME):
        state, before = start(_pose(state, room), sample.angles, room, gains), np.full(2, np.nan)
    dt = max(float(sample.dt), 0.0) if np.isfinite(sample.dt) else 0.0
    moving = np.isfinite(sample.vx) & np.isfinite(sample.vy) & np.isfinite(sample.w)
    twist = eq.Twist(*(np.where(moving, part, 0.0) for part in (sample.vx, sample.vy, sample.w)))
    known = room.wall.known(state.p[:, :2])
    seen = np.isfinite(sample.ranges) & (np.nan_to_num(sample.ranges) > 0.0) & known
    state = state._replace(ranges=np.where(np.isfinite(before) & known, before, state.ranges))
    state = _predict(state, twist, np.where(seen, sample.ranges, np.nan), dt, room, gains.feedforward)
    at = eq.scene(room.wall, state.p, state.angles, state.ranges, twist)
    usable = seen & room.wall.known(state.p[:, :2])
    timely = usable & np.isfinite(sample.rates) & np.asarray(moving)[..., None]
    return state._replace(p=_correct(state.p, at, usable, np.where(timely, sample.rates, np.nan), dt, gains))


def pose(state: State, sample: Sample, room: Room) -> Array:
    """(n, 3) half-way between where both rays put the robot, and its heading."""
    return _pose(state, room)


def _pose(state: State, room: Room) -> Array:
    at = eq.scene(room.wall, state.p, state.angles, state.ranges, eq.Twist(0.0, 0.0, 0.0))
    return np.column_stack([eq.positions(at).mean(axis=-2), wrap(state.p[:, 2])])


def _predict(state: State, twist: eq.Twist, ranges: Array, dt: float, room: Room, share: float) -> State:
    """Heun's step of f, and of eq. 14 for a range (..., 2) that is missing (NaN)."""

    def slope(p: Array, rho: Array) -> tuple[Array, Array]:
        at = eq.scene(room.wall, p, state.angles, rho, twist)
        turn = np.broadcast_to(twist.w, p.shape[:1])
        return share * np.column_stack([eq.flow(at, GRAZING), turn]), share * eq.rates(at, GRAZING)

    p, before = state.p, state.ranges
    f1, g1 = slope(p, before)
    f2, g2 = slope(p + dt * f1, np.where(np.isnan(ranges), before + dt * g1, ranges))
    carried = np.maximum(before + 0.5 * dt * (g1 + g2), 0.0)
    return state._replace(p=p + 0.5 * dt * (f1 + f2), ranges=np.where(np.isnan(ranges), carried, ranges))


def _correct(p: Array, at: eq.Scene, usable: Bools, measured: Array, dt: float, gains: Gains) -> Array:
    """p (n, 3) after the linearly implicit or the normalised step; measured rates (n, 2), NaN where none."""
    timely = np.isfinite(measured)
    measured = np.where(timely, measured, 0.0)
    both = np.broadcast_to(usable.all(axis=-1, keepdims=True), timely.shape)
    weight = np.concatenate([gains.ks * both, gains.ka * timely], axis=-1)
    slope = np.concatenate([eq.gap_slope(at), eq.mismatch_slope(at, measured)], axis=-2)
    error = np.concatenate([eq.gap(at), eq.mismatch(at, measured)], axis=-1)
    weighted = (slope * weight[..., None]).swapaxes(-1, -2)
    g, Q = weighted @ error[..., None], weighted @ slope
    if gains.kappa > 0.0:
        moved = -np.expm1(-gains.kappa * dt) * _solve(Q + gains.damping * np.eye(3), g)
    else:
        moved = _solve(np.eye(3) + dt * Q, dt * g)
    return np.asarray(p - moved)


def _solve(A: Any, b: Any) -> Array:
    """A^-1 b for stacks (n, 3, 3), (n, 3, 1), as (n, 3)."""
    return np.linalg.solve(A, b)[..., 0]
