"""A spinning lidar looking at rectangles, circles and walls: exact rays, then what the sensor makes of them.

Each beam leaves at its own time, so every function takes the poses of sensor and bodies beam by beam; row i
is beam i. Formulas and the choice of their numbers are in docs/scenarios.md. The hops of the nearest point
that trackers suffer from come from the geometry alone.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.geometry import TAU
from outrider.scenario import Sensor

Array = npt.NDArray[np.float64]


class Shapes(NamedTuple):
    """All that a beam can meet, in W; n beams."""

    pose: Array  # (n, k, 3) centres of k rectangles at the time of each beam [m, m, rad]
    extent: Array  # (k, 2) their length, width [m]
    centre: Array  # (n, c, 2) centres of c circles at the time of each beam [m]
    radius: Array  # (c,) [m]
    walls: Array  # (m, 2, 2) both ends of m straight walls [m]


class Echo(NamedTuple):
    """The nearest surface on each ray; infinity and 0 where there is none."""

    range: Array  # (n,) [m]
    incidence: Array  # (n,) cosine of the angle between ray and surface normal, 0..1


def beam_count(sensor: Sensor) -> int:
    """Beams of one turn."""
    return round(360.0 / sensor.step_deg)


def beam_angles(sensor: Sensor) -> Array:
    """Angles (n,) in S [rad] in the order of time, from straight behind, one full turn."""
    n = beam_count(sensor)
    turn: Array = np.arange(n, dtype=np.float64) * (TAU / n) - np.pi
    return -turn if sensor.clockwise else turn


def cast(origin: Array, heading: Array, shapes: Shapes) -> Echo:
    """Nearest echo of rays from origin (n, 2) [m] along heading (n,) [rad], both in W."""
    ray = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        found = [
            _rectangles(origin, ray, shapes.pose, shapes.extent),
            _circles(origin, ray, shapes.centre, shapes.radius),
            _walls(origin, ray, shapes.walls),
        ]
    distance = np.concatenate([d for d, _ in found], axis=1)
    incidence = np.concatenate([c for _, c in found], axis=1)
    if not distance.shape[1]:
        return Echo(np.full(len(ray), np.inf), np.zeros(len(ray)))
    row, nearest = np.arange(len(ray)), np.argmin(distance, axis=1)
    return Echo(distance[row, nearest], incidence[row, nearest])


def _rectangles(origin: Array, ray: Array, pose: Array, extent: Array) -> tuple[Array, Array]:
    """Distance (n, k) to each rectangle by clipping the ray with its two slabs, and incidence (n, k).

    A ray that starts inside a rectangle meets it at distance 0.
    """
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    dx, dy = origin[:, None, 0] - pose[..., 0], origin[:, None, 1] - pose[..., 1]
    along, across = ray[:, None, 0] * c + ray[:, None, 1] * s, ray[:, None, 1] * c - ray[:, None, 0] * s
    end_near, end_far = _slab(dx * c + dy * s, along, 0.5 * extent[:, 0])
    side_near, side_far = _slab(dy * c - dx * s, across, 0.5 * extent[:, 1])
    enter, leave = np.maximum(end_near, side_near), np.minimum(end_far, side_far)
    hit = (enter <= leave) & (leave >= 0.0)
    incidence = np.abs(np.where(end_near >= side_near, along, across))
    return np.where(hit, np.maximum(enter, 0.0), np.inf), np.where(hit, incidence, 0.0)


def _slab(p: Array, u: Array, half: Array) -> tuple[Array, Array]:
    """Distances at which rays from p along u enter and leave the slab |p| <= half; one axis of it."""
    middle, reach = -p / u, half / np.abs(u)
    beside = u == 0.0  # such a ray is inside all the way or never
    near = np.where(beside, np.where(np.abs(p) <= half, -np.inf, np.inf), middle - reach)
    return near, np.where(beside, np.inf, middle + reach)


def _circles(origin: Array, ray: Array, centre: Array, radius: Array) -> tuple[Array, Array]:
    """Distance (n, c) to each circle and incidence (n, c); 0 from inside."""
    to = centre - origin[:, None, :]
    along = to[..., 0] * ray[:, None, 0] + to[..., 1] * ray[:, None, 1]
    across = to[..., 0] * ray[:, None, 1] - to[..., 1] * ray[:, None, 0]
    depth = np.sqrt(radius**2 - across**2)  # NaN where the ray passes by
    hit = (np.abs(across) <= radius) & (along + depth >= 0.0)
    return np.where(hit, np.maximum(along - depth, 0.0), np.inf), np.where(hit, depth / radius, 0.0)


def _walls(origin: Array, ray: Array, walls: Array) -> tuple[Array, Array]:
    """Distance (n, m) to each straight wall and incidence (n, m); a wall seen edge-on is not seen."""
    a, side = walls[:, 0], walls[:, 1] - walls[:, 0]
    to = a - origin[:, None, :]
    turn = ray[:, None, 0] * side[:, 1] - ray[:, None, 1] * side[:, 0]
    distance = (to[..., 0] * side[:, 1] - to[..., 1] * side[:, 0]) / turn
    share = (to[..., 0] * ray[:, None, 1] - to[..., 1] * ray[:, None, 0]) / turn
    hit = (turn != 0.0) & (distance >= 0.0) & (share >= 0.0) & (share <= 1.0)
    incidence = np.abs(turn) / np.hypot(side[:, 0], side[:, 1])
    return np.where(hit, distance, np.inf), np.where(hit, incidence, 0.0)


def return_probability(echo: Echo, sensor: Sensor) -> Array:
    """Chance (n,) that a beam comes back: at least one of a Poisson number of echoes, and not lost otherwise.

    The mean number is `echoes` x incidence x (range_max / range)^2.
    """
    reach = sensor.range_max_m / np.maximum(echo.range, sensor.range_min_m)
    mean: Array = sensor.echoes * echo.incidence * reach**2
    return (1.0 - sensor.lost) * -np.expm1(-mean)


def measure(echo: Echo, sensor: Sensor, rng: np.random.Generator) -> npt.NDArray[np.float32]:
    """Ranges (n,) as the sensor gives them: with noise, inf where nothing comes back or it is out of range.

    Draws 2 n numbers from rng whatever the beams meet, so one world's draws are those of another.
    """
    noise = rng.standard_normal(len(echo.range))
    back = rng.random(len(echo.range)) < return_probability(echo, sensor)
    measured: Any = (echo.range + sensor.sigma_m * noise).astype(np.float32)
    within = (measured >= np.float32(sensor.range_min_m)) & (measured <= np.float32(sensor.range_max_m))
    ranges: npt.NDArray[np.float32] = np.where(back & within, measured, np.float32(np.inf))
    return ranges
