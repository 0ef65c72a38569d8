"""The shapes a wall may have: ellipse, circle, superellipse, support function, polygon, spline.

What all of them can do is in `curve.py`; those given by points are in `outline.py`. The fields of a shape are
its keys in a room's file, and a shape is checked when it is made: InputError where it is no convex curve.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from outrider.errors import InputError
from outrider.relocalise.curve import Array, Bools, Curve, Hit, Point, Wall
from outrider.relocalise.outline import Polygon, Spline

__all__ = [
    "Curve",
    "Hit",
    "Wall",
    "circle",
    "ellipse",
    "polygon",
    "rounded_rectangle",
    "superellipse",
    "support",
    "through",
]


class _Round(Wall, frozen=True):
    """r = (a cos s, b sin s)."""

    @property
    def _axes(self) -> Array:
        raise NotImplementedError

    def curve(self, s: Array) -> Curve:
        """The ellipse and its derivatives at s (...,)."""
        c, n = np.cos(s), np.sin(s)
        r = np.stack([c, n], axis=-1) * self._axes
        return Curve(r, np.stack([-n, c], axis=-1) * self._axes, -r)

    def _local(self, x: Array) -> Array:
        """Vectors in the scale that makes the wall a unit circle."""
        return np.asarray((x @ self._turn if self.turn_deg else x) / self._axes)

    def _contains(self, x: Array) -> Bools:
        u = self._local(x - self._centre)
        return np.asarray(u[..., 0] ** 2 + u[..., 1] ** 2 < 1.0)

    def _cast(self, x: Array, e: Array, bearing: Array) -> Hit:
        """Root of |u + range d| = 1, in the form that loses no digits near the wall."""
        u, d = self._local(x - self._centre), self._local(e)
        a = d[..., 0] ** 2 + d[..., 1] ** 2
        b = u[..., 0] * d[..., 0] + u[..., 1] * d[..., 1]
        c = 1.0 - (u[..., 0] ** 2 + u[..., 1] ** 2)
        root = np.sqrt(b * b + a * c)
        length = np.where(b > 0.0, c / np.where(b > 0.0, root + b, 1.0), (root - b) / a)
        at = u + length[..., None] * d
        return Hit(np.mod(np.arctan2(at[..., 1], at[..., 0]), 2 * np.pi), length)


class Ellipse(_Round, frozen=True, tag="ellipse"):
    """r = (a cos s, b sin s)."""

    half_axes_m: Point

    def _check(self) -> None:
        _above_zero("half_axes_m", *self.half_axes_m)

    @cached_property
    def _axes(self) -> Array:
        return np.array(self.half_axes_m, dtype=float)


class Circle(_Round, frozen=True, tag="circle"):
    """A circle, in which no pose can be found: to be refused by those who look for one."""

    radius_m: float

    def _check(self) -> None:
        _above_zero("radius_m", self.radius_m)

    @cached_property
    def _axes(self) -> Array:
        return np.full(2, float(self.radius_m))


class Superellipse(Wall, frozen=True, tag="superellipse"):
    """|x/a|^p + |y/b|^p = 1 with s the polar angle; C2 for p of 2 and above."""

    half_axes_m: Point
    power: float

    def _check(self) -> None:
        _above_zero("half_axes_m", *self.half_axes_m)
        if not 2.0 <= self.power <= 40.0:
            raise InputError(f"wall: power = {self.power:g}; want 2 (an ellipse) to 40 (nearly a rectangle)")

    def curve(self, s: Array) -> Curve:
        """From q = |cos s / a|^p + |sin s / b|^p and the distance from the centre, q^(-1/p)."""
        (a, b), p = self.half_axes_m, self.power
        c, n = np.cos(s), np.sin(s)
        u, v = np.abs(c / a), np.abs(n / b)
        q = u**p + v**p
        dq = p * (np.sign(n) * v ** (p - 1) * c / b - np.sign(c) * u ** (p - 1) * n / a)
        ddq = p * (p - 1) * (u ** (p - 2) * (n / a) ** 2 + v ** (p - 2) * (c / b) ** 2) - p * q
        far = q ** (-1 / p)
        dfar = -far * dq / (p * q)
        ddfar = -(dfar * dq + far * ddq) / (p * q) + far * dq**2 / (p * q**2)
        return _polar(c, n, (far, 0.0), (dfar, far), (ddfar - far, 2 * dfar))


class Support(Wall, frozen=True, tag="support"):
    """Distance h(s) from the origin to the tangent whose outward normal is at angle s."""

    radius_m: float
    harmonics_m: tuple[tuple[int, float, float], ...] = ()  # order k, a, b: h has a cos(k s) + b sin(k s)

    def _check(self) -> None:
        _above_zero("radius_m", self.radius_m)
        if any(k < 1 or not np.isfinite((a, b)).all() for k, a, b in self.harmonics_m):
            raise InputError("wall: harmonics_m has a wrong term; want [order of 1 or more, a, b], finite")
        s = np.linspace(0.0, 2 * np.pi, 2000)
        h, _, ddh, _ = self._support(s)
        if (h + ddh).min() <= 1e-6 * self.radius_m:
            at = np.rad2deg(s[np.argmin(h + ddh)])
            raise InputError(
                f"wall: harmonics_m bend it the wrong way near s = {at:.0f} deg; "
                "want radius_m larger, or harmonics smaller"
            )

    def _support(self, s: Array) -> tuple[Array, Array, Array, Array]:
        """h and its first three derivatives."""
        out = [np.full(np.shape(s), float(self.radius_m)), *(np.zeros(np.shape(s)) for _ in range(3))]
        for k, a, b in self.harmonics_m:
            c, n = np.cos(k * s), np.sin(k * s)
            even, odd = a * c + b * n, k * (b * c - a * n)
            for total, term in zip(out, (even, odd, -k * k * even, -k * k * odd), strict=True):
                total += term
        return out[0], out[1], out[2], out[3]

    def curve(self, s: Array) -> Curve:
        """r = h n + h' t, so that r' = (h + h'') t."""
        h, dh, ddh, dddh = self._support(s)
        return _polar(np.cos(s), np.sin(s), (h, dh), (0.0 * h, h + ddh), (-(h + ddh), dh + dddh))


def _above_zero(name: str, *values: float) -> None:
    for value in values:
        if not 0.0 < value < np.inf:
            raise InputError(f"wall: {name} has {value:g}; want lengths above 0")


def _polar(c: Array, n: Array, *parts: tuple[Array | float, Array | float]) -> Curve:
    """Curve from components along the direction (c, n) and across it."""
    out = [np.stack([f * c - g * n, f * n + g * c], axis=-1) for f, g in parts]
    return Curve(out[0], out[1], out[2])


def ellipse(a: float, b: float, centre: Point = (0.0, 0.0), turn: float = 0.0) -> Ellipse:
    """Ellipse of half axes a, b [m], its first axis turned by turn [rad]."""
    return Ellipse(half_axes_m=(a, b), centre_m=centre, turn_deg=float(np.rad2deg(turn)))


def circle(radius: float, centre: Point = (0.0, 0.0)) -> Circle:
    """Circle of that radius [m]."""
    return Circle(radius_m=radius, centre_m=centre)


def superellipse(
    a: float, b: float, power: float, centre: Point = (0.0, 0.0), turn: float = 0.0
) -> Superellipse:
    """Superellipse of half axes a, b [m]; power 2 is an ellipse, 8 nearly a rectangle."""
    return Superellipse(half_axes_m=(a, b), power=power, centre_m=centre, turn_deg=float(np.rad2deg(turn)))


def support(
    radius: float,
    harmonics: tuple[tuple[int, float, float], ...],
    centre: Point = (0.0, 0.0),
    turn: float = 0.0,
) -> Support:
    """Wall whose support function is radius + sum of a cos(k s) + b sin(k s) [m] over (k, a, b)."""
    return Support(radius_m=radius, harmonics_m=harmonics, centre_m=centre, turn_deg=float(np.rad2deg(turn)))


def rounded_rectangle(
    length: float, width: float, radius: float = 0.0, centre: Point = (0.0, 0.0), turn: float = 0.0
) -> Polygon:
    """Rectangle with round corners [m]; s = 0 is where the lower side begins."""
    _above_zero("length_m, width_m", length, width)
    x, y = 0.5 * length, 0.5 * width
    corners = ((-x, -y), (x, -y), (x, y), (-x, y))
    return Polygon(
        corners_m=corners, corner_radius_m=radius, centre_m=centre, turn_deg=float(np.rad2deg(turn))
    )


def polygon(corners: tuple[Point, ...], radius: float = 0.0, unknown_sides: tuple[int, ...] = ()) -> Polygon:
    """Convex polygon (n, 2) [m] with round corners; side i, from corner i to the next, may be unknown."""
    return Polygon(corners_m=_points(corners), corner_radius_m=radius, unknown_sides=unknown_sides)


def through(points: tuple[Point, ...]) -> Spline:
    """Smooth wall through points (n, 2) [m] in order round the room."""
    return Spline(points_m=_points(points))


def _points(points: Any) -> tuple[Point, ...]:
    return tuple((float(x), float(y)) for x, y in points)
