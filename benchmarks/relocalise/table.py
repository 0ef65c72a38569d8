"""Everything that the page tells of, judged and kept as JSON."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.relocalise import cases, follow, tune
from benchmarks.relocalise.cases import Cell

from outrider import relocalise
from outrider.relocalise import Array, equations, motions, observability, particle, room, simulate
from outrider.relocalise.simulate import Drives

Row = dict[str, Any]
HEADINGS = np.deg2rad([0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0])


def noise(
    cells: tuple[Cell, ...] = cases.NOISE,
    methods: tuple[cases.Method, ...] = cases.METHODS,
    clouds: tuple[int, ...] = cases.CLOUDS,
    runs: int = cases.RUNS,
) -> list[Row]:
    """How well each observer and particle filter follows a robot, in each cell."""
    every = ((*_observers(cell, methods, runs), *_clouds(cell, clouds)) for cell in cells)
    return [row for rows in every for row in rows]


def _observers(cell: Cell, methods: tuple[cases.Method, ...], runs: int) -> list[Row]:
    drives, rows = tune.driven(cell, cases.JUDGED, runs), []
    for method in methods:
        seen, chosen = relocalise.get(method.observer), tune.observer(method, cell)
        gains = seen.Gains(**chosen)
        told = follow.rates(drives, cell.room, method.rates, cell.window)
        poses = follow.follow(seen, gains, drives, cell.room, tune.guesses(drives, cases.JUDGED), told)
        row = _judged(cell, method.label, poses, drives)
        us = [_cost(seen, gains, drives, cell, told, robots) for robots in (1, runs)]
        rows.append({**row, "gains": chosen, "us": us[0], "us_of_many": us[1]})
        _say(f"{cell.label}: {method.label}: {row['rms']}")
    return rows


def _clouds(cell: Cell, numbers: tuple[int, ...]) -> list[Row]:
    if not numbers:
        return []
    runs = cases.CLOUD_RUNS[cell.rate]
    drives, rows = tune.driven(cell, cases.JUDGED, runs), []
    guess = tune.guesses(drives, cases.JUDGED)
    tuned = {n: tune.cloud(cell, min(n, 1000)) for n in numbers}
    for label, gains in _settings(tuned).items():
        begin = time.process_time()
        poses = np.stack([follow.cloud(drives, cell.room, gains, i, guess[i]) for i in range(runs)], axis=1)
        us = 1e6 * (time.process_time() - begin) / runs / len(drives.t)
        row = _judged(cell, label, poses, drives)
        chosen = {"width": gains.width, "odometry": gains.odometry}
        rows.append({**row, "gains": chosen, "us": round(us, 1)})
        _say(f"{cell.label}: {label}: {row['rms']}")
    return rows


def _settings(tuned: dict[int, particle.Gains]) -> dict[str, particle.Gains]:
    """The tuned filters with so many particles, and AMCL as it is published."""
    ours = {f"particle filter, {n}": gains._replace(particles=float(n)) for n, gains in tuned.items()}
    return {**ours, "particle filter, AMCL's settings": cases.AMCL}


def _judged(cell: Cell, label: str, poses: Array, drives: Drives) -> Row:
    """Errors over runs: the median and the worst in ten, and how long until it is within reach and stays."""
    off = follow.errors(cell.room, poses, drives.truth)
    found, (good, since) = follow.rms(off, drives.t), follow.success(off, drives.t)
    return {
        "cell": cell.label,
        "method": label,
        "runs": len(found),
        "rms": _rounded(np.median(found)),
        "p90": _rounded(np.quantile(found, 0.9, method="higher")),
        "good": int(good.sum()),
        "time": _rounded(np.median(since[good])) if good.any() else None,
    }


def _cost(seen: Any, gains: Any, drives: Drives, cell: Cell, told: Array, robots: int) -> float:
    """Processor time of one step of one of so many robots at once [us], the least of three."""
    some = Drives(drives.t[:100], *(part[:100, :robots] for part in drives[1:]))
    taken = []
    for _ in range(3):
        begin = time.process_time()
        follow.follow(seen, gains, some, cell.room, some.truth[0], told[:100, :robots])
        taken.append(time.process_time() - begin)
    return round(1e6 * min(taken) / len(some.t) / robots, 1)


def basin(
    guesses: int = cases.GUESSES,
    walls: tuple[str, ...] = ("ellipse", "asymmetric"),
    methods: tuple[tuple[str, str, dict[str, float]], ...] = cases.BASIN,
    seconds: float = 12.0,
) -> list[Row]:
    """From how far off each observer finds the pose, without noise and with 1 cm."""
    rows = []
    for wall in walls:
        for sigma in (0.0, 0.01):
            where = room.load(wall)
            guess = _far(where, guesses)
            start = np.broadcast_to(cases.BASE, guess.shape)
            drives = simulate.drives(where, motions.constant, guesses, seconds, 50.0, sigma, 0.0, 1, start)
            for label, observer, gains in methods:
                row = _basin(label, observer, gains, where, drives, guess, sigma == 0.0)
                rows.append({"wall": wall, "sigma": sigma, **row})
                _say(f"{wall}, {sigma} m: {label}: {row['good']}")
    return rows


def _far(where: room.Room, n: int) -> Array:
    """(n, 3) guesses inside the wall, their distance even up to `FAR`, their heading any."""
    rng, found = np.random.default_rng(2), np.empty((0, 3))
    while len(found) < n:
        far, bearing = rng.uniform(0.0, cases.FAR, 4 * n), rng.uniform(-np.pi, np.pi, 4 * n)
        x = cases.BASE[:2] + far[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
        made = np.column_stack([x, rng.uniform(-np.pi, np.pi, 4 * n)])
        found = np.concatenate([found, made[where.wall.inside(x, 0.05)]])
    return found[:n]


def _basin(
    label: str,
    name: str,
    values: dict[str, float],
    where: room.Room,
    drives: Drives,
    guess: Array,
    true_rates: bool,
) -> Row:
    seen = relocalise.get(name)
    loose = cases.OPEN if "no gate" in label else {}
    told = follow.rates(drives, where, "exact" if true_rates else "parabola", 0.3)
    poses = follow.follow(seen, seen.Gains(**values, **loose), drives, where, guess, told)
    good, since = follow.success(follow.errors(where, poses, drives.truth), drives.t)
    off = follow.errors(where, guess[None], drives.truth[:1])
    bins = np.digitize(off.heading[0], HEADINGS[1:-1])
    far = np.digitize(off.position[0], np.linspace(0.0, cases.FAR, 6)[1:-1])
    return {
        "method": label,
        "good": round(float(good.mean()), 4),
        "time": _rounded(np.median(since[good])) if good.any() else None,
        "by_heading": [_share(good[bins == k]) for k in range(len(HEADINGS) - 1)],
        "by_distance": [_share(good[far == k]) for k in range(5)],
    }


def anywhere(
    cells: tuple[Cell, ...] = cases.ANYWHERE, clouds: tuple[int, ...] = cases.CLOUDS, seconds: float = 12.0
) -> list[Row]:
    """The search, and particle filters that begin all over the room."""
    rows = []
    for cell in cells:
        drives = tune.driven(cell, cases.JUDGED + 1, cell.runs, seconds)
        said = [follow.search(drives, cell.room, i) for i in range(cell.runs)]
        row = _found(cell, "search", np.stack([s.pose for s in said], axis=1), drives)
        cost = np.concatenate([s.seconds for s in said])
        more = {
            "ambiguous": sum(bool(s.ambiguous[-1]) for s in said),
            "seeds": float(np.median([s.left[0] for s in said])),
            "left": float(np.mean([s.left[-1] for s in said])),
            "us": round(1e6 * float(cost.mean()), 1),
            "worst": round(1e3 * float(np.quantile(cost, 0.999)), 1),
        }
        rows.append({**row, **more})
        _say(f"{cell.wall} {cell.label}: {rows[-1]}")
        if clouds and cell.rate < 20.0:
            tuned = tune.cloud_anywhere(cell, 2000)
            settings = _settings(dict.fromkeys(clouds, tuned))
            rows += [_cloud(cell, label, gains, drives) for label, gains in settings.items()]
    return rows


def _cloud(cell: Cell, label: str, gains: particle.Gains, drives: Drives) -> Row:
    """Particles from all over."""
    runs = min(drives.truth.shape[1], cases.CLOUD_RUNS[cell.rate])
    begin = time.process_time()
    poses = np.stack([follow.cloud(drives, cell.room, gains, i, None) for i in range(runs)], axis=1)
    us = 1e6 * (time.process_time() - begin) / runs / len(drives.t)
    row = _found(cell, label, poses, Drives(drives.t, *(part[:, :runs] for part in drives[1:])))
    _say(f"{cell.wall} {cell.label}: {label}: {row['good']} of {runs}")
    return {**row, "us": round(us, 1), "gains": {"width": gains.width, "odometry": gains.odometry}}


def _found(cell: Cell, label: str, poses: Array, drives: Drives) -> Row:
    good, since = follow.success(follow.errors(cell.room, poses, drives.truth), drives.t)
    return {
        "wall": cell.wall,
        "cell": cell.label,
        "method": label,
        "runs": len(good),
        "good": int(good.sum()),
        "time": _rounded(np.median(since[good])) if good.any() else None,
        "slowest": _rounded(since[good].max()) if good.any() else None,
    }


def driving(names: tuple[str, ...] = tuple(motions.MOTIONS), repeats: int = cases.REPEATS) -> list[Row]:
    """What each motion does for the filter, and for the observer without noise."""
    cell = Cell("ellipse", 10.0, 0.03)
    starts = simulate.anywhere(cell.room, cases.STARTS, np.random.default_rng(cases.JUDGED), 0.6)
    rows = []
    for name in names:
        motion, many = motions.MOTIONS[name], np.repeat(starts, repeats, axis=0)
        made = simulate.drives(cell.room, motion, len(many), 25.0, cell.rate, None, 0.02, cases.JUDGED, many)
        ekf, none = relocalise.get("pose_ekf"), follow.rates(made, cell.room, "none", 0.3)
        poses = follow.follow(ekf, ekf.Gains(), made, cell.room, tune.guesses(made, cases.JUDGED), none)
        off = follow.errors(cell.room, poses, made.truth)
        each = np.median(follow.rms(off, made.t).reshape(len(starts), repeats), axis=1)
        soon = off.position[np.searchsorted(made.t, 3.0 - 1e-9)]
        row = {
            "motion": name,
            "rms": _rounded(np.median(each)),
            "worst": _rounded(each.max()),
            "after_3_s": _rounded(np.median(soon)),
            "time": _rounded(np.median(_noise_free(motion, cell, starts))),
            "sigma_min": _rounded(_seen(made, cell.room)),
        }
        rows.append(row)
        _say(str(row))
    return rows


def _noise_free(motion: motions.Motion, cell: Cell, starts: Array) -> Array:
    """(n,) how long the observer fed forward takes to come within 5 cm and stay so [s]."""
    made = simulate.drives(cell.room, motion, len(starts), 12.0, 50.0, 0.0, 0.0, 0, starts)
    seen = relocalise.get("wall_range")
    told = follow.rates(made, cell.room, "exact", 0.3)
    poses = follow.follow(seen, seen.Gains(5.0, 1.0), made, cell.room, starts + cases.OFF, told)
    off = follow.errors(cell.room, poses, made.truth).position
    last = len(made.t) - np.argmax((off > 0.05)[::-1], axis=0)
    return made.t[np.minimum(np.where((off > 0.05).any(axis=0), last, 0), len(made.t) - 1)]


def _seen(made: Drives, where: room.Room) -> float:
    """The median of the smallest singular value of the observability matrix along the way."""
    every = max(made.truth.shape[1] // cases.STARTS, 1)
    v, w = np.moveaxis(made.odometry[1:, ::every], -1, 0)
    twist = equations.Twist(v, 0.0 * v, w)
    return float(np.nanmedian(observability.sigma_min(where, made.truth[1:, ::every], twist)))


PARTS: dict[str, Callable[[], list[Row]]] = {
    "noise": noise,
    "basin": basin,
    "anywhere": anywhere,
    "motions": driving,
}


def run(path: Path, parts: list[str]) -> None:
    """These parts judged anew, beside what was kept of the others."""
    kept = read(path) if path.exists() else {}
    for part in parts:
        kept[part] = PARTS[part]()
        path.write_text(json.dumps(kept, indent=1) + "\n")


def read(path: Path) -> dict[str, Any]:
    """What `run` wrote."""
    kept: dict[str, Any] = json.loads(path.read_text())
    return kept


def _rounded(value: Any) -> float | None:
    return round(float(value), 5) if np.isfinite(value) else None


def _share(good: Array) -> float | None:
    return round(float(good.mean()), 3) if len(good) else None


def _say(text: str) -> None:
    print(text, file=sys.stderr)
