"""What observers of a pose share: estimates that have left the room are put back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from outrider.geometry import TAU
from outrider.relocalise import Array

if TYPE_CHECKING:
    from outrider.relocalise.wall import Wall

CORNERS = 360  # of the outline on which the nearest point of the wall is looked for
INSET = 1e-3  # how far inside a point is put back, in diameters of the wall


def kept_inside(wall: Wall, pose: Array) -> Array:
    """Poses (n, 3) whose point is inside the wall: those outside go to about the nearest point inside.

    Where a pose is not finite, to the middle of the room.
    """
    lost = np.atleast_1d(np.logical_not(wall.inside(pose[:, :2])))
    if not lost.any():
        return pose
    pose = np.array(pose)
    pose[lost] = np.where(np.isfinite(pose[lost]).all(axis=1)[:, None], pose[lost], [*wall.centroid, 0.0])
    outline = wall.at(TAU * np.arange(CORNERS) / CORNERS).r
    away = pose[lost, None, :2] - outline
    nearest = outline[np.argmin((away**2).sum(axis=-1), axis=-1)]
    inward = wall.centroid - nearest
    pose[lost, :2] = nearest + inward * (INSET * wall.diameter / np.linalg.norm(inward, axis=-1))[:, None]
    return pose
