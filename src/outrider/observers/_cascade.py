"""What is claimed of the multi-stage observer as a whole: speed, orientation and position in one family."""

from __future__ import annotations

from math import cos
from typing import Any

import numpy as np
import numpy.typing as npt

from outrider import family
from outrider.claim import WITHOUT_HOLD, Claim, Sought
from outrider.errors import InputError
from outrider.family import Line, Point, Table
from outrider.inequalities import SLIP, Form, chain
from outrider.observers import multi_stage

Array = npt.NDArray[np.float64]

BLOCKS = ((range(4),), ((4, 5),), ((6,), (7,)))  # states of each block of P: the position's frame may turn
MISMATCH = 0.1  # how far the true speed may be from the estimated one [-]


def claim(
    gains: Any,
    form: Form = "continuous",
    speed: tuple[float, float] = (1.0, 20.0),
    slip: float = SLIP,
    mismatch: float = MISMATCH,
) -> Claim:
    """Claim for `multi_stage.Gains` over true speeds [m/s] and slips up to `slip` [rad].

    mismatch [-]: share by which the true speed may leave the span of the entry in use, or differ from the
    estimated one. The rectangle's heading may correct with any gain from 0 to `gains.heading`.
    InputError for a form it has not, or a region that is none.
    """
    if form != "continuous":
        raise InputError(f"multi_stage has no proof in {form!r} form; want continuous")
    if not 0.0 < speed[0] <= speed[1] < np.inf:
        raise InputError(f"speeds {speed[0]:g} to {speed[1]:g} m/s; want 0 < low <= high: no proof crosses 0")
    if not (0.0 < slip < 0.5 * np.pi and 0.0 <= mismatch < 1.0):
        raise InputError(f"slip {slip:g} rad, mismatch {mismatch:g}; want 0 < slip < pi/2, 0 <= mismatch < 1")
    L_s, scheduled = speed_gain(gains), points(gains, speed, mismatch)
    return Claim(
        "multi_stage",
        "continuous",
        family.multi_stage(L_s, scheduled, gains.L_w, gains.heading, gains.l_r, slip),
        {
            "speed [m/s]": speed,
            "slip [rad]": (-slip, slip),
            "gain on the heading [1/s]": (0.0, gains.heading),
        },
        (
            f"The true speed is within {100.0 * mismatch:g} % of what chooses the gain.",
            "The vehicle goes forward.",
            f"Jerk and slip are constant, the slip within {np.degrees(slip):g} degrees.",
            "What jerk and slip change acts like a disturbance.",
            "The measurement runs along the line between two samples; the equations are integrated exactly.",
            WITHOUT_HOLD,
        ),
        {"speed": speed, "slip": slip, "mismatch": mismatch},
        BLOCKS,
        _sought(L_s, scheduled, gains, slip),
    )


def points(gains: Any, speed: tuple[float, float], mismatch: float) -> list[Point]:
    """Orientation gains that may be in use over true speeds [m/s]: of the line, or of Table I."""
    k = gains.orientation
    if gains.psi_V > 0.0:
        line = Line(*speed, (k * gains.psi_0, k * gains.psi_V), (k * gains.beta_0, k * gains.beta_V))
        return line.points(mismatch)
    m = multi_stage
    rows = [row for row in zip(m.NOMINAL, m.L_PSI, m.L_BETA, strict=True) if speed[0] <= row[0] <= speed[1]]
    if not rows:
        raise InputError(f"speeds {speed[0]:g} to {speed[1]:g} m/s hold no entry of Table I; widen them")
    nominal, psi, beta = zip(*rows, strict=True)
    return Table(nominal, [k * g for g in psi], [k * g for g in beta]).points(mismatch)


def speed_gain(gains: Any) -> list[float]:
    """L_s (4,) of the speed chain in use."""
    chain_of = (gains.L_S, gains.L_V, gains.L_A, gains.L_J)
    return [g * gains.speed**power for power, g in enumerate(chain_of, 1)]


def _sought(L_s: list[float], points: list[Point], gains: Any, slip: float) -> tuple[Sought, ...]:
    """Of each stage by the error of what drives it; exactly where the stage is linear."""
    L, one = np.array(L_s)[:, None], np.eye(4)
    A = (chain(4) - L @ one[:1])[None]
    orientation = family.orientation_errors(points, gains.l_r, slip).matrices
    turned = np.array([[[-p.psi], [-p.beta]] for p in points for _ in (cos(slip), 1.0)])
    w = np.full((1, 1, 1), gains.L_w)
    fastest = np.full((1, 1, 1), max(p.speed for p in points))
    one_one = np.ones((1, 1))
    return (
        Sought("speed", "path", A, -L[None], one[1:2]),
        Sought("acceleration", "path", A, -L[None], one[2:3]),
        Sought("(speed, acceleration)", "path", A, -L[None], one[1:3], "energy"),
        Sought("course", "measured course", orientation, turned, np.ones((1, 2))),
        Sought("position", "position", -w, -w, one_one),
        Sought("position", "speed", -w, one_one[None], one_one),
        Sought("position", "course", -w, fastest, one_one),
    )
