"""One log in one room through one observer: where the robot was, and a folder for that."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider import __version__, extension
from outrider import relocalise as observers
from outrider.geometry import wrap
from outrider.relocalise import Array, Observer, mount, observability
from outrider.relocalise import room as rooms
from outrider.relocalise.follow import AMBIGUOUS, LONGEST_GAP, STATES, TRACKING, Follower, Place, Reading
from outrider.relocalise.log import Log, doubts
from outrider.relocalise.room import Room

DEFAULT = "pose_ekf"  # observer
SLOW = 5.0  # so many usual steps without a row are no gap yet, where that is more than LONGEST_GAP


class Way(NamedTuple):
    """What was known at every row of a log."""

    pose: Array  # (n, 3) of the robot, x, y [m], theta [rad] in [-pi, pi); NaN: none
    sigma: Array  # (n, 3) standard deviations [m, m, rad]; NaN: not known
    state: npt.NDArray[np.int64]  # (n,) index of follow.STATES
    hypotheses: npt.NDArray[np.int64]  # (n,) poses that are left
    distance: Array  # (n,) squared innovation of the ranges in standard deviations; NaN: none
    observability: Array  # (n,) least singular value, scaled, at that pose and motion; NaN: not known


@dataclass(frozen=True, slots=True)
class Run:
    """A log and what an observer made of it."""

    log: Log
    room: Room
    observer: str
    gains: Any  # the observer's Gains
    start: Array | None  # (3,) pose of the robot that was given; None: it could be anywhere
    way: Way  # a row for each of the log
    others: tuple[Array, ...]  # for each row of the log (m, 4): every pose that was left, and its log weight
    events: tuple[tuple[float, str], ...]  # when [s], and what happened, in words
    seen: observability.Summary | None  # how well its pose could be seen where it was known; None: nowhere
    seconds: float  # that it took
    doubts: tuple[str, ...]  # about units, and about what can be known in this room, in words

    def errors(self) -> Array:
        """(n, 2) distance [m] and |heading| [rad] from the truth; NaN where either is not known.

        Where the state is ambiguous, from the nearest of the poses that are left.
        """
        made = np.full((len(self.log.t), 2), np.nan)
        if self.log.truth is None:
            return made
        for k, truth in enumerate(self.log.truth):
            told = self.others[k][:, :3] if self.way.state[k] == AMBIGUOUS else self.way.pose[k, None]
            if len(told):
                away = told - truth
                far = np.hypot(away[:, 0], away[:, 1])
                near = int(np.argmin(far)) if np.isfinite(far).all() else 0
                made[k] = far[near], abs(wrap(away[near, 2]))
        return made

    def columns(self) -> dict[str, Any]:
        """The columns of estimate.parquet, by name."""
        x, y, theta = self.way.pose.T
        spread = dict(zip(("sigma_x", "sigma_y", "sigma_theta"), self.way.sigma.T, strict=True))
        return {
            "t": self.log.t,
            "x": x,
            "y": y,
            "theta": theta,
            **spread,
            "state": np.array(STATES)[self.way.state],
            "hypotheses": self.way.hypotheses,
            "innovation": self.way.distance,
            "observability": self.way.observability,
        }

    def hypotheses(self) -> dict[str, Array]:
        """The columns of hypotheses.parquet: rows where more than one pose was left."""
        several = [(t, rows) for t, rows in zip(self.log.t, self.others, strict=True) if len(rows) > 1]
        rows = np.concatenate([rows for _, rows in several]) if several else np.empty((0, 4))
        x, y, theta, weight = rows.T
        t = np.repeat([t for t, _ in several], [len(rows) for _, rows in several])
        return {"t": t.astype(float), "x": x, "y": y, "theta": theta, "log_weight": weight}

    def summary(self) -> dict[str, Any]:
        """What came out, in figures that JSON can hold."""
        t, state = self.log.t, self.way.state
        steps = np.diff(t)
        known = np.flatnonzero((state == TRACKING) | (state == AMBIGUOUS))
        return {
            "version": __version__,
            "observer": self.observer,
            "room": rooms.as_dict(self.room),
            "symmetry": self.room.wall.symmetry,
            "rows": len(t),
            "duration_s": float(t[-1] - t[0]),
            "rate_hz": float(1.0 / np.median(steps[steps > 0.0])) if (steps > 0.0).any() else None,
            "longest_gap_s": float(steps.max()),
            "states": {name: int((state == i).sum()) for i, name in enumerate(STATES)},
            "first_known_s": float(t[known[0]] - t[0]) if len(known) else None,
            "events": [{"t_s": when, "what": what} for when, what in self.events],
            "out_of_reach": _out_of_reach(self.log, self.room),
            "faults": list(self.log.faults),
            "doubts": list(self.doubts),
            "at_the_end": {
                "state": STATES[int(state[-1])],
                "poses": [_posed(pose) for pose in self.others[-1][:8, :3]],
            },
            "observability": None if self.seen is None else self.seen._asdict(),
            "error": score(self.errors()[known]),
            "log_sha256": self.log.fingerprint(),
            "seconds": self.seconds,
        }


def run(
    log: Log,
    room: Room,
    start: Array | None = None,
    observer: str = DEFAULT,
    gains: Mapping[str, float] | None = None,
) -> Run:
    """Where the robot was at every row; start (3,): its pose at the first, None to search everywhere.

    InputError for an unknown observer or gain, a start outside the wall, or a search in a circle.
    """
    chosen = observers.get(observer)
    start = None if start is None else np.asarray(start, float)
    steps = np.diff(log.t)
    usual = float(np.median(steps[steps > 0.0]))
    values = _gains(chosen, gains or {}, log, room, usual)
    gap = max(LONGEST_GAP, SLOW * usual)
    begin = time.perf_counter()
    follower = Follower(room, chosen, values, start, gap)
    places = [follower.step(reading) for reading in readings(log, room)]
    took = time.perf_counter() - begin
    events = tuple((float(t), p.event) for t, p in zip(log.t, places, strict=True) if p.event)
    others = tuple(place.others for place in places)
    told = (*doubts(log, room), *_limits(room, start is not None))
    way, seen = _way(places, log, room)
    return Run(log, room, observer, values, start, way, others, events, seen, took, told)


def readings(log: Log, room: Room) -> list[Reading]:
    """The rows of a log; the sensors' angles are the room's where the log has none."""
    angles = np.broadcast_to(room.angles, (len(log.t), 2)) if log.angles is None else log.angles
    rows = zip(log.t.tolist(), log.v.tolist(), log.w.tolist(), log.ranges, angles, strict=True)
    return [Reading(*row) for row in rows]


def score(errors: Array) -> dict[str, float] | None:
    """Root mean square, median and largest error of position [m] and heading [rad]; None without truth."""
    good = errors[np.isfinite(errors).all(axis=1)]
    if not len(good):
        return None
    rms, median, most = np.sqrt(np.mean(good**2, axis=0)), np.median(good, axis=0), good.max(axis=0)
    return {
        "rmse_m": float(rms[0]),
        "median_m": float(median[0]),
        "largest_m": float(most[0]),
        "rmse_rad": float(rms[1]),
        "largest_rad": float(most[1]),
        "rows": len(good),
    }


def save(made: Run, folder: Path | str, force: bool = False, about: Mapping[str, Any] | None = None) -> None:
    """Write estimate.parquet, hypotheses.parquet, summary.json, settings.toml and room.toml.

    about: what else settings.toml says, text or numbers. InputError for a folder that may not be used,
    OutputError where the file system refuses.
    """
    from outrider.io import _log_table
    from outrider.io._folder import describe, prepare

    folder = Path(folder)
    prepare(folder, force)
    _log_table.write(folder / "estimate.parquet", made.columns())
    _log_table.write(folder / "hypotheses.parquet", made.hypotheses())
    rooms.save(made.room, folder / "room.toml")
    begun = {"anywhere": True} if made.start is None else {"start": made.start.tolist()}
    told = {"version": __version__, **(about or {}), "room": "room.toml", "observer": made.observer, **begun}
    describe(folder, made.summary(), told, made.gains._asdict())


def _gains(observer: Observer, given: Mapping[str, float], log: Log, room: Room, dt: float) -> Any:
    """The gains that are given; the others by the observer's rule for this log, if it has one."""
    v, w = (
        float(np.sqrt(np.mean(u[np.isfinite(u)] ** 2))) if np.isfinite(u).any() else 0.0
        for u in (log.v, log.w)
    )
    if not hasattr(observer, "rule") or v == w == 0.0:
        return observers.gains_from(observer, given)
    normalised = given.get("kappa", 0.0) > 0.0
    return extension.replaced(observer.rule(room, dt, v, w, normalised=normalised), given)


def _way(places: list[Place], log: Log, room: Room) -> tuple[Way, observability.Summary | None]:
    pose = np.array([place.pose for place in places])
    known = np.isfinite(pose[:, 0])
    sigma, seen = np.full(len(pose), np.nan), None
    if known.any():
        v, w = np.nan_to_num(log.v[known]), np.nan_to_num(log.w[known])
        angles = np.broadcast_to(room.angles, (len(pose), 2)) if log.angles is None else log.angles
        at, moves = mount.sensors(pose[known], room.mount), mount.twist(v, w, room.mount)
        found = observability.assess(room, at, moves, np.where(np.isfinite(angles), angles, 0.0)[known])
        sigma[known], seen = found.sigma, observability.summary(room, found)
    way = Way(
        pose,
        np.array([place.sigma for place in places]),
        np.array([place.state for place in places]),
        np.array([len(place.others) for place in places]),
        np.array([place.distance for place in places]),
        sigma,
    )
    return way, seen


def _limits(room: Room, started: bool) -> list[str]:
    """What cannot be known in this room, in words."""
    n = room.wall.symmetry
    if n == 0:
        return ["the wall is a circle: where round its centre the robot is, no range can tell"]
    if n > 1 and not started:
        return [f"the wall looks the same from {n} poses: all {n} remain for ever, see hypotheses.parquet"]
    return []


def _out_of_reach(log: Log, room: Room) -> list[int]:
    bad = (log.ranges <= room.range_min) | (log.ranges > room.range_max)
    return [int(n) for n in bad.sum(axis=0)]


def _posed(pose: Array) -> dict[str, float]:
    return {"x_m": float(pose[0]), "y_m": float(pose[1]), "theta_rad": float(pose[2])}
