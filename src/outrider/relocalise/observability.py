"""Whether two ranges and how they change fix the pose: a number, a word and a reason, before it is trusted.

The number is the smallest singular value of [dz/dp; dF/dp] at the true pose, free of units: lengths along the
wall instead of s_i, the heading and F scaled by the wall's size L0 = perimeter / 2 pi and by a speed:

    columns  s_i: 1 / |r'_i|   theta: 1 / L0   rows  F_i: L0 / (|r'_i| V0)   V0^2 = |(vx, vy)|^2 + (L0 w)^2

It is the same for a room twice as large and a robot twice as fast. The paper's assumptions as numbers, 0
where they fail: H1 `gap`, H2 `sweep`, H2 and H3 `crossing`. With H1, sigma is 0 exactly where both of
`crossing` are; without it, dF/dp may still make up for what dz/dp lacks, as in an ellipse where H2 holds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.geometry import TAU
from outrider.relocalise import Array, Bools
from outrider.relocalise import equations as eq

if TYPE_CHECKING:
    from outrider.relocalise.room import Room
    from outrider.relocalise.wall import Wall

UNOBSERVABLE, WEAK = 1e-6, 1e-2  # a smaller sigma is called so [-]
NOTHING = 1e-6  # a smaller number is one that vanishes [-]
DIRECTIONS = 720  # in which the width of a wall is looked at
WORDS = ("unobservable", "weak", "good")
REASONS = (
    "",
    "outside the wall",
    "a ray ends where the wall is not known",
    "the wall is a circle: no bearing round its centre can be told from another",
    "the robot stands still: its ranges do not change",
    "both rays end on parallel straight walls: nothing tells places along them apart",
    "H1: both rays end where the wall is square to the line between them",
    "H2: neither end moves along the wall",
    "H3: the ranges change the same way along the curve that they leave",
)


class Observability(NamedTuple):
    """At poses (...) and the motion there."""

    sigma: Array  # (...) smallest singular value, scaled; NaN outside the wall, 0 where it is not known [-]
    gap: Array  # (...) the smaller singular value of dz/dp alone, scaled; H1 [-]
    sweep: Array  # (..., 2) speed of each ray's end along the wall over V0, c_i scaled; H2 [-]
    crossing: Array  # (..., 2) c_i D_i, scaled; H2 and H3 [-]
    verdict: npt.NDArray[np.int64]  # (...) row of WORDS
    reason: npt.NDArray[np.int64]  # (...) row of REASONS, why it is not good; 0: none of these


class Map(NamedTuple):
    """Observability over a room, all headings at each place."""

    x: Array  # (m,) [m]
    y: Array  # (k,) [m]
    least: Array  # (k, m) smallest sigma of all headings; NaN outside [-]
    median: Array  # (k, m) [-]
    weak: Array  # (k, m) share of the headings with less than WEAK [-]


class Summary(NamedTuple):
    """Of a path or of any poses."""

    word: str  # of WORDS, by the median
    reason: str  # of REASONS, the commonest; "" if there is none
    least: float  # sigma [-]
    median: float  # [-]
    weak: float  # share of poses that are weak or worse [-]
    unobservable: float  # share that are unobservable [-]
    poses: int  # how many poses the wall's symmetry leaves for ever; 0: infinitely many, a circle
    width: float  # of the wall where it is narrowest [m]; H1 holds everywhere if it is more than `chord`
    chord: float  # longest distance of two points that both sensors hit at once [m]


def sigma_min(room: Room, pose: Array, twist: Any, angles: Array | None = None) -> Array:
    """(...) sigma at poses (..., 3) of the sensors' point, its twist (vx, vy, w), each () or (...).

    angles (2,) [rad]: None for the room's. NaN outside the wall.
    """
    at, there, known = _scene(room, pose, twist, angles)
    return np.where(there, known * _smallest(_scaled(room, at)), np.nan)


def assess(room: Room, pose: Array, twist: Any, angles: Array | None = None) -> Observability:
    """Numbers, verdicts and reasons; arguments as `sigma_min`."""
    at, there, known = _scene(room, pose, twist, angles)
    matrix = _scaled(room, at)
    sigma = np.where(there, known * _smallest(matrix), np.nan)
    gap = np.where(there, np.linalg.svd(matrix[..., :2, :], compute_uv=False)[..., -1], np.nan)
    size, speed = np.linalg.norm(at.dr, axis=-1), _speed(room, at)
    sweep = np.where(there[..., None], _over(eq.sweep(at) * size, speed[..., None]), np.nan)
    bend = eq.transversality(at) / (size**2 * size[..., :1] * size[..., 1:])
    verdict = (sigma >= UNOBSERVABLE).astype(int) + (sigma >= WEAK)
    crossing = sweep * bend
    reason = _reason(room, at, (there, known), gap, sweep, crossing)
    return Observability(sigma, gap, sweep, crossing, verdict, np.where(verdict == 2, 0, reason))


def over(
    room: Room, twist: Any, spacing: float = 0.1, headings: int = 36, angles: Array | None = None
) -> Map:
    """Map over the room for one twist (vx, vy, w) in the robot's axes; grid of `spacing` [m]."""
    outline = room.wall.at(TAU * np.arange(DIRECTIONS) / DIRECTIONS).r
    x, y = (
        np.arange(low, high + spacing, spacing)
        for low, high in zip(outline.min(0), outline.max(0), strict=True)
    )
    places = np.stack(np.meshgrid(x, y), axis=-1)
    inside = room.wall.inside(places)
    theta = TAU * np.arange(headings) / headings
    pose = np.empty((int(inside.sum()), headings, 3))
    pose[..., :2], pose[..., 2] = places[inside][:, None], theta
    sigma = sigma_min(room, pose, twist, angles)
    least, median, weak = (np.full(inside.shape, np.nan) for _ in range(3))
    least[inside], median[inside] = sigma.min(axis=1), np.median(sigma, axis=1)
    weak[inside] = (sigma < WEAK).mean(axis=1)
    return Map(x, y, least, median, weak)


def summary(room: Room, found: Observability, angles: Array | None = None) -> Summary:
    """What to say of a path in one line; poses outside the wall do not count."""
    sigma = found.sigma[np.isfinite(found.sigma)]
    counts = np.bincount(found.reason[found.reason > 1], minlength=len(REASONS))
    chord = eq.longest_chord(room.range_max, room.angles if angles is None else angles)
    least, middle = (float(sigma.min()), float(np.median(sigma))) if sigma.size else (np.nan, np.nan)
    return Summary(
        WORDS[int(middle >= UNOBSERVABLE) + int(middle >= WEAK)],
        REASONS[int(counts.argmax())] if counts.any() else "",
        least,
        middle,
        float(np.mean(sigma < WEAK)) if sigma.size else np.nan,
        float(np.mean(sigma < UNOBSERVABLE)) if sigma.size else np.nan,
        room.wall.symmetry,
        narrowest(room.wall),
        chord,
    )


def narrowest(wall: Wall) -> float:
    """Least width of the wall [m]: the shortest chord that is square to the wall at both its ends."""
    angle = TAU * np.arange(DIRECTIONS) / DIRECTIONS
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    reach = (wall.at(angle).r @ normal.T).max(axis=0)
    return float((reach + np.roll(reach, DIRECTIONS // 2)).min())


def _scene(room: Room, pose: Array, twist: Any, angles: Array | None) -> tuple[eq.Scene, Bools, Bools]:
    """Scene at true poses, some place inside for those outside; which are inside; which see known walls."""
    pose, angles = np.asarray(pose, float), room.angles if angles is None else np.asarray(angles, float)
    there = room.wall.inside(pose[..., :2]) & np.isfinite(pose[..., 2])
    pose = np.where(there[..., None], pose, [*room.wall.centroid, 0.0])
    hit = room.wall.ray(pose[..., None, :2], pose[..., 2:] + angles)
    p = np.concatenate([hit.s, pose[..., 2:]], axis=-1)
    parts = (np.broadcast_to(np.asarray(part, float), there.shape) for part in twist)
    return (
        eq.scene(room.wall, p, angles, hit.range, eq.Twist(*parts)),
        there,
        np.asarray(room.wall.known(hit.s).all(-1)),
    )


def _speed(room: Room, at: eq.Scene) -> Array:
    """V0 (...) [m/s]."""
    turn = at.w[..., 0] * (room.wall.perimeter / TAU)
    return np.sqrt(eq.dot(at.velocity[..., 0, :], at.velocity[..., 0, :]) + turn**2)


def _scaled(room: Room, at: eq.Scene) -> Array:
    """[dz/dp; dF/dp] (..., 4, 3) without units."""
    length, size = room.wall.perimeter / TAU, np.linalg.norm(at.dr, axis=-1)
    row = _over(np.full(size.shape, length), size * _speed(room, at)[..., None])
    steady = eq.mismatch_slope(at, eq.rates(at)) * row[..., None]
    matrix = np.concatenate([eq.gap_slope(at), steady], axis=-2)
    return np.asarray(
        matrix / np.concatenate([size, np.full((*size.shape[:-1], 1), length)], axis=-1)[..., None, :]
    )


def _smallest(matrix: Array) -> Array:
    return np.asarray(np.linalg.svd(matrix, compute_uv=False)[..., -1])


def _over(a: Array, b: Array) -> Array:
    """a / b, and 0 where b is."""
    b = np.broadcast_to(b, a.shape)
    return np.divide(a, b, out=np.zeros(a.shape), where=b > 0.0)


def _reason(
    room: Room, at: eq.Scene, seen: tuple[Bools, Bools], gap: Array, sweep: Array, crossing: Array
) -> npt.NDArray[np.int64]:
    """First of REASONS that holds, 0 for none."""
    there, known = seen
    size = np.linalg.norm(at.dr, axis=-1)
    tangent = at.dr / size[..., None]
    sine = np.abs(eq.dot(tangent[..., 0, :], eq.turned(tangent[..., 1, :])))
    curvature = np.abs(eq.dot(at.ddr, eq.turned(at.dr))).max(axis=-1) / size.min(axis=-1) ** 3
    straight = curvature * room.wall.diameter < NOTHING
    holds = [
        ~there,
        ~known,
        np.full(there.shape, room.wall.symmetry == 0),
        _speed(room, at) == 0.0,
        straight & (sine < NOTHING),
        gap < WEAK,
        (np.abs(sweep) < WEAK).all(axis=-1),
        (np.abs(crossing) < WEAK).all(axis=-1),
    ]
    return np.select(holds, np.arange(1, len(REASONS)), 0)
