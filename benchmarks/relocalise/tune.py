"""Gains chosen on the tuning drives: the whole grid at once, as robots beside each other."""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from benchmarks.relocalise import cases, follow
from benchmarks.relocalise.cases import Cell, Method

from outrider import relocalise
from outrider.relocalise import Array, motions, particle, simulate
from outrider.relocalise.simulate import Drives

SECONDS = 25.0


def driven(cell: Cell, seed: int, runs: int, seconds: float = SECONDS) -> Drives:
    """Circles at full speed that stay clear of the wall, each with its place, scale errors and noise."""
    limits = motions.Limits()
    starts = simulate.anywhere(cell.room, 40 * runs, np.random.default_rng(seed), limits.margin)
    radius = limits.v / limits.w
    centre = starts[:, :2] + radius * np.column_stack([-np.sin(starts[:, 2]), np.cos(starts[:, 2])])
    whole = starts[cell.room.wall.inside(centre, radius + limits.margin)][:runs]
    return simulate.drives(cell.room, motions.constant, runs, seconds, cell.rate, seed=seed, start=whole)


def guesses(drives: Drives, seed: int) -> Array:
    """(n, 3) where the observers begin."""
    off = np.random.default_rng(seed).standard_normal(drives.truth[0].shape)
    return np.asarray(drives.truth[0] + cases.GUESS * off)


def observer(method: Method, cell: Cell, runs: int = cases.TUNING_RUNS) -> dict[str, float]:
    """The gains with the least median error on the tuning drives."""
    if not method.grid:
        return dict(method.fixed)
    drives = driven(cell, cases.TUNING, runs)
    told = follow.rates(drives, cell.room, method.rates, cell.window)
    grid = np.array(list(product(*method.grid.values())))
    many = follow.repeated(drives, len(grid))
    told = np.repeat(told, len(grid), axis=1)
    guess = np.repeat(guesses(drives, cases.TUNING), len(grid), axis=0)
    best: tuple[float, dict[str, float]] = (np.inf, {})
    for kappa in method.kappa:
        found = _grid(method, cell, grid, kappa, many, told, guess)
        middle = np.median(found.reshape(runs, len(grid)), axis=0)
        k = int(np.argmin(middle))
        if middle[k] < best[0]:
            gains = dict(zip(method.grid, grid[k].tolist(), strict=True))
            best = (float(middle[k]), {**method.fixed, **gains, **({"kappa": kappa} if kappa else {})})
    return best[1]


def _grid(
    method: Method, cell: Cell, grid: Array, kappa: float, many: Drives, told: Array, guess: Array
) -> Array:
    """(runs * grid,) rms of all settings on all drives; an observer's gains may be columns."""
    seen = relocalise.get(method.observer)
    columns: dict[str, Any] = {
        name: np.tile(values, len(guess) // len(grid))[:, None]
        for name, values in zip(method.grid, grid.T, strict=True)
    }
    if "damping" in columns:
        columns["damping"] = columns["damping"][..., None]
    gains = seen.Gains(**{**method.fixed, **columns, **({"kappa": kappa} if kappa else {})})
    return follow.rms(
        follow.errors(cell.room, follow.follow(seen, gains, many, cell.room, guess, told), many.truth), many.t
    )


@lru_cache
def cloud(cell: Cell, particles: int) -> particle.Gains:
    """Width and odometry noise with which so many particles follow best on the tuning drives."""
    drives = driven(cell, cases.TUNING, 3, 12.0)
    guess = guesses(drives, cases.TUNING)
    best: tuple[float, particle.Gains] = (np.inf, particle.Gains())
    for width, odometry in product(cases.WIDTHS, cases.ODOMETRY):
        gains = particle.Gains(particles=float(particles), width=width, odometry=odometry)
        found = follow.rms(_clouds(drives, cell, gains, guess), drives.t, 6.0)
        worth = float(np.minimum(found, 1.0).mean())
        if worth < best[0]:
            best = (worth, gains)
    return best[1]


def cloud_anywhere(cell: Cell, particles: int, runs: int = cases.TUNING_RUNS) -> particle.Gains:
    """Width with which so many particles, from all over, find the pose most often on the tuning drives."""
    drives = driven(cell, cases.TUNING, runs, 10.0)
    best: tuple[float, particle.Gains] = (-np.inf, particle.Gains())
    for width in cases.WIDTHS:
        gains = particle.Gains(particles=float(particles), width=width)
        off = _clouds(drives, cell, gains, None)
        good, _ = follow.success(off, drives.t)
        worth = float(good.sum() - np.median(np.minimum(off.position[-1], 0.99)))
        if worth > best[0]:
            best = (worth, gains)
    return best[1]


def _clouds(drives: Drives, cell: Cell, gains: particle.Gains, guess: Array | None) -> follow.Errors:
    runs = range(drives.truth.shape[1])
    poses = [follow.cloud(drives, cell.room, gains, i, None if guess is None else guess[i]) for i in runs]
    return follow.errors(cell.room, np.stack(poses, axis=1), drives.truth)
