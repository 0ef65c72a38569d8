"""What a measurement is good for: whether it is there, where it points, and how much it may be believed."""

from __future__ import annotations

from math import inf, sqrt

from outrider.kernel import kernel, wrap
from outrider.observers import Innovation, Measurement

FAR = 1e8  # a coordinate further out is not one [m]


@kernel
def seen(measurement: Measurement) -> bool:
    """Whether there is a position."""
    return abs(measurement.x) < FAR and abs(measurement.y) < FAR


@kernel
def pointed(measurement: Measurement) -> bool:
    """Whether there is a heading of the rectangle."""
    return abs(measurement.heading) < FAR and 0.0 <= measurement.heading_variance < inf


@kernel
def heading_or(measurement: Measurement, otherwise: float) -> float:
    """Heading of the rectangle where it is known [rad]."""
    return wrap(measurement.heading) if pointed(measurement) else otherwise


@kernel
def directed(dx: float, dy: float, y0: Measurement, y1: Measurement, noise: float, sigmas: float) -> bool:
    """Whether the way (dx, dy) [m] is `sigmas` deviations across long, so that it has a direction.

    noise: least standard deviation of each end [m].
    """
    d2 = dx * dx + dy * dy
    across = (y0.xx + y1.xx) * dy * dy - 2.0 * (y0.xy + y1.xy) * dx * dy + (y0.yy + y1.yy) * dx * dx
    return d2 * d2 > sigmas**2 * max(across, 2.0 * noise**2 * d2) and d2 > 0.0


@kernel
def huber(innovation: Innovation, k: float) -> float:
    """Weight of an innovation in (0, 1]: 1 up to k standard deviations, falling as their number beyond.

    The weighted innovation is never longer than k deviations. k = 0: no limit.
    Huber, Robust Estimation of a Location Parameter, 1964.
    """
    i = innovation
    determinant = i.xx * i.yy - i.xy * i.xy
    if not (k > 0.0 and determinant > 0.0):
        return 1.0
    square = (i.yy * i.x * i.x - 2.0 * i.xy * i.x * i.y + i.xx * i.y * i.y) / determinant
    return 1.0 if square <= k * k else k / sqrt(square)
