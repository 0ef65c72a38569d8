"""Drives of a bicycle with truth: what a car does in town, twelve manoeuvres in two variants each."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from outrider.geometry import wrap
from outrider.metrics import Truth
from outrider.models import bicycle
from outrider.records import Array

PERIOD_S = 0.1  # between two samples
FINE = 50  # steps of the model between two samples
SMOOTHING_S = 0.8  # no change of speed or slip is quicker

# Manoeuvre: points (time [s], speed [m/s]), points (time [s], slip [rad]); straight between, then smoothed.
MANOEUVRES = {
    "steady": (((0, 10), (16, 10)), ((0, 0),)),
    "accelerating": (((0, 2), (4, 2), (12, 14), (16, 14)), ((0, 0),)),
    "braking to a stop": (((0, 12), (4, 12), (7, 0), (11, 0), (15, 8), (16, 8)), ((0, 0),)),
    "emergency braking": (((0, 14), (5, 14), (6.8, 0), (12, 0)), ((0, 0),)),
    "stop and go": (((0, 5), (3, 0), (5, 0), (8, 6), (11, 0), (13, 0), (16, 5)), ((0, 0),)),
    "left turn": (((0, 9), (4, 5), (9, 5), (13, 10)), ((4, 0), (5, 0.22), (7.5, 0.22), (8.5, 0))),
    "right turn": (((0, 8), (4, 4), (9, 4), (13, 8)), ((4, 0), (5, -0.3), (7, -0.3), (8, 0))),
    "roundabout": (
        ((0, 9), (3, 6), (12, 6), (15, 9)),
        ((3, 0), (3.5, -0.15), (4.5, 0.16), (10, 0.16), (10.5, -0.15), (12, 0)),
    ),
    "lane change": (
        ((0, 13), (16, 13)),
        ((4, 0), (5, 0.05), (6, -0.05), (7, 0), (10, 0), (11, -0.05), (12, 0.05), (13, 0)),
    ),
    "backing out": (
        ((0, 0), (2, 0), (4, -2.5), (8, -2.5), (10, 0), (11, 0), (15, 8)),
        ((3, 0), (4, 0.3), (8, 0.3), (9, 0)),
    ),
    "three-point turn": (
        ((0, 4), (4, 3), (5, 0), (5.5, 0), (7, -2), (9, -2), (10, 0), (10.5, 0), (13, 5), (16, 6)),
        ((1, 0), (2, 0.4), (5, 0.4), (5.5, -0.4), (10, -0.4), (10.5, 0.4), (12.5, 0.4), (13.5, 0)),
    ),
    "weaving": (((0, 11), (16, 11)), tuple((t, 0.06 * (-1) ** t) for t in range(3, 15))),
}


def all_of_them() -> Iterator[tuple[str, Truth]]:
    """Name and truth of each drive; the second half drives faster, mirrored, with another rear axle."""
    rng = np.random.default_rng(26)
    for quicker, side, axle in ((1.0, 1.0, 1.4), (1.25, -1.0, 1.8)):
        for name, (speed, slip) in MANOEUVRES.items():
            heading = rng.uniform(-np.pi, np.pi)
            yield f"{name} x{quicker}", drive(speed, slip, quicker, side, axle, heading)


def drive(speed: Array, slip: Array, quicker: float, side: float, axle: float, heading: float) -> Truth:
    """A drive along points (m, 2) of speed and of slip, speeds times `quicker`, slip times `side`.

    axle: body centre to rear axle [m]; heading: at the beginning [rad].
    """
    (t_V, V), (t_beta, beta) = np.array(speed, float).T, np.array(slip, float).T
    step = PERIOD_S / FINE
    fine = np.arange(0.0, t_V[-1] + 0.5 * step, step)
    V = quicker * _smooth(np.interp(fine, t_V, V), step)
    beta = side * _smooth(np.interp(fine, t_beta, beta), step)
    A, zero = np.diff(V) / step, np.zeros(len(V) - 1)
    arcs = bicycle.State(zero, zero, V[:-1], A, zero, beta[:-1])
    psi = heading + np.cumsum(np.append(0.0, bicycle.arc(arcs, step, axle).psi))
    moved = bicycle.arc(arcs._replace(psi=psi[:-1]), step, axle)
    X, Y = (np.cumsum(np.append(0.0, part)) for part in (moved.X, moved.Y))
    X, Y, V, psi, beta = (part[::FINE] for part in (X, Y, V, psi, beta))
    way = np.column_stack([np.cos(psi + beta), np.sin(psi + beta)])
    return Truth(fine[::FINE], np.column_stack([X, Y]), V[:, None] * way, wrap(psi))


def _smooth(x: Array, step: float) -> Array:
    """The mean over two windows of half the smoothing time in turn; the ends are held."""
    n = round(0.5 * SMOOTHING_S / step)
    for _ in range(2):
        held = np.concatenate([np.full(n // 2, x[0]), x, np.full(n - 1 - n // 2, x[-1])])
        total = np.cumsum(np.concatenate([[0.0], held]))
        x = (total[n:] - total[:-n]) / n
    return x
