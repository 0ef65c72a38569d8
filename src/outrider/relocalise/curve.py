"""A closed convex wall: where its points are, how long it is, what a ray from inside hits.

r(s) is counter-clockwise over s in [0, 2 pi), fixed frame W, lengths in metres. A ray from x along the unit
vector e hits where cross(e, r(s) - x) rises through zero. Between the two points whose tangent is parallel to
the ray that function is monotone, so a table brackets the hit and Halley's method ends at machine precision.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from outrider.errors import InputError
from outrider.geometry import rotate, wrap

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Node = npt.NDArray[np.intp]
Point = tuple[float, float]

NODES = 256  # of the table, besides the ends of the smooth pieces
BRANCH = 5  # nodes looked at in one round of the search for the bracket
CLOSE = 2e-5  # radians of s: a last step as short as this leaves an error below 1e-13 m
ALIKE = 1e-3  # of the mean radius: a wall closer than this to its turned self cannot be told from it
LAPS = np.array([[0.0], [2 * np.pi]])
HALF_GAUSS, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(8)


class Curve(NamedTuple):
    """Points of a wall and their derivatives by s."""

    r: Array  # (..., 2) [m]
    dr: Array  # (..., 2) [m/rad]
    ddr: Array  # (..., 2) [m/rad2]


class Hit(NamedTuple):
    """Where rays meet the wall; NaN for a ray that starts outside."""

    s: Array  # (...,) in [0, 2 pi)
    range: Array  # (...,) [m]


class _Table(NamedTuple):
    """Nodes of the curve, twice around, so that a search never wraps."""

    s: Array  # (2 k,) over [0, 4 pi)
    r: npt.NDArray[np.complex128]  # (2 k,) x + i y [m]
    tangent: Array  # (2 k,) angle of dr, unwrapped: it never falls [rad]
    polar: Array  # (2 k,) angle of r - centre, unwrapped [rad]
    length: Array  # (k + 1,) arc length to the node [m]


def cross(a: Array, b: Array) -> Array:
    """Component along z of a x b, over the last axis."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


class Wall(
    msgspec.Struct, frozen=True, dict=True, forbid_unknown_fields=True, kw_only=True, tag_field="shape"
):
    """What every wall can do; a shape gives `curve`, and `breaks` where it is not smooth."""

    centre_m: Point = (0.0, 0.0)  # where the shape's own origin is in W
    turn_deg: float = 0.0  # how far the shape is turned about it

    def __post_init__(self) -> None:
        if not np.isfinite((*self.centre_m, self.turn_deg)).all():
            raise InputError("wall: centre_m or turn_deg is no finite number; want metres, degrees")
        self._check()

    def _check(self) -> None:
        """InputError for fields that make no closed convex curve."""

    def curve(self, s: Array) -> Curve:
        """The shape about its own origin at s (...,); counter-clockwise, convex."""
        raise NotImplementedError

    def breaks(self) -> Array:
        """(m,) rising s in [0, 2 pi) at which smooth pieces meet."""
        return np.empty(0)

    def unknown(self) -> Array:
        """(m, 2) from and to in s of the parts that only close the curve."""
        return np.empty((0, 2))

    @property
    def name(self) -> str:
        """Name of the shape, as in a file."""
        return str(self.__struct_config__.tag)

    def at(self, s: Array | float) -> Curve:
        """Points of the wall at s (...,) and their derivatives, in W."""
        local = self.curve(np.asarray(s, dtype=float))
        if self.turn_deg == 0.0 and self.centre_m == (0.0, 0.0):
            return local
        turn = self._turn.T
        return Curve(local.r @ turn + self._centre, local.dr @ turn, local.ddr @ turn)

    @cached_property
    def _centre(self) -> Array:
        return np.array(self.centre_m, dtype=float)

    @cached_property
    def _turn(self) -> Array:
        c, s = np.cos(np.deg2rad(self.turn_deg)), np.sin(np.deg2rad(self.turn_deg))
        return np.array([[c, -s], [s, c]])

    @cached_property
    def _table(self) -> _Table:
        even = 2 * np.pi * np.arange(NODES) / NODES
        breaks = self.breaks()
        even = even[np.all(np.abs(even[:, None] - breaks) > 1e-9, axis=1)]
        s = np.sort(np.concatenate([even, breaks]))
        r, dr, _ = self.at(s)
        tangent = np.unwrap(np.arctan2(dr[:, 1], dr[:, 0]))
        polar = np.unwrap(np.arctan2(r[:, 1] - self.centroid[1], r[:, 0] - self.centroid[0]))
        ends = np.append(s, s[0] + 2 * np.pi)
        length = np.concatenate([[0.0], np.cumsum(self._length(ends[:-1], ends[1:]))])
        rising = np.maximum.accumulate(tangent)
        twice, z = [np.ravel(angle + LAPS) for angle in (s, rising, polar)], np.tile(r @ (1.0, 1j), 2)
        return _Table(twice[0], z, twice[1], twice[2], length)

    def _length(self, start: Array, end: Array) -> Array:
        """Arc length between parameters that no break lies between, by Gauss-Legendre quadrature [m]."""
        half = 0.5 * (end - start)
        s = 0.5 * (start + end)[..., None] + half[..., None] * HALF_GAUSS
        return np.asarray(half * (np.hypot(*np.moveaxis(self.at(s).dr, -1, 0)) @ GAUSS_WEIGHTS))

    @cached_property
    def centroid(self) -> Array:
        """(2,) centre of the area inside [m], about which a symmetric wall is symmetric."""
        ends = np.unique(np.concatenate([2 * np.pi * np.arange(NODES + 1) / NODES, self.breaks()]))
        half = 0.5 * np.diff(ends)[:, None]
        r, dr, _ = self.at(0.5 * (ends[1:] + ends[:-1])[:, None] + half * HALF_GAUSS)
        area = cross(r, dr) * half * GAUSS_WEIGHTS  # twice that of each slice
        return np.asarray((r * area[..., None]).sum(axis=(0, 1)) / (1.5 * area.sum()))

    @property
    def perimeter(self) -> float:
        """Length of the whole wall [m]."""
        return float(self._table.length[-1])

    @cached_property
    def diameter(self) -> float:
        """Largest distance between two of its points [m], to 1e-4 of itself."""
        half = len(self._table.s) // 2
        r = self._table.r[:half]
        return float(np.abs(r[:, None] - r).max())

    def arc_length(self, s: Array | float) -> Array:
        """Length of wall from parameter 0 to s (...,), which may run on beyond 2 pi [m]."""
        s = np.asarray(s, dtype=float)
        turns, s = np.divmod(s, 2 * np.pi)
        table = self._table
        k = np.searchsorted(table.s[: len(table.length) - 1], s, side="right") - 1
        return np.asarray(turns * self.perimeter + table.length[k] + self._length(table.s[k], s))

    def known(self, s: Array | float) -> Bools:
        """Whether there is a wall at s (...,), and not only what closes the curve; False for NaN."""
        s = np.asarray(s, dtype=float)
        at = np.mod(np.where(np.isfinite(s), s, 0.0), 2 * np.pi)[..., None]
        start, end = self.unknown().T
        return np.asarray(np.isfinite(s) & ~np.any((at >= start) & (at < end), axis=-1))

    def inside(self, x: Array, margin: float = 0.0) -> Bools:
        """Whether points x (..., 2) are strictly inside, further than margin [m] from the wall."""
        x = np.asarray(x, dtype=float)
        return np.asarray(self._contains(x) if margin == 0.0 else self.distance(x) > margin)

    def _contains(self, x: Array) -> Bools:
        """Inside the chords of the table, or, between a chord and the wall, nearer than the wall is."""
        table, out = self._table, x - self.centroid
        k = self._sector(out)
        start = table.r[k]
        to_x = x[..., 0] + 1j * x[..., 1] - start
        within = np.asarray((np.conj(table.r[k + 1] - start) * to_x).imag > 0.0)
        near = ~within & np.isfinite(to_x)
        if near.any():
            far = np.hypot(out[near][:, 0], out[near][:, 1])
            hit = self._solve(self.centroid + 0 * out[near], out[near] / far[:, None], k[near], k[near] + 1)
            within[near] = far < hit.range
        return within

    def _sector(self, out: Array) -> Node:
        """Node before the direction of vectors out (..., 2) from the centroid."""
        polar = self._table.polar
        finite = np.where(np.isfinite(out), out, 1.0)
        angle = np.mod(np.arctan2(finite[..., 1], finite[..., 0]) - polar[0], 2 * np.pi) + polar[0]
        return np.asarray(np.searchsorted(polar, angle, side="right") - 1)

    def distance(self, x: Array) -> Array:
        """Distance of points x (..., 2) to the wall, negative outside [m]."""
        x = np.asarray(x, dtype=float)
        table = self._table
        half = len(table.s) // 2
        away = np.abs(x[..., :1] + 1j * x[..., 1:] - table.r[:half])
        k = np.argmin(away, axis=-1)
        k = np.where(k == 0, half, k)
        low, high, s = table.s[k - 1], table.s[k + 1], table.s[k]
        for _ in range(12):
            r, dr, ddr = self.at(s)
            slope = np.sum((r - x) * dr, axis=-1)
            bend = np.maximum(np.sum((r - x) * ddr + dr * dr, axis=-1), 0.1 * np.sum(dr * dr, axis=-1))
            low, high = np.where(slope < 0.0, s, low), np.where(slope < 0.0, high, s)
            new = s - slope / bend
            s = np.where((new >= low) & (new <= high), new, 0.5 * (low + high))
        nearest = np.minimum(away.min(axis=-1), np.hypot(*np.moveaxis(self.at(s).r - x, -1, 0)))
        return np.asarray(np.where(self._contains(x), nearest, -nearest))

    def ray(self, x: Array, bearing: Array | float) -> Hit:
        """What rays from x (..., 2) [m] at bearing (...,) [rad] hit; NaN unless x is inside."""
        x, bearing = np.asarray(x, dtype=float), np.asarray(bearing, dtype=float)
        usable = self._contains(x) & np.isfinite(bearing)
        bearing = np.where(usable, bearing, 0.0)
        x = np.where(usable[..., None], x, self.centroid)
        e = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
        hit = self._cast(x, e, bearing)
        if usable.all():
            return hit
        return Hit(np.where(usable, hit.s, np.nan), np.where(usable, hit.range, np.nan))

    def _cast(self, x: Array, e: Array, bearing: Array) -> Hit:
        """Hits of rays that start inside; a shape with a closed form replaces this."""
        return self._solve(x, e, *self._bracket(x, e, bearing))

    def _bracket(self, x: Array, e: Array, bearing: Array) -> tuple[Node, Node]:
        """Neighbouring nodes between which cross(e, r - x) rises through zero."""
        table = self._table
        along = table.tangent[0] + np.mod(bearing - table.tangent[0], 2 * np.pi)
        low = np.searchsorted(table.tangent, along, side="right") - 1
        last = np.searchsorted(table.tangent, along + np.pi, side="left")
        back = (e[..., 0] - 1j * e[..., 1])[..., None]
        offset = cross(e, x)[..., None]
        high, part = last, np.arange(1, BRANCH + 1)
        while np.any(high - low > 1):
            width = (high - low)[..., None]
            k = low[..., None] + (width * part + BRANCH) // (BRANCH + 1)
            before = ((back * table.r.take(k)).imag < offset) & (k < last[..., None])
            count = before.sum(axis=-1)
            width = width[..., 0]
            start = np.where(count > 0, (width * count + BRANCH) // (BRANCH + 1), 0)
            high = low + (width * (count + 1) + BRANCH) // (BRANCH + 1)
            low = low + start
        return low, low + 1

    def _solve(self, x: Array, e: Array, low: Node, high: Node) -> Hit:
        """Halley's method inside a bracket of nodes, halved where a step would leave it."""
        table = self._table
        back, start = e[..., 0] - 1j * e[..., 1], x[..., 0] + 1j * x[..., 1]
        below, above = (back * (table.r[low] - start)).imag, (back * (table.r[high] - start)).imag
        a, b = table.s[low], table.s[high]
        rise = np.maximum(above - below, np.finfo(float).tiny)
        between = a - (b - a) * np.minimum(below, 0.0) / rise
        s = np.where(below >= 0.0, b, np.where(above < 0.0, a, between))
        for _ in range(60):
            r, dr, ddr = self.at(s)
            off, slope, bend = cross(e, r - x), cross(e, dr), cross(e, ddr)
            a, b = np.where(off < 0.0, s, a), np.where(off < 0.0, b, s)
            under = 2.0 * slope * slope - off * bend
            step = -2.0 * off * slope / np.where(under == 0.0, 1.0, under)
            if np.abs(step).max(initial=0.0) < CLOSE:
                break
            new = s + step
            s = np.where((new >= a) & (new <= b) & (slope > 0.0), new, 0.5 * (a + b))
        along, on, over = ((v * e).sum(axis=-1) for v in (r - x, dr, ddr))
        return Hit(np.mod(s + step, 2 * np.pi), along + step * (on + 0.5 * step * over))

    @cached_property
    def symmetry(self) -> int:
        """Order of rotation about its centroid that changes nothing: 1 none, 2 for an ellipse, 0 a circle."""
        table = self._table
        ends = table.s[: len(table.length)]
        s = np.interp(self.perimeter * np.arange(2 * NODES) / (2 * NODES), table.length, ends)
        r = self.at(s).r - self.centroid
        z = np.fft.fft(r[:, 0] + 1j * r[:, 1]) / len(r)
        gap = np.fft.fft((~self.known(s)).astype(float)) / len(r)
        m = np.round(np.fft.fftfreq(len(r), 1 / len(r)))
        alike = ALIKE * np.abs(z[1])
        if np.hypot(np.linalg.norm(z[m != 1]), abs(gap[0]) * len(r)) < alike:
            return 0
        for k_fold in range(36, 1, -1):
            turned = np.linalg.norm(z * (np.exp(2j * np.pi * (m - 1) / k_fold) - 1))
            gaps = np.linalg.norm(gap * (np.exp(2j * np.pi * m / k_fold) - 1))
            if turned < alike and gaps < 0.1:
                return k_fold
        return 1

    def turned(self, pose: Array, k: int) -> Array:
        """The k-th pose (..., 3) that no range can tell from pose; k of 0 is the pose itself."""
        if self.symmetry == 0:
            raise InputError("a circle has no k-th pose, but a ring of them; want a wall that is no circle")
        pose = np.asarray(pose, dtype=float)
        angle = 2 * np.pi * k / self.symmetry
        x = rotate(pose[..., :2] - self.centroid, angle) + self.centroid
        return np.concatenate([x, np.asarray(wrap(pose[..., 2:] + angle))], axis=-1)
