"""One robot, row by row: looked for where nothing is known, followed where it is, looked for again when lost.

    searching   several poses fit what was seen so far
    ambiguous   those that remain can never be told apart: the wall looks the same when turned
    tracking    one pose, followed by an observer
    lost        it was known, but the ranges contradict it for long: looked for anew

The robot's pose is that of its own point; observers work with the point its sensors sit on (`mount`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from outrider.errors import InputError
from outrider.geometry import wrap
from outrider.relocalise import Array, Observer, Sample, lost, mount, range_rate
from outrider.relocalise.anywhere import Found, Search
from outrider.relocalise.observers import pose_ekf
from outrider.relocalise.room import Room

STATES = ("searching", "ambiguous", "tracking", "lost")
SEARCHING, AMBIGUOUS, TRACKING, LOST = range(4)
LONGEST_GAP = 2.0  # longer without a row, or without odometry, and the robot may be anywhere [s]
SETTLED = 10.0  # a pose that is less likely than the best by more is no rival [nats]
LEAST_SEARCH = 1.0  # before, one pose left says little; longer where there are strays [s]
UNLIKELY = 5.0  # a range that is off by more is of no wall, or the pose is wrong [standard deviations]


class Reading(NamedTuple):
    """A row of a log; NaN where missing."""

    t: float  # [s]
    v: float  # of the robot, over the interval that ends here [m/s]
    w: float  # [rad/s]
    ranges: Array  # (2,) [m]
    angles: Array  # (2,) of the sensors, from straight ahead [rad]


class Place(NamedTuple):
    """Where the robot is, as far as is known."""

    pose: Array  # (3,) of the robot, x, y [m], theta [rad] in [-pi, pi): the likeliest; NaN: none yet
    sigma: Array  # (3,) standard deviations [m, m, rad]; over all poses that are left while searching
    state: int  # index of STATES
    others: Array  # (m, 4) every pose of the robot that is left, this one first, and its log weight [nats]
    distance: float  # squared innovation of the ranges in standard deviations; NaN: none
    event: str  # what happened at this row, in words; "": nothing


class Follower:
    """What is known of one robot, row by row."""

    def __init__(
        self, room: Room, observer: Observer, gains: Any, start: Array | None = None, gap: float = LONGEST_GAP
    ) -> None:
        """start (3,): pose of the robot in the wall's frame, x, y [m], theta [rad]; None: it may be anywhere.

        gap: `LONGEST_GAP` for this log. InputError for a start that is not inside the wall, or no start in a
        circle, where no search can help.
        """
        self.room, self.observer, self.gains, self.gap = room, observer, gains, gap
        self.guard_gains = gains if observer is pose_ekf else pose_ekf.Gains()
        self.search: Search | None = None if start is not None else Search(room)
        self.guess = None if start is None else _sensors(start, room)
        self.state: Any = None  # the observer's
        self.guard: Any = None  # of a Kalman filter of the pose beside it, which tells when that is lost
        self.searched = 0.0  # for so long, since it last began [s]
        self.twins = 1  # poses that are as good as the one followed
        self.was_known = False
        self.watch = lost.Lost(lost.among(lost.Gains(), room.strays))
        self.least_search = LEAST_SEARCH / (1.0 - room.strays) ** 2
        self.last: Reading | None = None
        self.blind = 0.0  # time since the last odometry [s]
        self.slopes: range_rate.Memory | None = None

    def step(self, reading: Reading) -> Place:
        """Take in a row; one that is not later than the last changes nothing but is answered."""
        reading = self._completed(reading)
        sample = self._sample(reading)
        event = self._gap(reading, sample)
        self.last = reading
        if self.search is None:
            return self._follow(sample, event)
        if self.blind > self.gap:
            return self._nowhere(event)
        found = self.search.step(sample)
        self.searched = 0.0 if found.moved or not len(found.pose) else self.searched + sample.dt
        if found.moved and not event:
            event = "no pose that was left fitted any more: others taken instead"
        if not len(found.pose):
            return self._nowhere(event)
        if self.searched >= self.least_search and _settled(found):
            return self._hand_over(found, sample, event)
        return self._searched(found, event)

    # -------------------------------------------------------------- what is read

    def _completed(self, reading: Reading) -> Reading:
        """The row without ranges that cannot be; odometry as it was where it is missing."""
        angled = np.isfinite(reading.angles)
        possible = (reading.ranges > self.room.range_min) & (reading.ranges <= self.room.range_max) & angled
        last = self.last
        angles = np.where(angled, reading.angles, self.room.angles if last is None else last.angles)
        moved = np.isfinite(reading.v) and np.isfinite(reading.w)
        since = 0.0 if last is None else max(reading.t - last.t, 0.0)
        self.blind = 0.0 if moved else self.blind + since
        v, w = (reading.v, reading.w) if moved else (0.0, 0.0) if last is None else (last.v, last.w)
        return Reading(reading.t, v, w, np.where(possible, reading.ranges, np.nan), angles)

    def _sample(self, reading: Reading) -> Sample:
        none = np.full(2, np.nan)
        dt = 0.0 if self.last is None else max(reading.t - self.last.t, 0.0)
        rates, self.slopes = range_rate.advance(self.slopes, reading.t, reading.ranges, reading.angles)
        before = none if self.last is None else self.last.ranges
        twist = mount.twist(np.array(reading.v), np.array(reading.w), self.room.mount)
        return Sample(dt, *twist, reading.ranges, before, rates, reading.angles)

    def _gap(self, reading: Reading, sample: Sample) -> str:
        """Begin anew after a gap; says so."""
        circle = self.room.wall.symmetry == 0  # where no search helps
        if circle or (sample.dt <= self.gap and self.blind <= self.gap):
            return ""
        known = self.search is None
        self._begin_anew()
        if sample.dt > self.gap:
            return f"{sample.dt:.1f} s without a row: looked for anew"
        return f"{self.blind:.1f} s without odometry: looked for anew" if known else ""

    def _begin_anew(self) -> None:
        self.was_known |= self.search is None
        self.search, self.state, self.twins, self.searched = Search(self.room), None, 1, 0.0
        self.watch.reset()

    # -------------------------------------------------------------- what is said

    def _nowhere(self, event: str) -> Place:
        none = np.full(3, np.nan)
        return Place(none, none, LOST if self.was_known else SEARCHING, np.empty((0, 4)), np.nan, event)

    def _searched(self, found: Found, event: str) -> Place:
        """The likeliest of many, with the spread of all."""
        share = np.exp(found.log_weight)
        away = found.pose - found.pose[0]
        away[:, 2] = wrap(away[:, 2])
        variance = np.diagonal(found.covariance, axis1=1, axis2=2) + away**2
        sigma = np.sqrt(share @ variance / share.sum())
        others = np.column_stack([_robots(found.pose, self.room), found.log_weight])
        return Place(others[0, :3], sigma, LOST if self.was_known else SEARCHING, others, np.nan, event)

    def _hand_over(self, found: Found, sample: Sample, event: str) -> Place:
        """From now on an observer follows the pose that is left, or one of its twins."""
        self._start(found.pose[:1], sample)
        settled = {"P": found.covariance[:1], "doubt": np.zeros_like(self.guard.doubt)}
        self.guard = self.guard._replace(**settled)
        self.state = self.guard if self.observer is pose_ekf else self.state
        self.twins, self.search = max(self.room.wall.symmetry, 1), None
        self.watch.reset()
        return self._known(sample, np.nan, event or "found")

    def _follow(self, sample: Sample, event: str) -> Place:
        """The observer one row on; anew where the ranges have contradicted it for too long."""
        if self.state is None:
            assert self.guess is not None
            self._start(self.guess, sample)
            return self._known(sample, np.nan, event)
        distance, rays = self._contradiction(sample)
        self.guard = pose_ekf.step(self.guard, sample, self.room, self.guard_gains)
        if self.observer is pose_ekf:
            self.state = self.guard
        else:
            self.state = self.observer.step(self.state, sample, self.room, self.gains)
        if self.watch.step(sample.dt, distance, rays) and self.room.wall.symmetry:
            self._begin_anew()
            return self._nowhere("the ranges contradict the pose: lost, looked for anew")
        return self._known(sample, distance if rays else np.nan, event)

    def _start(self, pose: Array, sample: Sample) -> None:
        """Observer and guard at a pose (1, 3) of the sensors."""
        self.state = self.observer.start(pose, sample.angles, self.room, self.gains)
        self.guard = pose_ekf.start(pose, sample.angles, self.room, self.guard_gains)

    def _known(self, sample: Sample, distance: float, event: str) -> Place:
        pose = self.observer.pose(self.state, sample, self.room)[0]
        with_twins = [pose, *(self.room.wall.turned(pose, k) for k in range(1, self.twins))]
        others = np.column_stack([_robots(np.stack(with_twins), self.room), np.zeros(self.twins)])
        sigma = np.full(3, np.nan)
        if hasattr(self.observer, "covariance"):
            sigma = np.sqrt(np.diagonal(self.observer.covariance(self.state)[0]))
        return Place(others[0, :3], sigma, AMBIGUOUS if self.twins > 1 else TRACKING, others, distance, event)

    def _contradiction(self, sample: Sample) -> tuple[float, int]:
        """Squared innovation before the step, and of how many ranges.

        A range too short, beside one that fits, is of something in the way: it is left out.
        """
        assert self.last is not None
        pose = mount.robot(self.guard.pose[0], self.room.mount)
        moved = mount.sensors(mount.advanced(pose, self.last.v, self.last.w, sample.dt), self.room.mount)
        ranges, slope, known = (part[0] for part in pose_ekf.expected(self.room, moved[None], sample.angles))
        spread = np.sqrt(np.einsum("ij,jk,ik->i", slope, self.guard.P[0], slope) + self.room.sigma**2)
        off = np.where(known, sample.ranges - ranges, np.nan) / spread
        fits, short = np.abs(off) <= UNLIKELY, off < -UNLIKELY
        used = np.isfinite(off) & ~(short & fits.any())
        return float(np.sum(off[used] ** 2)), int(used.sum())


def _settled(found: Found) -> bool:
    """Whether every pose that is left but the likeliest is its twin, or no rival."""
    return bool((found.twin[1:] | (found.log_weight[1:] < -SETTLED)).all())


def _robots(sensors: Array, room: Room) -> Array:
    robot = mount.robot(sensors, room.mount)
    return np.concatenate([robot[..., :2], np.asarray(wrap(robot[..., 2:]))], axis=-1)


def _sensors(start: Array, room: Room) -> Array:
    """(1, 3) pose of the sensors; InputError where it is outside."""
    start = np.asarray(start, float)
    if start.shape != (3,):
        raise InputError(f"start {start.tolist()}; want three numbers, x, y [m] and theta [rad]")
    at = mount.sensors(start, room.mount)[None]
    if not (np.isfinite(at).all() and room.wall.inside(at[:, :2]).all()):
        raise InputError(
            f"start {start.tolist()}: the sensors are not inside the wall ({room.wall.name}); "
            "want x, y [m] and theta [rad] in the wall's own frame, or no start to search everywhere"
        )
    return at
