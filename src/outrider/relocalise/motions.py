"""How a robot may drive to be found: each motion is a function of time and pose, and all keep off the wall.

    motion(t, pose, room, limits) -> (..., 2) speed v [m/s] and yaw rate w [rad/s] of the robot

at time t [s] and pose (..., 3) of the robot, x, y [m], theta [rad], in the wall's frame. What is driven is
`command`: the motion where the wall is far enough, else turning on the spot.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from outrider import extension
from outrider.errors import InputError
from outrider.relocalise import Array, Bools, mount, observability
from outrider.relocalise.room import Room

LOOKS = 3  # places looked at on the way ahead; between two that are inside, a convex room has no wall
HOLD = 1.0  # a random command is kept so long [s]
CORNERS = np.array([[1.0, 1.0], [1.0, -1.0]])  # of the bounds; the other two see no more, and undo these
CHOICES = np.array([[v, w] for v in (1.0, 0.5, 0.0) for w in (1.0, -1.0, 0.0) if v or w])


class Limits(NamedTuple):
    """What the robot can do, and how it keeps off the wall."""

    v: float = 0.5  # fastest, forward or back [m/s]
    w: float = 0.5  # fastest turn, either way [rad/s]
    margin: float = 0.2  # least distance of the robot's point to the wall [m]
    ahead: float = 1.5  # so long a command must be safe for [s]


Motion = Callable[[float, Array, Room, Limits], Array]


def command(motion: Motion, t: float, pose: Array, room: Room, limits: Limits) -> Array:
    """(..., 2) what is driven: the motion where it stays off the wall, else turning on the spot."""
    wished = np.broadcast_to(motion(t, pose, room, limits), (*pose.shape[:-1], 2))
    turn = np.where(wished[..., 1] == 0.0, limits.w, np.copysign(limits.w, wished[..., 1]))
    instead = np.stack([np.zeros_like(turn), turn], axis=-1)
    return np.where(safe(wished, pose, room, limits)[..., None], wished, instead)


def safe(wished: Array, pose: Array, room: Room, limits: Limits) -> Bools:
    """Whether commands (..., 2) from poses (..., 3) stay off the wall for as long as limits.ahead."""
    still = np.asarray(wished[..., 0] == 0.0)
    if still.all():
        return still
    times = np.linspace(limits.ahead / LOOKS, limits.ahead, LOOKS)
    places = [mount.advanced(pose, wished[..., 0], wished[..., 1], dt)[..., :2] for dt in times]
    return np.asarray(room.wall.inside(np.stack(places), limits.margin).all(axis=0) | still)


def constant(t: float, pose: Array, room: Room, limits: Limits) -> Array:
    """Full speed on a circle."""
    return np.array([limits.v, limits.w])


def spin(t: float, pose: Array, room: Room, limits: Limits) -> Array:
    """Turning on the spot: needs no room, and no distance is measured wrongly."""
    return np.array([0.0, limits.w])


def periodic(t: float, pose: Array, room: Room, limits: Limits) -> Array:
    """To and fro on a bow, v as cos, w as cos of twice the angle: the pose comes back, never at rest."""
    phase = limits.w * t
    return np.array([limits.v * np.cos(phase), limits.w * np.cos(2.0 * phase)])


def straight_and_turn(t: float, pose: Array, room: Room, limits: Limits) -> Array:
    """Straight on; before a wall it turns until the way is free, as it is kept off the wall."""
    return np.array([limits.v, 0.0])


def random(t: float, pose: Array, room: Room, limits: Limits, seed: int = 0) -> Array:
    """Any command within the limits, kept for a second; the same for the same time and seed."""
    rng = np.random.default_rng((seed, int(t / HOLD + 1e-9)))
    return np.array([limits.v, limits.w]) * rng.uniform(-1.0, 1.0, (*pose.shape[:-1], 2))


def criterion(t: float, pose: Array, room: Room, limits: Limits) -> Array:
    """The paper's: the largest norm of (v sin phi_i - w rho_i), i = 1, 2, under bounds on v and w.

    A norm is convex, so the best is a corner: always at full speed, and bang-bang. Backwards the norm is the
    same; of the two forward, the best that is safe.
    """

    def norm(v: Array, w: Array) -> Array:
        parts = v[..., None] * np.sin(room.angles) - w[..., None] * ranges
        return np.asarray(np.linalg.norm(parts, axis=-1))

    ranges = np.nan_to_num(seen(pose, room))
    return _best(CORNERS, norm, pose, room, limits)


def sigma(t: float, pose: Array, room: Room, limits: Limits) -> Array:
    """What makes the smallest singular value of the observability matrix largest, of some safe commands."""
    at = mount.sensors(pose, room.mount)

    def smallest(v: Array, w: Array) -> Array:
        each = np.broadcast_to(at, (*v.shape, 3))
        return observability.sigma_min(room, each, mount.twist(v, w, room.mount))

    return _best(CHOICES, smallest, pose, room, limits)


def seen(pose: Array, room: Room) -> Array:
    """(..., 2) the ranges that both sensors of a robot at pose (..., 3) should have [m]; NaN outside."""
    at = mount.sensors(pose, room.mount)
    return room.wall.ray(at[..., None, :2], at[..., 2:] + room.angles).range


def _best(choices: Array, worth: Any, pose: Array, room: Room, limits: Limits) -> Array:
    """(..., 2) the safe command of most worth(v, w); any where none is safe, as `command` turns then."""
    v, w = (choices * (limits.v, limits.w)).T.reshape((2, -1) + (1,) * (pose.ndim - 1))
    each = np.broadcast_to(pose, (len(choices), *pose.shape))
    v, w = (np.broadcast_to(part, each.shape[:-1]) for part in (v, w))
    commands = np.stack([v, w], axis=-1)
    points = np.where(safe(commands, each, room, limits), np.nan_to_num(worth(v, w)), -1.0)
    return np.asarray(np.take_along_axis(commands, points.argmax(axis=0)[None, ..., None], axis=0)[0])


MOTIONS: dict[str, Motion] = {
    "spin": spin,
    "constant": constant,
    "periodic": periodic,
    "criterion": criterion,
    "sigma": sigma,
    "straight_and_turn": straight_and_turn,
    "random": random,
}
ALIASES = {"exciting": "spin"}
DEFAULT = "spin"


def get(name: str, seed: int = 0) -> Motion:
    """Motion by name, of this seed where it is random; InputError, with the nearest names, where unknown.

    `exciting` is the one that is best for most walls: spin.
    """
    known = [*MOTIONS, *ALIASES]
    if name not in known:
        raise InputError(f"motion {name!r} is not known{extension.nearest(name, known)}")
    return partial(random, seed=seed) if name == "random" else MOTIONS[ALIASES.get(name, name)]
