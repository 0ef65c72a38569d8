"""What comes out: tracking from a known start, finding from nothing, and how good odometry is by itself."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.relocalise_real import recordings

from outrider import relocalise
from outrider.geometry import wrap
from outrider.relocalise import Array, Sample, mount, range_rate
from outrider.relocalise.follow import TRACKING
from outrider.relocalise.log import Log
from outrider.relocalise.particle import Gains, ParticleFilter
from outrider.relocalise.room import Room
from outrider.relocalise.run import run
from outrider.relocalise.wall import circle

GATE = 3.0  # the one gain that was set, on `overtakes`, among 2, 3 and 5
KNOWN = {"start_position": 0.05, "start_heading": 0.03, "start_doubt": 0.0}  # of a start that is given
PUBLISHED = {"ks": 20.0, "ka": 20.0, "feedforward": 0.0}
ROBOT_NOISE = {"odometry": 0.3, "drift_heading": 0.05}  # set on the first half of the robot's drive, of seven
PARTICLES = Gains(z_hit=0.6, z_short=0.3, z_rand=0.3, odometry=0.02)  # set on `overtakes`, of six
HIT = 0.15  # a range nearer than this to what the true pose predicts is of the wall [m]
RIGHT = (0.5, 0.3)  # a pose found is right within this [m, rad]
EVERY, LONG = 9, 12.0  # searches begin every so many scans, and last so long [s]


def followed(log: Log, room: Room, name: str, gains: dict[str, float]) -> tuple[Array, Array]:
    """Pose (n, 3) of the robot by an observer begun at the truth, never restarted, and its covariances."""
    observer = relocalise.get(name)
    values = relocalise.gains_from(observer, gains)
    angles = log.angles
    state = observer.start(mount.sensors(log.truth[:1], room.mount), angles[0], room, values)
    before, slopes, dt = np.full(2, np.nan), None, np.diff(log.t, prepend=log.t[0])
    poses, spreads = [], []
    for k, ranges in enumerate(log.ranges):
        rates, slopes = range_rate.advance(slopes, log.t[k], ranges, angles[k])
        moved = mount.twist(log.v[k], log.w[k], room.mount)
        sample = Sample(dt[k], *moved, ranges, before, rates, angles[k])
        state = observer.step(state, sample, room, values) if k else state
        before = ranges
        poses.append(observer.pose(state, sample, room)[0])
        spreads.append(observer.covariance(state)[0] if hasattr(observer, "covariance") else np.eye(3))
    return mount.robot(np.array(poses), room.mount), np.array(spreads)


def particles(log: Log, room: Room, n: int, start: Array | None) -> tuple[Array, float]:
    """Pose (n, 3) of the robot by a particle filter, and seconds a step; by odometry between ranges."""
    cloud = ParticleFilter(room, PARTICLES._replace(particles=float(n)))
    if start is not None:
        cloud.around(mount.sensors(start, room.mount), np.array([0.05, 0.05, 0.03]))
    pose = log.truth[0] if start is not None else np.zeros(3)
    none, since, dt = np.full(2, np.nan), np.zeros(3), np.diff(log.t, prepend=log.t[0])
    poses, spent, steps = [], 0.0, 0
    for k, ranges in enumerate(log.ranges):
        since += dt[k] * np.array([1.0, log.v[k], log.w[k]])
        pose = mount.advanced(pose, log.v[k], log.w[k], dt[k])
        if np.isfinite(ranges).all():
            v, w = since[1:] / max(since[0], 1e-9)
            sample = Sample(since[0], *mount.twist(v, w, room.mount), ranges, none, none, log.angles[k])
            begin = time.perf_counter()
            pose = mount.robot(cloud.step(sample), room.mount)
            spent, steps, since = spent + time.perf_counter() - begin, steps + 1, np.zeros(3)
        poses.append(pose)
    return np.array(poses), spent / max(steps, 1)


def errors(pose: Array, log: Log) -> dict[str, float]:
    """Of position [m] and heading [rad] against motion capture."""
    away = pose - log.truth
    far, turned = np.hypot(away[:, 0], away[:, 1]), np.abs(wrap(away[:, 2]))
    return {
        "rms_m": float(np.sqrt(np.mean(far**2))),
        "median_m": float(np.median(far)),
        "largest_m": float(far.max()),
        "heading_median_deg": float(np.rad2deg(np.median(turned))),
    }


def predicted(log: Log, room: Room) -> Array:
    """(n, 2) ranges that the true pose predicts [m]; NaN where it predicts none."""
    at = mount.sensors(log.truth, room.mount)
    hit = room.wall.ray(at[:, None, :2], at[:, 2:] + log.angles)
    return np.where(room.wall.known(hit.s), hit.range, np.nan)


def blind(log: Log) -> Log:
    """The log without ranges: odometry alone."""
    return replace(log, ranges=np.full_like(log.ranges, np.nan))


def cleaned(log: Log, room: Room) -> Log:
    """The log without strays, by the truth: what no robot has."""
    off = np.abs(log.ranges - predicted(log, room))
    return replace(log, ranges=np.where(np.nan_to_num(off, nan=np.inf) < HIT, log.ranges, np.nan))


def told(log: Log, room: Room) -> dict[str, float]:
    """What became of the ranges of a log, as shares of all that were read."""
    should = predicted(log, room)
    there = np.isfinite(log.ranges)
    off = np.where(there & np.isfinite(should), log.ranges - np.nan_to_num(should), np.nan)
    near = np.abs(np.nan_to_num(off, nan=np.inf)) < HIT
    return {
        "rows": len(log.t),
        "read": float(there.mean()),
        "of_the_wall": float(near.sum() / there.sum()),
        "too_short": float((np.nan_to_num(off) <= -HIT).sum() / there.sum()),
        "too_long": float((np.nan_to_num(off) >= HIT).sum() / there.sum()),
        "unknown_side": float((there & ~np.isfinite(should)).sum() / there.sum()),
        "both_of_the_wall": float(near.all(axis=1).mean()),
    }


def tracking(turned: recordings.Turns, room: Room) -> dict[str, Any]:
    """Errors of one run by what is read and who follows, all begun at the truth."""
    chosen = recordings.car(turned)
    logs = {
        f"{a}, {b}": recordings.car(turned, recordings.fixed(a, b))
        for a, b in ((0, -90), (60, -60), (90, -90))
    }
    ekf = KNOWN | {"gate": GATE}
    cases = {"odometry alone": (blind(chosen), "pose_ekf", ekf), "pair": (chosen, "pose_ekf", ekf)}
    cases |= {f"fixed {name}": (log, "pose_ekf", ekf) for name, log in logs.items()}
    cases["pair, strays removed"] = (cleaned(chosen, room), "pose_ekf", ekf)
    cases["published, pair"] = (chosen, "wall_range", PUBLISHED)
    cases["published, fixed 0, -90"] = (logs["0, -90"], "wall_range", PUBLISHED)
    cases["published, strays removed"] = (cleaned(chosen, room), "wall_range", PUBLISHED)
    cases["fed forward, strays removed"] = (cleaned(chosen, room), "wall_range", {})
    made = {name: errors(followed(log, room, *who)[0], log) for name, (log, *who) in cases.items()}
    return made | {"particles, pair": errors(particles(chosen, room, 1000, chosen.truth[0])[0], chosen)}


def found(log: Log, room: Room) -> dict[str, Any]:
    """Searches begun all along a run: how many end in the right pose, when, and how many in a wrong one."""
    first, last, at_end = [], [], []
    parts = searched(log)
    for part in parts:
        made = run(part, room, None, gains={"gate": GATE})
        error, known = made.errors(), np.flatnonzero(made.way.state == TRACKING)
        right = (error < RIGHT).all(axis=1)
        first.append(
            (part.t[known[0]] - part.t[0], right[known[0]], error[known[0], 0]) if len(known) else None
        )
        last.append(known.size > 0 and known[-1] == len(part.t) - 1)
        at_end.append(bool(right[-1]))
    hits = [entry for entry in first if entry]
    near = [entry[2] for entry in hits if entry[1]]
    return {
        "searches": len(parts),
        "found_right": sum(bool(entry[1]) for entry in hits),
        "found_wrong": sum(not entry[1] for entry in hits),
        "nothing_found": len(parts) - len(hits),
        "median_s": float(np.median([entry[0] for entry in hits])) if hits else None,
        "longest_s": float(max(entry[0] for entry in hits)) if hits else None,
        "median_m": float(np.median(near)) if near else None,
        "right_at_the_end": sum(bool(a and b) for a, b in zip(last, at_end, strict=True)),
        "wrong_at_the_end": sum(bool(a and not b) for a, b in zip(last, at_end, strict=True)),
    }


def searched(log: Log) -> list[Log]:
    """Parts of a log in which the robot is looked for."""
    begins = [t for t in log.t[::EVERY] if log.t[-1] - t >= 0.5 * LONG]
    return [log.part(t, t + LONG) for t in begins]


def found_by_particles(log: Log, room: Room) -> dict[str, Any]:
    """The same searches with 5000 particles, judged at their end, as this filter never says found."""
    right, cost = [], []
    for part in searched(log):
        pose, seconds = particles(part, room, 5000, None)
        away = pose[-1] - part.truth[-1]
        right.append(np.hypot(*away[:2]) < RIGHT[0] and abs(wrap(away[2])) < RIGHT[1])
        cost.append(seconds)
    count = int(sum(right))
    return {
        "searches": len(right),
        "right_at_the_end": count,
        "wrong_at_the_end": len(right) - count,
        "step_ms": float(1e3 * np.median(cost)),
    }


def odometry(log: Log, window: float, room: Room, gains: dict[str, float]) -> dict[str, float]:
    """Odometry alone over windows [s] that begin at the truth: error by way, and against its covariance."""
    far, turned, way, share = [], [], [], []
    for begin in np.arange(log.t[0], log.t[-1] - window, window):
        part = blind(log.part(begin, begin + window))
        gone = float(np.sum(np.abs(part.v[1:]) * np.diff(part.t)))
        if gone < 0.05 * window:
            continue
        pose, spread = followed(part, room, "pose_ekf", gains)
        away = pose[-1] - part.truth[-1]
        away[2] = wrap(away[2])
        way.append(gone)
        far.append(np.hypot(*away[:2]))
        turned.append(abs(away[2]))
        share.append(away @ np.linalg.solve(spread[-1], away))
    return {
        "windows": len(far),
        "way_m": float(np.median(way)),
        "median_m": float(np.median(far)),
        "largest_m": float(max(far)),
        "heading_median_deg": float(np.rad2deg(np.median(turned))),
        "normalised": float(np.mean(share) / 3.0),
    }


def drift(log: Log, room: Room, window: float, gains: dict[str, float] | None = None) -> dict[str, float]:
    """`odometry` with windows that begin at a pose as exact as motion capture."""
    return odometry(log, window, room, {"start_position": 0.005, "start_heading": 0.01} | (gains or {}))


def everything(data: Path) -> dict[str, Any]:
    """All numbers of docs/relocalise-real.md."""
    room = recordings.room()
    out: dict[str, Any] = {"cars": {}}
    for name in recordings.CAR_RUNS:
        turned = recordings.turns(data, name)
        log = recordings.car(turned)
        fixed = {
            f"{a}, {b}": recordings.car(turned, recordings.fixed(a, b)) for a, b in ((0, -90), (60, -60))
        }
        out["cars"][name] = {
            "ranges": {"pair": told(log, room)} | {key: told(other, room) for key, other in fixed.items()},
            "tracking": tracking(turned, room),
            "anywhere": {"pair": found(log, room)}
            | {key: found(other, room) for key, other in fixed.items()},
            "particles": found_by_particles(log, room),
            "odometry": {f"{w:g}": drift(log, room, w) for w in (2.0, 5.0)},
        }
    robot, field = recordings.robot(data), Room(circle(50.0), room.angles)
    half = robot.part(robot.t[len(robot.t) // 2], robot.t[-1] + 1.0)
    out["robot"] = {
        name: {f"{window:g}": drift(half, field, window, gains) for window in (10.0, 60.0)}
        for name, gains in (("default noise", {}), ("noise set", ROBOT_NOISE))
    }
    return out
