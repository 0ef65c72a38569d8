"""The geometry of two rays that end on a wall: [UNI] eq. 11 to 26, for any motion of the sensors' point.

    x + rho_i e1i = r(s_i)        e1i = R(theta + phi_i) e1        e2i = M e1i        M = R(pi/2)

The configuration p = (s1, s2, theta) says where both rays end on the wall and how the robot stands; x is its
sensors' point, rho_i the ranges, phi_i the signed angles of the sensors from straight ahead. With the twist
(vx, vy, w) of that point in the robot's axes, V = R(theta) (vx, vy); the paper's unicycle has vy = 0.

[UNI] S. Cedervall, X. Hu, Nonlinear Observers for Unicycle Robots with Range Sensors.
All arrays may have any leading axes, which broadcast. The axis of the sensors has length 2.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from outrider.relocalise.wall import Wall

Array = npt.NDArray[np.float64]


class Twist(NamedTuple):
    """Motion of the sensors' point in the robot's axes; each () or (...)."""

    vx: Any  # forward [m/s]
    vy: Any  # to the left [m/s]
    w: Any  # yaw rate [rad/s]


class Scene(NamedTuple):
    """Wall, rays and motion at a configuration, as the equations use them."""

    r: Array  # (..., 2, 2) where each ray ends on the wall [m]
    dr: Array  # (..., 2, 2) r' there [m]
    ddr: Array  # (..., 2, 2) r'' there [m]
    e1: Array  # (..., 2, 2) unit vector along each ray
    e2: Array  # (..., 2, 2) unit vector across it, to its left
    ranges: Array  # (..., 2) rho [m]
    velocity: Array  # (..., 1, 2) V [m/s]
    w: Array  # (..., 1) [rad/s]
    den: Array  # (..., 2) r'_i . e2i [m]; positive wherever a ray leaves a convex room


def scene(wall: Wall, p: Array, angles: Array, ranges: Array, twist: Twist) -> Scene:
    """Scene at p (..., 3) for sensors at angles (2,) [rad], ranges (..., 2) [m]."""
    r, dr, ddr = wall.at(p[..., :2])
    bearing = p[..., 2:] + angles
    e1 = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    e2 = turned(e1)
    vx, vy, w = (np.asarray(part, float) for part in twist)
    c, s = np.cos(p[..., 2]), np.sin(p[..., 2])
    velocity = np.stack([c * vx - s * vy, s * vx + c * vy], axis=-1)[..., None, :]
    return Scene(r, dr, ddr, e1, e2, np.asarray(ranges, float), velocity, w[..., None], dot(dr, e2))


def flow(at: Scene, grazing: float = 0.0) -> Array:
    """Eq. 13: how fast the ends of the rays move along the wall, s' (..., 2) [1/s].

    grazing: den is taken as at least this share of |r'|, for configurations that no robot can have.
    """
    den = np.maximum(at.den, grazing * np.linalg.norm(at.dr, axis=-1)) if grazing else at.den
    return (dot(at.velocity, at.e2) + at.ranges * at.w) / den


def rates(at: Scene, grazing: float = 0.0) -> Array:
    """Eq. 14: how fast the ranges change, rho' (..., 2) [m/s]. Never put this into F: see `mismatch`."""
    den = np.maximum(at.den, grazing * np.linalg.norm(at.dr, axis=-1)) if grazing else at.den
    return (at.ranges * at.w * dot(at.dr, at.e1) - dot(at.dr, turned(at.velocity))) / den


def positions(at: Scene) -> Array:
    """Eq. 15, 16: z1 and z2 (..., 2, 2), where each ray puts the sensors' point [m]."""
    return at.r - at.ranges[..., None] * at.e1


def gap(at: Scene) -> Array:
    """Eq. 17: z = z1 - z2 (..., 2) [m]; zero where both rays agree."""
    z = positions(at)
    return z[..., 0, :] - z[..., 1, :]


def gap_slope(at: Scene) -> Array:
    """dz/dp (..., 2, 3) = [r'_1, -r'_2, M (r_2 - r_1) + M z], ranges held fixed."""
    swing = turned(at.r[..., 1, :] - at.r[..., 0, :] + gap(at))
    return np.stack([at.dr[..., 0, :], -at.dr[..., 1, :], swing], axis=-1)


def pull(at: Scene, measured: Array) -> Array:
    """Eq. 22: u_i = M V + rho'_i e2i - rho_i w e1i (..., 2, 2) [m/s], from measured rates (..., 2) [m/s]."""
    return turned(at.velocity) + measured[..., None] * at.e2 - (at.ranges * at.w)[..., None] * at.e1


def mismatch(at: Scene, measured: Array) -> Array:
    """Eq. 21: F_i = r'_i . u_i (..., 2) [m2/s] = den_i (measured rho'_i minus that of eq. 14).

    The second form, which the paper does not have, says why the rates must be measured: with eq. 14 in their
    place F is zero for every p, right or wrong.
    """
    return dot(at.dr, pull(at, measured))


def mismatch_slope(at: Scene, measured: Array) -> Array:
    """Eq. 23: dF/dp (..., 2, 3), ranges and measured rates (..., 2) held fixed."""
    u = pull(at, measured)
    bend, turn = dot(at.ddr, u), dot(at.dr, turned(u))
    zero = np.zeros_like(bend[..., 0])
    return np.stack(
        [
            np.stack([bend[..., 0], zero, turn[..., 0]], axis=-1),
            np.stack([zero, bend[..., 1], turn[..., 1]], axis=-1),
        ],
        axis=-2,
    )


def gap_kernel(at: Scene) -> Array:
    """Eq. 19: nu_z (..., 3), the direction in p that two ranges do not see."""
    d = at.r[..., 1, :] - at.r[..., 0, :] + gap(at)
    first, second = at.dr[..., 0, :], at.dr[..., 1, :]
    return np.stack([-dot(second, d), -dot(first, d), dot(first, turned(second))], axis=-1)


def mismatch_kernel(at: Scene, measured: Array) -> Array:
    """Eq. 24: nu_F (..., 3), the direction in p that two measured rates (..., 2) do not see."""
    u = pull(at, measured)
    bend, turn = dot(at.ddr, u), dot(at.dr, turned(u))
    return np.stack(
        [-bend[..., 1] * turn[..., 0], -bend[..., 0] * turn[..., 1], bend[..., 0] * bend[..., 1]], axis=-1
    )


def sweep(at: Scene) -> Array:
    """c_i of eq. 25 and 26 (..., 2) [1/s]: for a unicycle (v sin phi_i - w rho_i) / den_i; it is -s'_i."""
    return -flow(at)


def transversality(at: Scene) -> Array:
    """D_i of eq. 26 (..., 2) [m4]: at the true p, (dF/dp) nu_z = (c_1 D_1, c_2 D_2)."""
    d = at.r[..., 1, :] - at.r[..., 0, :]
    first, second = at.dr[..., 0, :], at.dr[..., 1, :]
    across = dot(first, turned(second))[..., None]
    other = np.stack([dot(second, d), dot(first, d)], axis=-1)
    return dot(at.ddr, turned(at.dr)) * other + dot(at.dr, at.dr) * across


def longest_chord(reach: float, angles: Array) -> float:
    """Longest distance [m] of two points that sensors of this reach [m] can hit at once; for H1 and H3.

    The paper has 2 reach sin((phi_1 + phi_2) / 2): that is 0 for sensors at +-phi. The angle between both
    rays is |phi_1 - phi_2|, and where it is below 60 deg, one long and one short ray reach farther apart.
    """
    return float(reach * max(1.0, 2.0 * abs(np.sin(0.5 * (angles[0] - angles[1])))))


def dot(a: Array, b: Array) -> Array:
    """Inner product over the last axis, of length 2."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1])


def turned(a: Array) -> Array:
    """M a: turned to the left by a quarter, over the last axis."""
    return np.stack([-a[..., 1], a[..., 0]], axis=-1)
