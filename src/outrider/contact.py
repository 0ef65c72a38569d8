"""When and how nearly two rectangles on arcs touch: motion, geometry and search, as Numba kernels.

The target keeps its acceleration along its path (a braking one stops and stays), its path's curvature and its
slip; the rider keeps speed and yaw rate. All in frame W; times from now. Method and limits: docs/warnings.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from outrider.kernel import kernel

TICK = 1e-3  # shortest look ahead: contacts that last less may be missed [s]
STANDING = 0.5  # a slower rider's corridor lies along the body, not along the path [m/s]
LOOK = 4.0  # braking is followed until the target stands, for at most so many horizons
BRAKING_TRIALS = 16  # values of braking tried, down from stopping short, before the edge is bisected


class Body(NamedTuple):
    """A target, frame W; the fields are numbers or columns."""

    x: Any  # centre [m]
    y: Any  # [m]
    yaw: Any  # [rad]
    course: Any  # [rad]
    speed: Any  # along the course, signed [m/s]
    acceleration: Any  # [m/s2]
    curvature: Any  # of the path [1/m]
    stop: Any  # when the speed reaches zero, inf for never [s]
    half_length: Any  # [m]
    half_width: Any  # [m]


class Mover(NamedTuple):
    """The rider, frame W."""

    x: float  # origin of the body [m]
    y: float  # [m]
    yaw: float  # [rad]
    course: float  # [rad]
    speed: float  # [m/s]
    yaw_rate: float  # [rad/s]
    ahead: float  # rectangle's centre, ahead of the origin [m]
    half_length: float  # margin included [m]
    half_width: float  # margin included [m]


# ------------------------------------------------------------------ motion


@kernel
def travelled(b: Body, t: Any) -> Any:
    """Way along the path after t [m], signed as the speed."""
    moving = np.minimum(t, b.stop)
    return b.speed * moving + 0.5 * b.acceleration * moving * moving


@kernel
def along_arc(x: Any, y: Any, course: Any, way: Any, turn: Any) -> Any:
    """End (x, y) of an arc of length `way` [m] over which the course turns by `turn` [rad]."""
    chord = way * np.sinc(turn / (2.0 * np.pi))
    return x + chord * np.cos(course + 0.5 * turn), y + chord * np.sin(course + 0.5 * turn)


@kernel
def pose_at(b: Body, t: Any) -> Any:
    """Pose (x, y, yaw) of the body's centre after t [s]."""
    way = travelled(b, t)
    x, y = along_arc(b.x, b.y, b.course, way, b.curvature * way)
    return x, y, b.yaw + b.curvature * way


@kernel
def gap_at(b: Body, r: Mover, t: float) -> Any:
    """Gap between target and rider after t [m]; negative where they overlap."""
    x, y, yaw = pose_at(b, t)
    rx, ry = along_arc(r.x, r.y, r.course, r.speed * t, r.yaw_rate * t)
    ryaw = r.yaw + r.yaw_rate * t
    rx, ry = rx + r.ahead * np.cos(ryaw), ry + r.ahead * np.sin(ryaw)
    return gap(rx, ry, ryaw, r.half_length, r.half_width, x, y, yaw, b.half_length, b.half_width)


@kernel
def agility(b: Body, r: Mover, horizon: float) -> Any:
    """Bound on how fast the relative speed of any two points of the bodies grows [m/s2]."""
    top = abs(b.speed) + max(b.acceleration * np.copysign(horizon, b.speed), 0.0)
    radius, bend = np.hypot(b.half_length, b.half_width), abs(b.curvature)
    return abs(b.acceleration) * (1.0 + bend * radius) + bend * top * top + abs(r.yaw_rate) * r.speed


@kernel
def rush(b: Body, r: Mover, t: float) -> Any:
    """Bound on how fast the gap changes after t [m/s]."""
    v = b.speed + b.acceleration * t if t < b.stop else 0.0
    course, rcourse = b.course + b.curvature * travelled(b, t), r.course + r.yaw_rate * t
    vx = v * np.cos(course) - r.speed * np.cos(rcourse)
    vy = v * np.sin(course) - r.speed * np.sin(rcourse)
    spin = abs(b.curvature * v) * np.hypot(b.half_length, b.half_width)
    spin += abs(r.yaw_rate) * (abs(r.ahead) + np.hypot(r.half_length, r.half_width))
    return np.hypot(vx, vy) + spin


@kernel
def safe_time(u: float, way: float, most: float) -> Any:
    """Time in which what changes at u [m/s], and u by at most `most` [m/s2], changes by `way` > 0 [s]."""
    return 2.0 * way / (u + np.sqrt(u * u + 2.0 * most * way))


# ------------------------------------------------------------------ geometry


@kernel
def _outside(x: float, y: float, half_length: float, half_width: float) -> Any:
    """Squared distance of a point from a rectangle about the origin [m2]."""
    dx, dy = max(abs(x) - half_length, 0.0), max(abs(y) - half_width, 0.0)
    return dx * dx + dy * dy


@kernel
def gap(
    ax: float, ay: float, ayaw: float, al: float, aw: float,
    bx: float, by: float, byaw: float, bl: float, bw: float,
) -> Any:  # fmt: skip
    """Distance between two rectangles (centre, yaw, half length, half width) [m].

    Where they overlap: minus the least penetration along one of their four axes.
    """
    ca, sa, cb, sb = np.cos(ayaw), np.sin(ayaw), np.cos(byaw), np.sin(byaw)
    dx, dy = bx - ax, by - ay
    ux, uy = ca * dx + sa * dy, ca * dy - sa * dx  # from a to b, in a
    vx, vy = cb * dx + sb * dy, cb * dy - sb * dx  # the same, in b
    c, s = ca * cb + sa * sb, ca * sb - sa * cb  # b's axes in a
    kc, ks = abs(c), abs(s)
    apart = max(
        max(abs(ux) - al - bl * kc - bw * ks, abs(uy) - aw - bl * ks - bw * kc),
        max(abs(vx) - bl - al * kc - aw * ks, abs(vy) - bw - al * ks - aw * kc),
    )
    if apart <= 0.0:
        return apart
    least = np.inf
    for i in (-1.0, 1.0):
        for j in (-1.0, 1.0):
            px, py, qx, qy = i * bl, j * bw, i * al, j * aw
            least = min(least, _outside(ux + c * px - s * py, uy + s * px + c * py, al, aw))
            least = min(least, _outside(c * qx + s * qy - vx, c * qy - s * qx - vy, bl, bw))
    return np.sqrt(least)


# ------------------------------------------------------------------ contact


@kernel
def first_contact(b: Body, r: Mover, horizon: float, tick: float) -> Any:
    """Time of the first touch [s], inf for none: steps no longer than the gap allows, then bisection."""
    t, way, most = 0.0, gap_at(b, r, 0.0), agility(b, r, horizon)
    if way <= 0.0:
        return 0.0
    while t < horizon:
        before = t
        t = min(t + max(safe_time(rush(b, r, t), way, most), tick), horizon)
        way = gap_at(b, r, t)
        if way <= 0.0:
            for _ in range(24):
                middle = 0.5 * (before + t)
                if gap_at(b, r, middle) <= 0.0:
                    t = middle
                else:
                    before = middle
            return t
    return np.inf


@kernel
def closest(b: Body, r: Mover, horizon: float, step: float) -> Any:
    """Least gap [m] and when [s], of bodies that do not touch: samples, then golden section at the best."""
    most = agility(b, r, horizon)
    t, best, when = 0.0, gap_at(b, r, 0.0), 0.0
    way = best
    while t < horizon:
        idle = safe_time(rush(b, r, t), way - best, most) if way > best else 0.0
        t = min(t + max(step, idle), horizon)
        way = gap_at(b, r, t)
        if way < best:
            best, when = way, t
    low, width = max(when - step, 0.0), min(when + step, horizon)
    width -= low
    one, two = gap_at(b, r, low + 0.381966 * width), gap_at(b, r, low + 0.618034 * width)
    for _ in range(16):
        width *= 0.618034
        if one <= two:
            two, one = one, gap_at(b, r, low + 0.381966 * width)
        else:
            low += 0.618034 * width  # 0.381966 of the former width
            one, two = two, gap_at(b, r, low + 0.618034 * width)
    way, t = min(one, two), low + 0.5 * width
    return (way, t) if way < best - 1e-9 else (best, when)


@kernel
def _touches(b: Body, r: Mover, rate: float, horizon: float) -> Any:
    """Whether the target still touches when it brakes at `rate` [m/s2] until it stands."""
    v = b.speed
    stop = abs(v) / rate if rate > 0.0 else np.inf
    half_turn = np.pi / abs(r.yaw_rate) if r.yaw_rate != 0.0 else np.inf
    look = max(horizon, min(stop, LOOK * horizon, half_turn))
    if rate == np.inf:
        v, rate = 0.0, 0.0
    braked = Body(
        b.x, b.y, b.yaw, b.course, v, -np.copysign(rate, v), b.curvature, stop, b.half_length, b.half_width
    )
    return first_contact(braked, r, look, TICK) < np.inf


@kernel
def required_deceleration(b: Body, r: Mover, ttc: float, horizon: float) -> Any:
    """Least constant braking above which none touches, to 0.5 % [m/s2]; inf where braking cannot help.

    Less may avoid a touch too, by passing first; but then somewhat more would not, so it is no advice.
    """
    if ttc == np.inf:
        return 0.0
    if ttc == 0.0 or b.speed == 0.0:
        return np.inf
    if not _touches(b, r, 0.0, horizon):
        return 0.0
    if _touches(b, r, np.inf, horizon):  # stands at once, and the rider rides into it
        return np.inf
    low, high = 0.0, 0.5 * b.speed**2 / abs(travelled(b, ttc)) * (1.0 + 1e-6)  # stands where it would touch
    while _touches(b, r, high, horizon):
        low, high = high, 2.0 * high
    for k in range(BRAKING_TRIALS - 1, 0, -1):  # the highest that still touches
        if _touches(b, r, high * k / BRAKING_TRIALS, horizon):
            low, high = max(low, high * k / BRAKING_TRIALS), high * (k + 1) / BRAKING_TRIALS
            break
    else:
        high = high / BRAKING_TRIALS
    middle = max(0.995 * high, low)
    while high - low > 0.005 * high:
        if _touches(b, r, middle, horizon):
            low = middle
        else:
            high = middle
        middle = 0.5 * (low + high)
    return high


# ------------------------------------------------------------------ corridor


@kernel
def enters_corridor(b: Body, r: Mover, half: float, horizon: float, step: float) -> Any:
    """Whether the target comes within `half` [m] of the rider's path, ahead or behind, within the horizon."""
    x0, y0 = r.x + r.ahead * np.cos(r.yaw), r.y + r.ahead * np.sin(r.yaw)
    moving = r.speed > STANDING
    bend = min(max(r.yaw_rate / r.speed, -0.5 / r.half_length), 0.5 / r.half_length) if moving else 0.0
    course = r.course if moving else r.yaw
    top = abs(b.speed) + max(b.acceleration * np.copysign(horizon, b.speed), 0.0)
    radius = np.hypot(b.half_length, b.half_width)
    reach, fastest = horizon * max(r.speed, top) + r.half_length, top * (1.0 + abs(b.curvature) * radius)
    t = 0.0
    while True:
        x, y, yaw = pose_at(b, t)
        if abs(bend) < 1e-6:
            off, past = gap(x0, y0, course, reach, half, x, y, yaw, b.half_length, b.half_width), 0.0
        else:
            cx, cy = r.x - np.sin(course) / bend, r.y + np.cos(course) / bend
            off, past = _off_arc(cx, cy, x0, y0, half, x, y, yaw, b.half_length, b.half_width)
            past -= reach + radius
        if off <= 0.0 and past <= 0.0:
            return True
        if t >= horizon:
            return False
        t = min(t + (max(off / fastest, 0.1 * step) if off > 0.0 else step), horizon)


@kernel
def _off_arc(
    cx: float, cy: float, x0: float, y0: float, half: float,
    x: float, y: float, yaw: float, length: float, width: float,
) -> Any:  # fmt: skip
    """Gap of a rectangle to a ring about (cx, cy) through (x0, y0), and way along the ring to it [m]."""
    ring = np.hypot(x0 - cx, y0 - cy)
    c, s = np.cos(yaw), np.sin(yaw)
    dx, dy = c * (cx - x) + s * (cy - y), c * (cy - y) - s * (cx - x)  # ring's centre, in the rectangle
    near = np.sqrt(_outside(dx, dy, length, width))
    far = np.hypot(abs(dx) + length, abs(dy) + width)
    cross, dot = (x0 - cx) * (y - cy) - (y0 - cy) * (x - cx), (x0 - cx) * (x - cx) + (y0 - cy) * (y - cy)
    return max(near - ring - half, ring - half - far), abs(np.arctan2(cross, dot)) * ring
