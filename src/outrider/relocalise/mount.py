"""Between the robot's own point, about which it turns, and the point its range sensors sit on.

The robot's axes: x forward, y left; both points have the same heading. A unicycle does not move sideways, but
a point that is not on its axle does.
"""

from __future__ import annotations

import numpy as np

from outrider.relocalise import Array


def sensors(robot: Array, mount: Array) -> Array:
    """Pose (..., 3) of the sensors' point from that of the robot; mount (2,) in the robot's axes [m]."""
    return _moved(robot, np.asarray(mount, float))


def robot(sensors: Array, mount: Array) -> Array:
    """Pose (..., 3) of the robot from that of the sensors' point; mount (2,) in the robot's axes [m]."""
    return _moved(sensors, -np.asarray(mount, float))


def twist(v: Array | float, w: Array | float, mount: Array) -> tuple[Array, Array, Array]:
    """Velocity of the sensors' point forward and to the left [m/s], and yaw rate [rad/s]."""
    v, w = np.asarray(v, float), np.asarray(w, float)
    return v - w * mount[1], w * mount[0], w


def advanced(pose: Array, v: Array | float, w: Array | float, dt: float) -> Array:
    """Pose (..., 3) of a unicycle after dt [s] of constant speed v [m/s] and yaw rate w [rad/s]: exact."""
    half = 0.5 * np.asarray(w, float) * dt
    chord = v * dt * np.sinc(half / np.pi)
    middle = pose[..., 2] + half
    step = np.stack([chord * np.cos(middle), chord * np.sin(middle), 2.0 * half + 0.0 * chord], axis=-1)
    return np.asarray(pose + step)


def _moved(pose: Array, by: Array) -> Array:
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    step = np.stack([c * by[0] - s * by[1], s * by[0] + c * by[1], np.zeros_like(c)], axis=-1)
    return np.asarray(pose + step)
