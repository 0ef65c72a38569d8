"""Every pose that two ranges allow inside a known wall: the statically unobservable curve, enumerated.

Two ranges fix the chord between the two points they hit as the robot sees it, c = rho_1 e(phi_1) - rho_2
e(phi_2). At heading theta the wall must satisfy z = r(s_1) - r(s_2) - R(theta) c = 0. In a convex curve the
length of the chords of one direction is a concave function of where they lie: there are at most two as long
as c, one on either side of the longest. Turning the heading slides this rod of fixed length along the wall.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from outrider.geometry import TAU, rotate, wrap
from outrider.relocalise import Array, Bools

if TYPE_CHECKING:
    from outrider.relocalise.room import Room
    from outrider.relocalise.wall import Wall

TABLE = 512  # corners of the polygon on which chords are first looked for; Newton's method makes them exact
NEWTON = 30  # steps at most; three are usual, more only where the two chords of a heading become one
LONGEST = 0.3  # step of any parameter [rad]
EXACT = 1e-12  # what is left of z, in diameters of the wall, when Newton's method has come to its end
TRUSTED = 1e-9  # ... and what may be left of it in a match
NEAR = 3.0  # seeds: standard deviations of the ranges by which no chord may be long enough
APART = 0.25  # seeds: largest distance of neighbours along the curve [m] ...
SMALL = 0.04  # ... in a wall larger than 6 m; in a smaller one this share of its diameter


class Chord(NamedTuple):
    """Chords of a wall that are seen by both sensors, from headings theta; axis 0 is the heading's."""

    s: Array  # (..., 2) the ends seen by sensor 1 and 2; NaN where there is none
    theta: Array  # (...) [rad]


def matches(wall: Wall, ranges: Array, angles: Array, headings: Array) -> Array:
    """Poses (m, 2, 3) that see both `ranges` (2,) [m] at `angles` (2,) from ahead, for `headings` (m,) [rad].

    All there are, at most two a heading, x, y [m], theta [rad] in [-pi, pi); NaN where there are fewer, where
    the point is outside the wall or a ray ends on a part that is not known. Along parallel or straight walls
    a heading may have infinitely many: then those next to it stand for them.
    """
    theta = np.repeat(wrap(np.asarray(headings, float))[:, None], 2, axis=1)
    c = _rod(ranges, angles)
    chord, left = _exact(wall, Chord(_coarse(wall, c, theta[:, 0], 0.0), theta), c, turning=False)
    return _poses(wall, ranges, angles, chord, left <= TRUSTED * wall.diameter)


def seeds(room: Room, ranges: Array, angles: Array, headings: int = 64) -> Array:
    """Poses (m, 3) along the whole curve that two finite `ranges` (2,) [m] at `angles` (2,) [rad] leave.

    Nowhere farther apart than APART, also where the curve folds back and where straight walls leave many
    poses to one heading. Where noise has made the rod longer than any chord, the nearest. None: (0, 3).
    """
    wall, c, near = room.wall, _rod(ranges, angles), NEAR * float(np.hypot(room.sigma, room.sigma))
    theta = np.repeat(wrap(TAU * np.arange(headings) / headings)[:, None], 2, axis=1)
    rows, left = _exact(wall, Chord(_coarse(wall, c, theta[:, 0], near), theta), c, turning=True)
    rows = rows._replace(s=np.where((left <= near)[..., None], rows.s, np.nan))
    between, rest = _exact(wall, _between(room, ranges, angles, rows, near), c, turning=True)
    chord = Chord(
        np.concatenate([rows.s.reshape(-1, 2), between.s]), np.append(rows.theta.ravel(), between.theta)
    )
    poses = _poses(wall, ranges, angles, chord, np.append(left.ravel(), rest) <= near)
    return poses[np.isfinite(poses[:, 0])]


def _rod(ranges: Array, angles: Array) -> Array:
    """(2,) from the point hit by sensor 2 to that hit by sensor 1, in the robot's axes [m]."""
    ends = np.asarray(ranges, float)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.asarray(ends[0] - ends[1])


def _coarse(wall: Wall, c: Array, headings: Array, near: float) -> Array:
    """(m, 2, 2) ends s of both chords of a polygon in the wall, that of sensor 1 first; NaN where none is.

    `near` [m]: where c is longer than the longest chord by no more, that one is taken for both.
    """
    t, length = TAU * np.arange(TABLE + 1) / TABLE, float(np.hypot(*c))
    r = wall.at(t % TAU).r
    sagitta = 0.3 * float(np.abs(np.diff(r, 2, axis=0)).max())
    out = np.full((len(headings), 2, 2), np.nan)
    for k, direction in enumerate(headings + np.arctan2(c[1], c[0])):
        along = r @ np.array([np.cos(direction), np.sin(direction)])
        height = r @ np.array([-np.sin(direction), np.cos(direction)])
        low, top = int(np.argmin(height[:-1])), int(np.argmax(height[:-1]))
        front = np.arange(low, top + 1 if low < top else top + TABLE + 1)
        back = np.arange(low + TABLE, front[-1] - 1, -1)
        sides = [(height[i % TABLE], along[i % TABLE], i * (TAU / TABLE)) for i in (front, back)]
        levels = np.concatenate([sides[0][0], sides[1][0][1:-1]])
        levels.sort()
        gap = np.interp(levels, *sides[0][:2]) - np.interp(levels, *sides[1][:2])
        longest = int(np.argmax(gap))
        if gap[longest] < length - near - sagitta:
            continue
        at = np.array(
            [
                np.interp(length, gap[: longest + 1], levels[: longest + 1]),
                np.interp(length, gap[longest:][::-1], levels[longest:][::-1]),
            ]
        )
        if gap[longest] < length + sagitta:  # the two are nearly one: come to it from either side
            at += np.array([-0.01, 0.01]) * (levels[-1] - levels[0])
        out[k] = np.column_stack([np.interp(at, h, s) for h, _, s in sides])
    return out


def _exact(wall: Wall, chord: Chord, c: Array, turning: bool) -> tuple[Chord, Array]:
    """Chords with z = 0 next to these, and what is left of |z| [m]; `turning`: the heading may change too.

    Newton's method; with more unknowns than equations, the shortest step.
    """
    there = np.isfinite(chord.s[..., 0])
    p = np.column_stack([chord.s[there], chord.theta[there]])
    best, least, size = p, np.full(len(p), np.inf), wall.diameter
    for _ in range(NEWTON):
        curve, d = wall.at(p[:, :2] % TAU), rotate(c, p[:, 2])
        z = curve.r[:, 0] - curve.r[:, 1] - d
        left = np.hypot(z[:, 0], z[:, 1])
        best, least = np.where((left < least)[:, None], p, best), np.minimum(left, least)
        if least.max(initial=0.0) <= EXACT * size:
            break
        speed = np.einsum("kij,kij->ki", curve.dr, curve.dr)
        weight = np.column_stack([1.0 / speed, np.full(len(z), turning / size**2)])
        jacobian = np.stack([curve.dr[:, 0], -curve.dr[:, 1], np.column_stack([d[:, 1], -d[:, 0]])], axis=2)
        weighted = jacobian * weight[:, None, :]
        normal = weighted @ jacobian.transpose(0, 2, 1) + 1e-9 * np.eye(2)
        step = np.einsum("kji,kj->ki", weighted, np.linalg.solve(normal, z[..., None])[..., 0])
        p = p - step * (LONGEST / np.maximum(np.abs(step).max(axis=1), LONGEST))[:, None]
    found = np.full((*there.shape, 3), np.nan)
    found[there] = best
    left = np.full(there.shape, np.inf)
    left[there] = least
    return Chord(found[..., :2], np.where(there, found[..., 2], chord.theta)), left


def _poses(wall: Wall, ranges: Array, angles: Array, chord: Chord, sure: Bools) -> Array:
    """(..., 3) the poses that see the ends of the chords; NaN where not `sure`, outside, or unknown."""
    ends = np.where(sure[..., None], chord.s, 0.0) % TAU
    x = _points(wall, ranges, angles, Chord(ends, chord.theta))
    there = sure & wall.inside(x) & wall.known(ends).all(axis=-1)
    pose = np.concatenate([x, wrap(chord.theta)[..., None]], axis=-1)
    return np.where(there[..., None], pose, np.nan)


def _points(wall: Wall, ranges: Array, angles: Array, chord: Chord) -> Array:
    """(..., 2) where the robot is: the mean of what its two sensors say, one where z = 0."""
    bearing = chord.theta[..., None] + angles
    ray = np.asarray(ranges)[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    return np.asarray((wall.at(chord.s % TAU).r - ray).mean(axis=-2))


def _between(room: Room, ranges: Array, angles: Array, rows: Chord, near: float) -> Chord:
    """Chords on straight lines between neighbours that are far apart along the curve.

    Neighbours: the same side of the longest chord at the next heading; both sides where the next or the last
    heading has none, the fold, and where all between them are as long up to `near`, between parallel walls.
    """
    p = np.concatenate([rows.s, rows.theta[..., None]], axis=-1)
    there, after = np.isfinite(p).all(axis=(1, 2)), np.roll(p, -1, axis=0)
    halfway = 0.5 * _difference(p[:, 1], p[:, 0])
    d = rotate(_rod(ranges, angles), rows.theta[:, 0])
    middle = np.where(there[:, None], p[:, 0] + halfway, 0.0)
    z = -np.diff(room.wall.at(middle[:, :2] % TAU).r, axis=1)[:, 0] - d
    last = np.isfinite(after).all(axis=(1, 2)) & np.roll(there, 1)
    across = there & (~last | (np.hypot(z[:, 0], z[:, 1]) <= near))
    start = np.concatenate([p[:, 0], p[:, 1], p[across, 0]])
    end = np.concatenate([after[:, 0], after[:, 1], p[across, 1]])
    both = np.isfinite(start + end).all(axis=1)
    start, way = start[both], _difference(end[both], start[both])
    x = [_points(room.wall, ranges, angles, Chord(q[:, :2], q[:, 2])) for q in (start, start + way)]
    apart = min(APART, SMALL * room.wall.diameter)
    parts = np.ceil(np.hypot(*(x[1] - x[0]).T) / apart).astype(int)
    which = np.repeat(np.arange(len(parts)), np.maximum(parts - 1, 0))
    first = np.cumsum(np.maximum(parts - 1, 0)) - np.maximum(parts - 1, 0)
    share = (np.arange(len(which)) - first[which] + 1.0) / parts[which]
    q = start[which] + share[:, None] * way[which]
    return Chord(q[:, :2], q[:, 2])


def _difference(a: Array, b: Array) -> Array:
    """a - b the short way round; all three parameters of a chord are angles."""
    return np.asarray(wrap(a - b))
