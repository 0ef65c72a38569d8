"""Simulated robots between walls: what their odometry and their two ranges say, with faults on request."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from outrider.errors import InputError
from outrider.relocalise import Array, motions, mount
from outrider.relocalise.log import Log
from outrider.relocalise.motions import Limits, Motion
from outrider.relocalise.room import Room

TRIES = 100  # rounds in which no place is found before it is said that there is none
ODOMETRY = 0.02  # one standard deviation of a run's constant scale errors of v and of w [-]


class Faults(NamedTuple):
    """What goes wrong on the way."""

    kidnapped: tuple[float, ...] = ()  # when the robot is put somewhere else [s]
    lost: float = 0.0  # share of ranges without a return [-]
    short: float = 0.0  # share of ranges that end on something before the wall [-]


class Drives(NamedTuple):
    """n robots over m instants."""

    t: Array  # (m,) [s]
    odometry: Array  # (m, n, 2) measured v [m/s], w [rad/s] over the interval that ends at each row
    ranges: Array  # (m, n, 2) measured [m]; NaN: no return
    truth: Array  # (m, n, 3) of the robot, x, y [m], theta [rad] in [-pi, pi)


def simulate(
    room: Room,
    motion: Motion = motions.spin,
    seconds: float = 30.0,
    rate: float = 10.0,
    noise: float | None = None,
    odometry: float = ODOMETRY,
    seed: int = 0,
    start: Array | None = None,
    limits: Limits | None = None,
    faults: Faults | None = None,
) -> Log:
    """A log of one robot with its true pose; the same seed gives the same log.

    rate: of rows [Hz]. noise: standard deviation of the ranges [m]; None: the room's. odometry: of the run's
    constant scale errors of v and w. start (3,): pose of the robot; None: anywhere. InputError as `drives`.
    """
    first = None if start is None else np.asarray(start, float)[None]
    made = drives(room, motion, 1, seconds, rate, noise, odometry, seed, first, limits, faults)
    v, w = made.odometry[:, 0].T
    return Log(made.t, v, w, made.ranges[:, 0], None, made.truth[:, 0])


def drives(
    room: Room,
    motion: Motion,
    n: int,
    seconds: float = 30.0,
    rate: float = 10.0,
    noise: float | None = None,
    odometry: float = ODOMETRY,
    seed: int = 0,
    start: Array | None = None,
    limits: Limits | None = None,
    faults: Faults | None = None,
) -> Drives:
    """n robots at once, as `simulate`; start (n, 3).

    InputError for a time or rate that is not positive, a negative noise, or a start outside the wall.
    """
    limits, faults = limits or Limits(), faults or Faults()
    noise = room.sigma if noise is None else noise
    for name, value, good in (
        ("seconds", seconds, 0.0 < seconds < np.inf),
        ("rate", rate, 0.0 < rate < np.inf),
        ("noise", noise, 0.0 <= noise < np.inf),
        ("odometry", odometry, 0.0 <= odometry < np.inf),
        ("lost", faults.lost, 0.0 <= faults.lost <= 1.0),
        ("short", faults.short, 0.0 <= faults.short <= 1.0),
        ("v", limits.v, 0.0 <= limits.v < np.inf),
        ("w", limits.w, 0.0 <= limits.w < np.inf),
    ):
        if not good:
            raise InputError(f"{name} = {value:g}; want a number that can be, 0 or more")
    rng = np.random.default_rng(seed)
    pose = anywhere(room, n, rng, limits.margin) if start is None else _inside(start, room)
    t = np.arange(max(2, round(seconds * rate) + 1)) / rate
    truth, moves = np.empty((len(t), n, 3)), np.zeros((len(t), n, 2))
    truth[0] = pose
    jumps = {int(np.ceil(when * rate - 1e-9)) for when in faults.kidnapped}
    for k in range(1, len(t)):
        moves[k] = motions.command(motion, float(t[k - 1]), truth[k - 1], room, limits)
        truth[k] = mount.advanced(truth[k - 1], moves[k, :, 0], moves[k, :, 1], 1.0 / rate)
        if k in jumps:
            truth[k] = anywhere(room, n, rng, limits.margin)
    scale = 1.0 + odometry * rng.standard_normal((n, 2))
    ranges = _measured(motions.seen(truth, room), noise, room, faults, rng)
    truth[..., 2] = np.mod(truth[..., 2] + np.pi, 2.0 * np.pi) - np.pi
    return Drives(t, moves * scale, ranges, truth)


def anywhere(room: Room, n: int, rng: np.random.Generator, margin: float = 0.2) -> Array:
    """(n, 3) poses of the robot, uniform over the room, both its points at least margin [m] from the wall."""
    outline = room.wall.at(np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)).r
    low, high = outline.min(axis=0), outline.max(axis=0)
    found = np.empty((0, 3))
    for _ in range(TRIES):
        tried = np.column_stack([rng.uniform(low, high, (4 * n, 2)), rng.uniform(-np.pi, np.pi, 4 * n)])
        at = mount.sensors(tried, room.mount)
        good = room.wall.inside(tried[:, :2], margin) & room.wall.inside(at[:, :2], margin)
        found = np.concatenate([found, tried[good]])
        if len(found) >= n:
            return found[:n]
    raise InputError(f"no place {margin:g} m from the wall of {room.wall.name}; want a larger room")


def _inside(start: Array, room: Room) -> Array:
    start = np.array(start, float)
    places = mount.sensors(start, room.mount)[..., :2]
    if not (np.isfinite(start).all() and room.wall.inside(places).all()):
        raise InputError(f"start {start.tolist()}: outside the wall of {room.wall.name}")
    return start


def _measured(ranges: Array, noise: float, room: Room, faults: Faults, rng: np.random.Generator) -> Array:
    """What sensors make of true ranges (..., 2) [m]."""
    made = ranges + noise * rng.standard_normal(ranges.shape)
    before = ranges * rng.uniform(0.1, 0.9, ranges.shape)
    made = np.where(rng.random(ranges.shape) < faults.short, before, made)
    made = np.where(rng.random(ranges.shape) < faults.lost, np.nan, made)
    return np.where((made >= room.range_min) & (made <= room.range_max) & (made > 0.0), made, np.nan)
