"""A particle filter of the kind robots use to find themselves in a map: the baseline of the comparison.

Monte Carlo localisation with the beam model of a range finder, resampling of low variance, and as many
particles as the spread of the cloud asks for (KLD sampling). Published settings are AMCL's.

Sources: S. Thrun, W. Burgard, D. Fox, Probabilistic Robotics, 2005, tables 4.4, 6.1, 8.4; D. Fox, Adapting
the Sample Size in Particle Filters Through KLD-Sampling, 2003.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.errors import InputError
from outrider.geometry import TAU, rotate, wrap
from outrider.relocalise import Array, Sample

if TYPE_CHECKING:
    from outrider.relocalise.room import Room

Ints = npt.NDArray[np.int64]

BIN = np.array([0.5, 0.5, np.deg2rad(10.0)])  # of the histogram of poses, x, y [m], theta [rad]; AMCL's
NEAR = np.array([0.5, 0.5, 0.35])  # of the heaviest bin: what counts to its cluster


class Gains(NamedTuple):
    """Settings; those of the beam model, of KLD and of the motion are named and preset as AMCL's are."""

    particles: float = 1000.0  # at most, and at the start
    least: float = 0.0  # particles at least, as KLD sampling asks; 0: always `particles`
    error: float = 0.01  # KLD: largest divergence of the cloud from what it stands for
    quantile: float = 2.33  # KLD: of the normal distribution, with what certainty (0.99)
    z_hit: float = 0.95  # weights of the beam model: the wall, measured with noise
    z_short: float = 0.1  # ... something before it
    z_max: float = 0.05  # ... no return
    z_rand: float = 0.05  # ... anything
    width: float = 0.05  # standard deviation of a hit [m]: tuned; AMCL's own is 0.2
    decay: float = 0.1  # of the density of short ranges [1/m]
    odometry: float = 0.2  # variance of travel and turn per square of each in a step [-]
    resample_below: float = 0.5  # resample where the effective share of the particles is below this


class Cloud(NamedTuple):
    """Particles."""

    pose: Array  # (n, 3) x, y [m], theta [rad]
    weight: Array  # (n,) sum 1


class ParticleFilter:
    """One robot's cloud, step by step; the same seed gives the same numbers."""

    def __init__(self, room: Room, gains: Gains | None = None, seed: int = 0) -> None:
        """Particles all over the room, `around` to start from a guess."""
        self.room, self.gains, self.rng = room, gains or Gains(), np.random.default_rng(seed)
        if self.gains.particles < 1.0 or self.gains.width <= 0.0:
            raise InputError(
                f"particles {self.gains.particles:g}, width {self.gains.width:g}; want more than 0"
            )
        n = int(self.gains.particles)
        self.cloud = Cloud(everywhere(room, n, self.rng), np.full(n, 1.0 / n))

    def around(self, pose: Array, spread: Array) -> None:
        """Put all particles about a pose (3,), standard deviations (3,) [m, m, rad]."""
        n = int(self.gains.particles)
        self.cloud = Cloud(pose + spread * self.rng.standard_normal((n, 3)), np.full(n, 1.0 / n))

    def step(self, sample: Sample) -> Array:
        """Take in a sample with scalar twist and ranges (2,); the pose (3,) after it."""
        moved = self.cloud._replace(pose=_moved(self.cloud.pose, sample, self.gains, self.rng))
        self.cloud = _weighed(moved, sample, self.room, self.gains)
        pose = centre(self.cloud)
        self.cloud = _resampled(self.cloud, self.gains, self.rng)
        return pose


def everywhere(room: Room, n: int, rng: np.random.Generator) -> Array:
    """(n, 3) poses, even over the inside of the wall."""
    corners = room.wall.at(TAU * np.arange(360) / 360).r
    low, high, found = corners.min(axis=0), corners.max(axis=0), np.empty((0, 2))
    while len(found) < n:
        x = rng.uniform(low, high, (2 * n, 2))
        found = np.concatenate([found, x[room.wall.inside(x)]])
    return np.column_stack([found[:n], rng.uniform(-np.pi, np.pi, n)])


def centre(cloud: Cloud) -> Array:
    """Pose (3,): the weighted mean of the heaviest cluster, as of several only one can be true."""
    cells, index = _histogram(cloud.pose)
    heaviest = int(np.argmax(np.bincount(index, cloud.weight)))
    seed = (cells[heaviest] + 0.5) * BIN
    for _ in range(2):
        away = cloud.pose - seed
        away[:, 2] = wrap(away[:, 2])
        weight = cloud.weight * (np.abs(away) <= NEAR).all(axis=1)
        if not weight.any():
            break
        seed = seed + weight @ away / weight.sum()
    return np.array([seed[0], seed[1], wrap(seed[2])])


def likelihood(measured: Array, expected: Array, range_max: float, gains: Gains) -> Array:
    """Beam model: density (...) of `measured` [m], NaN for no return, where the wall is at `expected` [m].

    A mixture of a hit with noise, something in between, no return, and anything; expected NaN: no wall.
    """
    z, wall = np.broadcast_arrays(np.asarray(measured, float), np.asarray(expected, float))
    back, there = np.isfinite(z), np.isfinite(wall)
    z, wall = np.where(back, z, 0.0), np.where(there, wall, 0.0)
    hit = np.exp(-0.5 * np.minimum(((z - wall) / gains.width) ** 2, 600.0)) / (np.sqrt(TAU) * gains.width)
    short = np.where(z <= wall, gains.decay * np.exp(-gains.decay * z), 0.0)
    short = short / np.maximum(1.0 - np.exp(-gains.decay * wall), 1e-3)
    seen = there * (gains.z_hit * hit + gains.z_short * short) + gains.z_rand / range_max
    return np.where(back, seen, gains.z_max + np.where(there, 0.0, gains.z_hit))


def enough(cells: int, gains: Gains) -> int:
    """Particles that keep the divergence below gains.error with `cells` occupied bins: Fox's eq. 14."""
    if not gains.least:
        return int(gains.particles)
    k = max(cells - 1, 1)
    share = 2.0 / (9.0 * k)
    n = k / (2.0 * gains.error) * (1.0 - share + np.sqrt(share) * gains.quantile) ** 3
    return int(np.clip(n, gains.least, gains.particles))


def _moved(pose: Array, sample: Sample, gains: Gains, rng: np.random.Generator) -> Array:
    """Poses after the twist of the sample, on an arc, with the noise of odometry."""
    noise, n = np.sqrt(gains.odometry), len(pose)
    travel, turn = np.hypot(sample.vx, sample.vy) * sample.dt, sample.w * sample.dt
    spread = noise * np.hypot(travel, turn)
    turned = turn + spread * rng.standard_normal(n)
    along = np.array([sample.vx, sample.vy], float) * sample.dt
    unit = along / travel if travel > 0.0 else np.array([1.0, 0.0])
    way = along + (spread * rng.standard_normal(n))[:, None] * unit
    x = pose[:, :2] + rotate(way, pose[:, 2] + 0.5 * turned)
    return np.column_stack([x, wrap(pose[:, 2] + turned)])


def _weighed(cloud: Cloud, sample: Sample, room: Room, gains: Gains) -> Cloud:
    """Weights after both ranges; nothing where a particle has left the room, as before where all have."""
    expected = room.wall.ray(cloud.pose[:, None, :2], cloud.pose[:, 2:] + sample.angles)
    inside = np.isfinite(expected.range[:, 0])
    wall = np.where(room.wall.known(expected.s), expected.range, np.nan)
    weight = cloud.weight * inside * likelihood(sample.ranges, wall, room.range_max, gains).prod(axis=1)
    total = float(weight.sum())
    return cloud._replace(weight=weight / total) if total > 0.0 else cloud


def _resampled(cloud: Cloud, gains: Gains, rng: np.random.Generator) -> Cloud:
    """Particles of equal weight, drawn with one random number at even steps, where few carry the weight."""
    if 1.0 / float(cloud.weight @ cloud.weight) > gains.resample_below * len(cloud.weight):
        return cloud
    cells = len(_histogram(cloud.pose[_drawn(cloud.weight, len(cloud.weight), rng)])[0])
    n = enough(cells, gains)
    return Cloud(cloud.pose[_drawn(cloud.weight, n, rng)], np.full(n, 1.0 / n))


def _drawn(weight: Array, n: int, rng: np.random.Generator) -> Ints:
    sums = np.cumsum(weight)
    drawn = np.searchsorted(sums, (rng.random() + np.arange(n)) / n * sums[-1]).clip(0, len(weight) - 1)
    return np.asarray(drawn)


def _histogram(pose: Array) -> tuple[Ints, Ints]:
    """Occupied cells (k, 3) and the cell (n,) of each pose."""
    cell = np.floor(pose / BIN).astype(np.int64)
    low = cell.min(axis=0)
    size = cell.max(axis=0) - low + 1
    key = np.ravel_multi_index(tuple((cell - low).T), tuple(size))
    found, index = np.unique(key, return_inverse=True)
    return np.column_stack(np.unravel_index(found, tuple(size))) + low, index.astype(np.int64)
