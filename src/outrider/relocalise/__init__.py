"""Where a robot is inside a known closed wall, from two ranges: the contract of an observer.

One file of `observers/` is one observer, named as the file is. Fixed frame W; the robot's axes: x forward, y
left. What is estimated is the pose of the point both range sensors sit on, n at a time: n guesses of one
robot, or n robots. All arrays have n as their first axis, or broadcast against it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from outrider import extension

if TYPE_CHECKING:
    from outrider.relocalise.room import Room

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


class Sample(NamedTuple):
    """What is known at one instant; the twist is that of the interval which ends there."""

    dt: float  # since the last sample [s]
    vx: Array  # () or (n,) velocity of the sensors' point, forward [m/s]
    vy: Array  # () or (n,) to the left [m/s]; 0 for a unicycle whose sensors sit on its axle
    w: Array  # () or (n,) yaw rate [rad/s]
    ranges: Array  # (2,) or (n, 2) measured [m]; NaN: no return
    before: Array  # (2,) or (n, 2) at the last sample [m]; NaN: none
    rates: Array  # (2,) or (n, 2) measured rate of the ranges [m/s]; NaN where not known yet
    angles: Array  # (2,) of the sensors, from straight ahead [rad]


class Observer(Protocol):
    """The contract of a file in `observers/`: names at module level, functions pure."""

    reference: str  # where the equations are published
    State: Any  # NamedTuple of arrays whose first axis is n
    Gains: Any  # NamedTuple of floats, defaults that work, a unit in the comment of each

    def start(self, pose: Array, angles: Array, room: Room, gains: Any) -> Any:
        """State from guesses of the pose (n, 3) x, y [m], theta [rad]; sensors at angles (2,) [rad]."""

    def step(self, state: Any, sample: Sample, room: Room, gains: Any) -> Any:
        """State at the next sample, sample.dt [s] later; finite where it was finite, whatever is missing."""

    def pose(self, state: Any, sample: Sample, room: Room) -> Array:
        """(n, 3) x, y [m], theta [rad] in [-pi, pi)."""

    # Only some have these; ask with hasattr.
    #   rule(room, dt, v, w, normalised=False) -> Gains    samples every dt [s]; v [m/s], w [rad/s] or so
    #   covariance(state) -> (n, 3, 3)    of x, y, theta
    #   fit(state) -> (n,)                log likelihood of the last sample, given those before
    #   distance(state) -> (n,)           squared Mahalanobis distance of the last innovation


def names() -> list[str]:
    """Names of all observers: the files of `observers/`."""
    return extension.files(Path(__file__).parent / "observers")


def get(name: str) -> Observer:
    """Observer by name; InputError, with the nearest names, for an unknown one."""
    found: Observer = extension.load(f"{__name__}.observers", name, names(), "observer")
    return found


def gains_from(observer: Observer, values: Mapping[str, float]) -> Any:
    """The observer's Gains with some replaced; InputError for an unknown name or no finite number."""
    return extension.replaced(observer.Gains(), values)
