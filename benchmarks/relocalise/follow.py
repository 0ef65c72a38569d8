"""Observers, searches and particle filters over drives, and how far off they were."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
from benchmarks.relocalise import cases

from outrider.geometry import wrap
from outrider.relocalise import Array, Bools, Observer, Sample, particle, range_rate
from outrider.relocalise import equations as eq
from outrider.relocalise.anywhere import Search
from outrider.relocalise.room import Room
from outrider.relocalise.simulate import Drives

NONE = np.full(2, np.nan)


class Errors(NamedTuple):
    """How far estimates are from the truth, or from what no range can tell from it."""

    position: Array  # (m, n) [m]
    heading: Array  # (m, n) [rad]


def errors(room: Room, pose: Array, truth: Array) -> Errors:
    """Of poses (m, n, 3); of all that look the same, the nearest."""
    off = [np.abs(pose - room.wall.turned(truth, k)) for k in range(max(room.wall.symmetry, 1))]
    away = np.stack([pose - room.wall.turned(truth, k) for k in range(len(off))])
    position, heading = np.hypot(away[..., 0], away[..., 1]), np.abs(wrap(away[..., 2]))
    nearest = np.nan_to_num(position + heading, nan=np.inf).argmin(axis=0)[None]
    return Errors(*(np.take_along_axis(part, nearest, axis=0)[0] for part in (position, heading)))


def success(off: Errors, t: Array) -> tuple[Bools, Array]:
    """(n,) whether the end was right, and when it began to be and stayed so (n,) [s]; NaN: never."""
    wrong = ~((off.position < cases.CLOSE[0]) & (off.heading < cases.CLOSE[1]))
    good = ~wrong[t > t[-1] - cases.LAST].any(axis=0)
    last = len(t) - 1 - np.argmax(wrong[::-1], axis=0)
    since = np.where(wrong.any(axis=0), t[np.minimum(last + 1, len(t) - 1)], 0.0)
    return good, np.where(good, since, np.nan)


def rms(off: Errors, t: Array, after: float = 10.0) -> Array:
    """(n,) root mean square of the position error after so long [m]; infinite where it was lost."""
    square = np.where(np.isfinite(off.position), off.position, np.inf)[t > after] ** 2
    return np.asarray(np.sqrt(square.mean(axis=0)))


def exact_rates(drives: Drives, room: Room) -> Array:
    """(m, n, 2) by eq. 14 at the truth: no robot has them [m/s]."""
    dt, half = np.diff(drives.t)[:, None], 0.5 * wrap(np.diff(drives.truth[..., 2], axis=0))
    way, middle = np.diff(drives.truth[..., :2], axis=0), drives.truth[:-1, :, 2] + half
    chord = way[..., 0] * np.cos(middle) + way[..., 1] * np.sin(middle)
    v, w = chord / dt / np.sinc(half / np.pi), 2.0 * half / dt
    truth = drives.truth[1:]
    hit = room.wall.ray(truth[..., None, :2], truth[..., 2:] + room.angles)
    p = np.concatenate([hit.s, truth[..., 2:]], axis=-1)
    rates = eq.rates(eq.scene(room.wall, p, room.angles, hit.range, eq.Twist(v, 0.0 * v, w)))
    return np.concatenate([np.full_like(rates[:1], np.nan), rates])


def rates(drives: Drives, room: Room, method: str, window: float) -> Array:
    """(m, n, 2) range rates as an observer is told them [m/s]."""
    if method == "exact":
        return exact_rates(drives, room)
    if method == "none":
        return np.full_like(drives.ranges, np.nan)
    return range_rate.of_log(drives.t, drives.ranges, room.angles, method, window)


def sample(drives: Drives, room: Room, k: int, rates: Array, which: Any = slice(None)) -> Sample:
    """Row k of the robots `which`."""
    dt = float(drives.t[k] - drives.t[k - 1]) if k else 0.0
    v, w = np.moveaxis(drives.odometry[k, which], -1, 0)
    before = drives.ranges[k - 1, which] if k else np.full_like(drives.ranges[0, which], np.nan)
    return Sample(dt, v, 0.0 * v, w, drives.ranges[k, which], before, rates[k, which], room.angles)


def follow(observer: Observer, gains: Any, drives: Drives, room: Room, guess: Array, rates: Array) -> Array:
    """(m, n, 3) poses from guesses (n, 3); of one robot where there are many guesses of it."""
    state = observer.start(guess, room.angles, room, gains)
    poses = np.empty((len(drives.t), len(guess), 3))
    for k in range(len(drives.t)):
        now = sample(drives, room, k, rates)
        if k:
            state = observer.step(state, now, room, gains)
        poses[k] = observer.pose(state, now, room)
    return poses


def repeated(drives: Drives, times: int) -> Drives:
    """Every robot so many times, one after the other."""
    again = (np.repeat(part, times, axis=1) for part in (drives.odometry, drives.ranges, drives.truth))
    return Drives(drives.t, *again)


def cloud(drives: Drives, room: Room, gains: particle.Gains, robot: int, guess: Array | None) -> Array:
    """(m, 3) poses of a particle filter; from anywhere without a guess (3,)."""
    made = particle.ParticleFilter(room, gains, seed=robot)
    if guess is not None:
        made.around(guess, cases.GUESS)
    none = np.broadcast_to(NONE, drives.ranges.shape)
    return np.array([made.step(sample(drives, room, k, none, robot)) for k in range(len(drives.t))])


class Searched(NamedTuple):
    """What a search said along a drive of m rows."""

    pose: Array  # (m, 3) the likeliest
    ambiguous: Bools  # (m,)
    left: Array  # (m,) hypotheses
    seconds: Array  # (m,) of a processor that it took [s]


def search(drives: Drives, room: Room, robot: int) -> Searched:
    """The search over one robot's drive."""
    made, none = Search(room), np.broadcast_to(NONE, drives.ranges.shape)
    pose, rest = np.full((len(drives.t), 3), np.nan), np.zeros((len(drives.t), 3))
    for k in range(len(drives.t)):
        begin = time.process_time()
        found = made.step(sample(drives, room, k, none, robot))
        rest[k] = found.ambiguous, len(found.pose), time.process_time() - begin
        if len(found.pose):
            pose[k] = found.pose[0]
    return Searched(pose, rest[:, 0] > 0.5, rest[:, 1], rest[:, 2])
