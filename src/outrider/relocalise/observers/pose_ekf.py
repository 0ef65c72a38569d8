"""Extended Kalman filter of the pose x, y, theta from ranges and odometry alone: the best tracker here.

    rho_i = |r(s_i) - x|     H_i = d rho_i / d(x, y, theta) = [-n' / (n . e1i), rho_i (r' . e1i) / (r' . e2i)]

n = -M r' is the outward normal where the ray ends, e1i the unit vector along it, e2i = M e1i. The motion is
the exact arc of a constant twist. The covariance is corrected in Joseph's form, one ray after the other.
"""

from __future__ import annotations

from math import exp, log, pi
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from outrider.geometry import rotate, wrap
from outrider.relocalise import Array, Bools, Sample
from outrider.relocalise.equations import dot, turned
from outrider.relocalise.observers._inside import kept_inside

if TYPE_CHECKING:
    from outrider.relocalise.room import Room

reference = "Kalman filter linearised at the estimate; S. Thrun et al., Probabilistic Robotics, 2005, ch. 3"

# A range is often too short, for something is in the way, but hardly ever too long. From these shares of
# `doubt` on it is the estimate that is wrong, and ranges too short, too long, are used again [-]
OPEN = np.array([0.6, 0.3])
FADES = 1.0  # time after which `doubt` has forgotten [s]


class State(NamedTuple):
    """What is kept from sample to sample, n at a time."""

    pose: Array  # (n, 3) x, y [m], theta [rad]
    P: Array  # (n, 3, 3) its covariance
    fit: Array  # (n,) log likelihood of the last ranges, given those before
    distance: Array  # (n,) squared innovation of the last ranges in standard deviations, refused ones too
    rays: Array  # (n,) how many ranges that is made of
    doubt: Array  # (n, 2) share of the latest ranges that were too short, too long, by the gate [-]


class Gains(NamedTuple):
    """Standard deviations of what the filter believes."""

    start_position: float = 0.5  # of the guess, along x and y [m]
    start_heading: float = 0.3  # [rad]
    range_floor: float = 0.001  # of a range, beyond what the room's sensors have [m]
    odometry: float = 0.02  # scale error of each speed, as if drawn anew each second [-]
    drift_position: float = 0.002  # beyond that, of the position after one second [m]
    drift_heading: float = 0.002  # and of the heading [rad]
    gate: float = 5.0  # a range farther off than this is not used [standard deviations]
    start_doubt: float = 1.0  # `doubt` at the start: 1 a guess, 0 a pose that fits [-]
    outlier: float = 0.001  # share of ranges that are anything, in `fit` [-]


def start(pose: Array, angles: Array, room: Room, gains: Gains) -> State:
    """State from guesses of the pose (n, 3); one outside the wall is taken to the nearest inside."""
    pose = kept_inside(room.wall, np.atleast_2d(np.asarray(pose, float)))
    P = np.diag([gains.start_position**2, gains.start_position**2, gains.start_heading**2])
    none = np.zeros(len(pose))
    doubt = np.full((len(pose), 2), gains.start_doubt)
    return State(pose, np.broadcast_to(P, (len(pose), 3, 3)), none, none, none, doubt)


def step(state: State, sample: Sample, room: Room, gains: Gains) -> State:
    """State at the next sample: moved, then corrected by each range there is."""
    dt = max(float(sample.dt), 0.0) if np.isfinite(sample.dt) else 0.0
    pose, P = _moved(state, sample, dt, gains)
    return _corrected(state._replace(pose=kept_inside(room.wall, pose), P=P), sample, dt, room, gains)


def pose(state: State, sample: Sample, room: Room) -> Array:
    """(n, 3) x, y [m], theta [rad] in [-pi, pi)."""
    return np.column_stack([state.pose[:, :2], wrap(state.pose[:, 2])])


def covariance(state: State) -> Array:
    """(n, 3, 3) of x, y [m], theta [rad]."""
    return state.P


def fit(state: State) -> Array:
    """(n,) log likelihood of the last sample, given those before: comparable between guesses of one robot.

    Its ranges are in metres. One on an unknown part of the wall may be any, as may the share `outlier`.
    """
    return state.fit


def distance(state: State) -> Array:
    """(n,) squared Mahalanobis distance of the last innovation, of `state.rays` ranges; 0 without any."""
    return state.distance


def expected(room: Room, pose: Array, angles: Array) -> tuple[Array, Array, Bools]:
    """Ranges (n, 2) [m] from poses (n, 3), their slopes H (n, 2, 3), and whether the wall is known there.

    NaN where the point is not inside.
    """
    bearing = pose[:, 2:] + angles
    hit = room.wall.ray(pose[:, None, :2], bearing)
    known = room.wall.known(hit.s)
    tangent = room.wall.at(np.where(np.isfinite(hit.s), hit.s, 0.0)).dr
    e1 = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    normal, e2 = -turned(tangent), turned(e1)
    place = -normal / dot(normal, e1)[..., None]
    turn = hit.range * dot(tangent, e1) / dot(tangent, e2)
    return hit.range, np.concatenate([place, turn[..., None]], axis=-1), known


def _moved(state: State, sample: Sample, dt: float, gains: Gains) -> tuple[Array, Array]:
    """Pose and covariance at the end of the arc that the twist makes; a missing speed is 0."""
    pose, P = state.pose, state.P
    vx, vy, w = np.broadcast_arrays(
        *(np.where(np.isfinite(u), u, 0.0) for u in (sample.vx, sample.vy, sample.w)), pose[:, 0]
    )[:3]
    half = 0.5 * w * dt
    path = dt * np.sinc(half / pi)[:, None] * np.stack([vx, vy], axis=-1)
    chord = rotate(path, pose[:, 2] + half)
    F = np.broadcast_to(np.eye(3), P.shape).copy()
    F[:, :2, 2] = turned(chord)
    c, s, zero, one = np.cos(pose[:, 2]), np.sin(pose[:, 2]), np.zeros_like(half), np.ones_like(half)
    G = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=-1).reshape(-1, 3, 3)
    drift = np.array([gains.drift_position, gains.drift_position, gains.drift_heading])
    density = (gains.odometry * np.stack([vx, vy, w], axis=-1)) ** 2 + drift**2
    P = F @ P @ F.swapaxes(1, 2) + (G * (dt * density)[:, None, :]) @ G.swapaxes(1, 2)
    return np.column_stack([pose[:, :2] + chord, pose[:, 2] + 2.0 * half]), P


def _corrected(state: State, sample: Sample, dt: float, room: Room, gains: Gains) -> State:
    """State after both rays, linearised at one pose."""
    pose, P = state.pose, state.P
    ranges, H, known = expected(room, pose, sample.angles)
    measured = np.broadcast_to(sample.ranges, ranges.shape)
    seen = np.isfinite(measured) & (np.nan_to_num(measured) > 0.0)
    noise, reach = (room.sigma + gains.range_floor) ** 2, room.wall.diameter
    stray, shut = max(gains.outlier, room.strays), room.strays > 0.0  # strays come in crowds: never let in
    keep, doubt = exp(-0.5 * dt / FADES), state.doubt
    x, fit, far, rays = pose, np.zeros(len(pose)), np.zeros(len(pose)), np.zeros(len(pose))
    for i in range(2):
        h, told = H[:, i], seen[:, i] & known[:, i]
        PH = np.einsum("nij,nj->ni", P, h)
        S = np.einsum("ni,ni->n", h, PH) + noise
        e = np.where(told, measured[:, i] - ranges[:, i] - np.einsum("ni,ni->n", h, x - pose), 0.0)
        square = e * e / S
        likely = (1.0 - stray) * np.exp(-0.5 * square) / np.sqrt(2.0 * pi * S) + stray / reach
        fit = fit + np.where(told, np.log(likely), np.where(seen[:, i], -log(reach), 0.0))
        far, rays = far + square, rays + told
        off = (told & (square > gains.gate**2))[:, None] & np.column_stack([e < 0.0, e >= 0.0])
        used = told & ~(off & (shut | (state.doubt < OPEN))).any(axis=1)
        K = np.where(used[:, None], PH / S[:, None], 0.0)
        x = x + K * e[:, None]
        A = np.eye(3) - K[:, :, None] * h[:, None, :]
        P = A @ P @ A.swapaxes(1, 2) + noise * K[:, :, None] * K[:, None, :]
        doubt = np.where(told[:, None], off + (doubt - off) * keep, doubt)
    return State(kept_inside(room.wall, x), 0.5 * (P + P.swapaxes(1, 2)), fit, far, rays, doubt)
