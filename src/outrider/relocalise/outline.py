"""Walls given by points: polygons with round corners, and smooth splines.

Points are put in order round the room, or refused with one clear line: open, crossing, not convex.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from outrider.errors import InputError
from outrider.relocalise.curve import Array, Bools, Curve, Point, Wall, cross

STRAIGHT = 1e-9  # sine of a turn to the right that is rounding only
FAR = 4.0  # times the longest other step: a wall whose end is further from its beginning is open
FEW = 6  # points of so few are never called open


class _Pieces(NamedTuple):
    """Straight and round pieces of a polygon, in order; s is arc length, scaled."""

    start: Array  # (m,) s at which it begins
    r: Array  # (m, 2) where [m]
    angle: Array  # (m,) of its tangent there [rad]
    bend: Array  # (m,) 1 / radius, 0 where straight [1/m]
    scale: float  # metres of wall for each radian of s
    known: Bools  # (m,)


class Polygon(Wall, frozen=True, tag="polygon"):
    """Straight sides joined by arcs of one radius; side i runs from corner i to the next."""

    corners_m: tuple[Point, ...]
    corner_radius_m: float = 0.0
    unknown_sides: tuple[int, ...] = ()  # only close the curve: there is no wall, or none that is known

    def _check(self) -> None:
        checked("corners_m", self.corners_m, 3)
        wrong = [i for i in self.unknown_sides if not 0 <= i < len(self.corners_m)]
        if wrong:
            raise InputError(f"wall: unknown_sides has {wrong[0]}; want 0 to {len(self.corners_m) - 1}")
        if not 0.0 <= self.corner_radius_m < np.inf:
            raise InputError(f"wall: corner_radius_m = {self.corner_radius_m:g}; want 0 or more")
        _ = self._pieces

    @cached_property
    def _pieces(self) -> _Pieces:
        corners, flipped = checked("corners_m", self.corners_m, 3)
        n = len(corners)
        known = np.array([i not in self.unknown_sides for i in range(n)])
        if flipped:
            known = np.roll(known[::-1], -1)
        side = np.roll(corners, -1, axis=0) - corners
        length = np.hypot(side[:, 0], side[:, 1])
        angle = np.arctan2(side[:, 1], side[:, 0])
        turn = np.mod(np.roll(angle, -1) - angle + 1e-9, 2 * np.pi) - 1e-9  # at the end of each side
        cut = self.corner_radius_m * np.tan(turn / 2)  # what the arc at its end takes from a side
        straight = length - cut - np.roll(cut, 1)
        if straight.min() < 0.0:
            raise InputError(
                f"wall: corner_radius_m = {self.corner_radius_m:g} is too large for side "
                f"{np.argmin(straight)} of {length[np.argmin(straight)]:g} m; want it smaller"
            )
        unit = side / length[:, None]
        begin, end = corners + unit * np.roll(cut, 1)[:, None], corners + unit * (length - cut)[:, None]
        lengths = np.stack([straight, self.corner_radius_m * np.maximum(turn, 0.0)], axis=1).ravel()
        bend = 1 / self.corner_radius_m if self.corner_radius_m > 0.0 else 0.0
        keep = lengths > 1e-12 * lengths.sum()
        start = 2 * np.pi * np.concatenate([[0.0], np.cumsum(lengths)[:-1]]) / lengths.sum()
        return _Pieces(
            start[keep],
            np.stack([begin, end], axis=1).reshape(-1, 2)[keep],
            np.repeat(angle, 2)[keep],
            np.tile([0.0, bend], n)[keep],
            lengths.sum() / (2 * np.pi),
            np.stack([known, known & np.roll(known, -1)], axis=1).ravel()[keep],
        )

    def breaks(self) -> Array:
        """Ends of the sides."""
        return self._pieces.start

    def unknown(self) -> Array:
        """The unknown sides, and the arcs beside them."""
        ends = np.append(self._pieces.start, 2 * np.pi)
        return np.stack([ends[:-1], ends[1:]], axis=1)[~self._pieces.known]

    def curve(self, s: Array) -> Curve:
        """Line or arc at s (...,)."""
        pieces = self._pieces
        s = np.mod(s, 2 * np.pi)
        i = np.searchsorted(pieces.start, s, side="right") - 1
        along, bend, before = pieces.scale * (s - pieces.start[i]), pieces.bend[i], pieces.angle[i]
        angle = before + bend * along
        c, n, safe = np.cos(angle), np.sin(angle), np.where(bend > 0.0, bend, 1.0)
        dx = np.where(bend > 0.0, (n - np.sin(before)) / safe, along * c)
        dy = np.where(bend > 0.0, (np.cos(before) - c) / safe, along * n)
        t = np.stack([c, n], axis=-1)
        normal = np.stack([-n, c], axis=-1) * (bend * pieces.scale**2)[..., None]
        return Curve(pieces.r[i] + np.stack([dx, dy], axis=-1), pieces.scale * t, normal)


class Spline(Wall, frozen=True, tag="points"):
    """Periodic C2 cubic spline through points in order, s being chord length, scaled."""

    points_m: tuple[Point, ...]

    def _check(self) -> None:
        s = np.linspace(0.0, 2 * np.pi, 20 * len(self.points_m) + 1)
        r, dr, ddr = self.curve(s)
        bend = cross(dr, ddr) / np.sum(dr * dr, axis=-1) ** 1.5
        if bend.min() <= 0.0:
            x, y = r[np.argmin(bend)]
            raise InputError(
                f"wall: the curve through points_m is not convex near ({x:.3g}, {y:.3g}) m; want points "
                'without noise, or shape = "polygon" for straight sides'
            )

    @cached_property
    def _spline(self) -> tuple[Array, Array]:
        from scipy.interpolate import CubicSpline

        points, _ = checked("points_m", self.points_m, 4)
        refuse_open("points_m", points)
        closed = np.vstack([points, points[:1]])
        chord = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
        fit = CubicSpline(2 * np.pi * chord / chord[-1], closed, bc_type="periodic")
        return fit.x, np.ascontiguousarray(fit.c.swapaxes(0, 1))  # (m, 4, 2), highest power first

    def breaks(self) -> Array:
        """The points, where the third derivative jumps."""
        return self._spline[0][:-1]

    def curve(self, s: Array) -> Curve:
        """The spline at s (...,)."""
        knots, c = self._spline
        s = np.mod(s, 2 * np.pi)
        i = np.searchsorted(knots[:-1], s, side="right") - 1
        u = (s - knots[i])[..., None]
        c3, c2, c1, c0 = np.moveaxis(c[i], -2, 0)
        return Curve(((c3 * u + c2) * u + c1) * u + c0, (3 * c3 * u + 2 * c2) * u + c1, 6 * c3 * u + 2 * c2)


def checked(name: str, points: tuple[Point, ...], least: int) -> tuple[Array, bool]:
    """Points (n, 2) counter-clockwise without the repeated first one, and whether they were turned round.

    Raises InputError, naming the key, for too few, not finite, repeated, open, crossing or not convex ones.
    """
    given = np.array(points, dtype=float).reshape(-1, 2)
    if len(given) > 1 and np.array_equal(given[0], given[-1]):
        given = given[:-1]
    if len(given) < least:
        raise InputError(f"wall: {name} has {len(given)} different points; want {least} or more")
    if not np.isfinite(given).all():
        raise InputError(f"wall: {name} has a value that is no finite number; want metres")
    step = np.roll(given, -1, axis=0) - given
    length = np.hypot(step[:, 0], step[:, 1])
    if length.min() == 0.0:
        raise InputError(f"wall: {name} has point {np.argmin(length)} twice in a row; want it once")
    _refuse_crossing(name, given, step)
    area = float(np.sum(cross(given - given.mean(axis=0), step)))
    if abs(area) <= STRAIGHT * length.sum() ** 2:
        raise InputError(f"wall: {name} lie on one line and enclose no area; want points round a room")
    if area < 0.0:
        given, step, length = given[::-1], -np.roll(step[::-1], -1, axis=0), np.roll(length[::-1], -1)
    turn = cross(step, np.roll(step, -1, axis=0)) / (length * np.roll(length, -1))
    if turn.min() < -STRAIGHT:
        x, y = np.roll(given, -1, axis=0)[np.argmin(turn)]
        raise InputError(f"wall: {name} is not convex at ({x:.3g}, {y:.3g}) m; want no corner that points in")
    return given, area < 0.0


def refuse_open(name: str, points: Array) -> None:
    """InputError where the step that closes a smooth wall (n, 2) is far longer than all others."""
    length = np.hypot(*np.diff(points, axis=0).T)
    closing = float(np.hypot(*(points[0] - points[-1])))
    if len(points) >= FEW and closing > FAR * length.max():
        raise InputError(
            f"wall: {name} is open: its ends are {closing:.3g} m apart, other points at most "
            f'{length.max():.3g} m; want points all round, or shape = "polygon" with unknown_sides'
        )


def _refuse_crossing(name: str, corner: Array, step: Array) -> None:
    """InputError where two sides that are no neighbours meet."""
    n = len(corner)
    between = corner - corner[:, None]  # [i, j]: from corner i to corner j
    side = cross(step[:, None], between)  # of corner j, seen along side i
    apart = side * np.roll(side, -1, axis=1) < 0.0  # the ends of side j lie on both sides of side i
    first, second = np.nonzero(np.triu(apart & apart.T, 2))
    if len(first):
        i, j = first[0], second[0]
        raise InputError(
            f"wall: {name} crosses itself between points {i}-{(i + 1) % n} and {j}-{(j + 1) % n}; "
            "want points in order round the room"
        )
