"""Angles, plane poses and rectangles; every function takes scalars or arrays of matching shape."""

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

TAU = 2.0 * np.pi


def wrap(angle: Any) -> Any:
    """Angle folded into [-pi, pi) [rad]."""
    return (angle + np.pi) % TAU - np.pi


def wrap_axis(angle: Any) -> Any:
    """Angle of an undirected axis folded into [-pi/2, pi/2) [rad]."""
    return (angle + 0.5 * np.pi) % np.pi - 0.5 * np.pi


def rotate(p: Array, angle: Any) -> Array:
    """Points p (..., 2) turned by angle [rad], counter-clockwise; angle broadcasts against p[..., 0]."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = p[..., 0], p[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def compose(A_pose: Array, B_pose: Array) -> Array:
    """Pose (..., 3) [x, y, yaw]: B_pose, given in the frame of A_pose, expressed in the parent of A_pose."""
    A_pose, B_pose = np.asarray(A_pose, float), np.asarray(B_pose, float)
    p = A_pose[..., :2] + rotate(B_pose[..., :2], A_pose[..., 2])
    yaw = wrap(A_pose[..., 2] + B_pose[..., 2])
    return np.concatenate([p, np.asarray(yaw)[..., None]], axis=-1)


def invert(pose: Array) -> Array:
    """Pose (..., 3) of the parent frame seen from the child frame."""
    pose = np.asarray(pose, float)
    p = rotate(-pose[..., :2], -pose[..., 2])
    return np.concatenate([p, np.asarray(wrap(-pose[..., 2]))[..., None]], axis=-1)


def transform(pose: Array, p: Array) -> Array:
    """Points p (..., 2) given in the frame of pose (..., 3), expressed in the parent frame [m]."""
    pose = np.asarray(pose, float)
    return pose[..., :2] + rotate(np.asarray(p, float), pose[..., 2])


def corners(pose: Array, extent: Array) -> Array:
    """Corners (..., 4, 2) [m] of rectangles centred on pose (..., 3), extent (..., 2) = length, width.

    Counter-clockwise from front left: front left, rear left, rear right, front right.
    """
    pose, extent = np.asarray(pose, float), np.asarray(extent, float)
    signs = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    local = signs * extent[..., None, :]
    return pose[..., None, :2] + rotate(local, pose[..., 2, None])


def interpolate_poses(t: Array, poses: Array, at: Array) -> Array:
    """Poses (m, 3) at times `at` (m,) [s]: straight line between the rows of `poses` (n, 3) at `t` (n,).

    Yaw goes the short way round. Outside [t[0], t[-1]] the first or last pose is held. n >= 1, t increasing.
    """
    yaw = np.unwrap(poses[:, 2])
    return np.column_stack(
        [
            np.interp(at, t, poses[:, 0]),
            np.interp(at, t, poses[:, 1]),
            wrap(np.interp(at, t, yaw)),
        ]
    )
