"""The standing world of a run, small enough to keep: one point a cell."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from outrider.geometry import rotate
from outrider.records import Array, Bools, Frame, Ints, Tracks, TrackState

LOOK_S = 0.5  # between two looks at the returns


class Background:
    """Where the standing world was seen; cells [m] double when there are more than `limit` of them."""

    def __init__(self, cell: float, limit: int = 30_000) -> None:
        self.cell, self._limit, self._looked = cell, limit, -np.inf
        self.points: Array = np.zeros((0, 2))  # fixed frame [m]
        self.seen: Ints = np.zeros(0, np.int64)  # (n,) in how many looks

    def add(self, frame: Frame) -> None:
        """The returns that lie in no box of a moving or unproven track, twice a second."""
        if abs(frame.t - self._looked) < LOOK_S:
            return
        self._looked = frame.t
        p = frame.scan.W_p[frame.scan.valid]
        p = p[~_inside(p, frame.tracks, 2.0 * self.cell)]
        first = np.unique(self._cells(p), axis=0, return_index=True)[1]
        self._merge(np.vstack([self.points, p[first]]), np.append(self.seen, np.ones(len(first), np.int64)))
        while len(self.points) > self._limit:
            self.cell *= 2.0
            self._merge(self.points, self.seen)

    def _cells(self, p: Array) -> Ints:
        return np.floor(p / self.cell).astype(np.int64)

    def _merge(self, p: Array, seen: Ints) -> None:
        cells, first, index = np.unique(self._cells(p), axis=0, return_index=True, return_inverse=True)
        self.points, self.seen = p[first], np.bincount(index.ravel(), seen, len(cells)).astype(np.int64)

    def save(self, path: Path) -> None:
        """Writes points, seen and cell to an .npz, in one step; OSError where it cannot."""
        part = path.with_suffix(".part")
        columns: dict[str, Any] = {
            "points": self.points.astype(np.float32),
            "seen": self.seen,
            "cell": self.cell,
        }
        with part.open("wb") as file:
            np.savez(file, **columns)
        os.replace(part, path)


def load_background(path: Path) -> Array:
    """(n, 2) points of the standing world [m] that were seen more than once; empty where none was kept."""
    try:
        with np.load(path) as kept:
            often = kept["seen"] >= min(2, kept["seen"].max(initial=1))
            return np.asarray(kept["points"][often], float)
    except OSError:
        return np.zeros((0, 2))


def _inside(p: Array, tracks: Tracks, margin: float) -> Bools:
    """(n,) whether points p (n, 2) lie in the box, grown by margin [m], of a track that is not static."""
    moving = tracks.state != TrackState.STATIC
    local = rotate(p[:, None] - tracks.W_p[moving], -tracks.yaw[moving])
    return np.asarray((np.abs(local) <= 0.5 * tracks.extent[moving] + margin).all(-1).any(-1))
