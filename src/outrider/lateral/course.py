"""Courses to drive: a closed line, or a made one, as curvature over way; and how fast to take it.

The way s runs along the line, curvature is positive to the left. All that drives here keeps to s, the offset
from the line and the direction against it, so a course is its curvature; x and y are for pictures.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from outrider.errors import InputError

Array = npt.NDArray[np.float64]

STEP = 1.0  # about that between two points of a course [m]
SMOOTH = 6.0  # standard deviation of the Gaussian that a read line is smoothed with [m]
SHARPEST = 1.0 / 8.0  # a car hardly turns on less than 8 m [1/m]
G = 9.81  # [m/s2]
SHARE = 0.815  # of friction times g that a plan uses to turn: 8 m/s2 on a dry road
ALONG = 3.0  # most that a plan speeds up or slows down, on a dry road [m/s2]
QUICK, SLOW = 180.0, 900.0  # wave lengths of the wished speed on the first and second half [m]
CALM = 0.3  # where between least and most the slow swings turn [-]


class Course(NamedTuple):
    """Curvature at equal steps of way; after the last point it goes on with the first."""

    step: float  # between points [m]
    curvature: Array  # (n,) left positive [1/m]
    x: Array  # (n,) [m]
    y: Array  # (n,) [m]

    @property
    def length(self) -> float:
        """Way until it repeats [m]."""
        return self.step * len(self.curvature)


def read(path: str | Path) -> Course:
    """Course along a closed line: a CSV file whose first columns are x and y [m], lines with # ignored.

    The line is smoothed by a Gaussian of `SMOOTH` metres. InputError for what is no closed line of numbers.
    """
    path = Path(path)
    try:
        rows = np.loadtxt(path, delimiter=",", ndmin=2, usecols=(0, 1))
    except OSError as error:
        raise InputError(f"{path}: cannot read course ({error.strerror}); want a CSV file of x, y") from error
    except ValueError as error:
        raise InputError(f"{path}: no course ({error}); want columns x_m, y_m of numbers") from error
    return along(rows, str(path))


def along(points: Array, where: str = "course") -> Course:
    """Course along a closed line through points (n, 2) [m], the first not repeated at the end or so.

    InputError where it does not close, has fewer than ten points, or is too sharp to drive.
    """
    if len(points) < 10 or not np.isfinite(points).all():
        raise InputError(f"{where}: {len(points)} points; want ten or more, finite numbers")
    points = points[np.append(True, np.any(np.diff(points, axis=0) != 0.0, axis=1))]
    gaps = np.hypot(*np.diff(points, axis=0).T)
    close = float(np.hypot(*(points[-1] - points[0])))
    if close > 3.0 * float(gaps.max()):
        raise InputError(f"{where}: ends {close:.1f} m from its start; want a closed line")
    line = _even(np.vstack([points, points[:1]]) if close > 0.0 else points)
    step = float(np.hypot(*(line[1] - line[0])))
    smooth = gaussian_filter1d(line, SMOOTH / step, axis=0, mode="wrap")
    smooth = _even(np.vstack([smooth, smooth[:1]]))
    d1, d2 = _periodic(np.vstack([smooth, smooth[:1]]))
    curvature = (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / np.hypot(d1[:, 0], d1[:, 1]) ** 3
    if np.abs(curvature).max() > SHARPEST:
        at = int(np.abs(curvature).argmax())
        raise InputError(
            f"{where}: turns on {1.0 / abs(curvature[at]):.1f} m near x = {smooth[at, 0]:.0f}, "
            f"y = {smooth[at, 1]:.0f}; want {1.0 / SHARPEST:.0f} m or more"
        )
    length = float(np.hypot(*np.diff(np.vstack([smooth, smooth[:1]]), axis=0).T).sum())
    return Course(length / len(smooth), curvature, smooth[:, 0].copy(), smooth[:, 1].copy())


def _even(closed: Array) -> Array:
    """Points about `STEP` apart along a closed line (n, 2) whose last point is its first."""
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(closed, axis=0).T)))
    count = max(round(float(way[-1]) / STEP), 16)
    even: Array = CubicSpline(way, closed, bc_type="periodic")(
        np.linspace(0.0, way[-1], count, endpoint=False)
    )
    return even


def _periodic(closed: Array) -> tuple[Array, Array]:
    """First and second derivatives (n - 1, 2) of the spline through a closed line (n, 2), by index."""
    spline = CubicSpline(np.arange(len(closed), dtype=float), closed, bc_type="periodic")
    index = np.arange(len(closed) - 1)
    return spline(index, 1), spline(index, 2)


def winding(seed: int, length: float = 4000.0) -> Course:
    """Made course of at least `length` [m]: straights and turns of 12 to 120 m radius in random order, eased.

    The same seed makes the same course.
    """
    rng = np.random.default_rng(seed)
    pieces: list[Array] = []
    total = 0
    while total < length / STEP:
        angle, radius = rng.uniform(0.4, 2.6), np.exp(rng.uniform(np.log(12.0), np.log(120.0)))
        turn = np.full(max(int(angle * radius / STEP), 1), rng.choice([-1.0, 1.0]) / radius)
        pieces += [turn, np.zeros(int(rng.uniform(5.0, 90.0) / STEP))]
        total += len(pieces[-1]) + len(turn)
    curvature = gaussian_filter1d(np.concatenate(pieces)[: int(length / STEP)], 4.0 / STEP, mode="wrap")
    heading = STEP * np.cumsum(curvature)
    return Course(STEP, curvature, STEP * np.cumsum(np.cos(heading)), STEP * np.cumsum(np.sin(heading)))


def plan(
    course: Course, friction: float = 1.0, *, least: float = 6.0, most: float = 20.0, share: float = SHARE
) -> Array:
    """Speed (n,) [m/s] to take the course with, in turns at most the `share` of what friction allows.

    The wish swings: quickly between `least` and `most` on the first half of the course, slowly on the second,
    and there only down to `CALM` of the way between them, so that it is fast for long.
    Speeding up and slowing down take `ALONG` times friction at most. InputError for speeds, a friction or a
    share that cannot be.
    """
    if not (0.0 < friction <= 2.0 and 0.0 < share <= 1.2):
        raise InputError(
            f"friction {friction:g}, share {share:g}; want friction in (0, 2], share in (0, 1.2]"
        )
    if not 1.0 < least <= most <= 80.0:
        raise InputError(f"speeds {least:g} to {most:g} m/s; want 1 < least <= most <= 80")
    s = course.step * np.arange(len(course.curvature))
    half = 0.5 * course.length
    waves = np.where(s < half, s / QUICK, half / QUICK + (s - half) / SLOW)
    low = np.where(s < half, least, least + CALM * (most - least))
    wish = 0.5 * (low + most) - 0.5 * (most - low) * np.cos(2.0 * np.pi * waves)
    turn = np.sqrt(share * friction * G / np.maximum(np.abs(course.curvature), 1e-6))
    squared = np.minimum(wish, turn) ** 2
    change = 2.0 * ALONG * friction * course.step
    n = len(squared)
    for k in range(2 * n):  # twice round: what follows the end comes before the start
        squared[(k + 1) % n] = min(squared[(k + 1) % n], squared[k % n] + change)
    for k in range(2 * n, 0, -1):
        squared[(k - 1) % n] = min(squared[(k - 1) % n], squared[k % n] + change)
    speed: Array = np.sqrt(squared)
    return speed
