"""The three observers of the papers as printed, in continuous time, many runs at once.

Every number of a state or an input is an array (N,), one entry a run; over time (T, N). The observers of
`outrider.observers` differ where a sensor makes them: this file is what the papers simulate.
[MS] Alai & Rajamani 2023; [HG] Alai, Zemouche & Rajamani. Angles in rad, everything else in SI units.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.kernel import rk4
from outrider.observers.multi_stage import L_BETA, L_PSI, NOMINAL

Array = npt.NDArray[np.float64]

L_R = 2.0  # [MS 10]
SLIP_MAX = np.pi / 9.0  # [MS 8]
LOST = 1e4  # a state beyond this is given up: the run is held there and counted
TABLE = (np.array(NOMINAL), np.array(L_PSI), np.array(L_BETA))
HALF_WAY = 0.5 * (TABLE[0][1:] + TABLE[0][:-1])  # where the next entry of the table begins


class Seen(NamedTuple):
    """What is measured: way S [m] and course alpha from two consecutive positions, and the position."""

    S: Any
    alpha: Any
    x: Any
    y: Any


class Estimate(NamedTuple):
    """What is compared, whatever the state; lost: the state has left all bounds."""

    x: Array
    y: Array
    V_x: Array
    V_y: Array
    psi: Array
    lost: npt.NDArray[np.bool_]  # (N,)

    def at(self, index: Any) -> Estimate:
        """The same at some times, and of some runs."""
        series = (v[index] for v in (self.x, self.y, self.V_x, self.V_y, self.psi))
        return Estimate._make((*series, self.lost))


def wrap(angle: Any) -> Any:
    """Angle folded into [-pi, pi)."""
    return angle - 2.0 * np.pi * np.floor(angle / (2.0 * np.pi) + 0.5)


# ------------------------------------------------------------------ multi-stage


class MultiStage(NamedTuple):
    """Speed (S, V, A, J), orientation (psi, beta), position (x, y); [MS 11, 17, 22]."""

    S: Any
    V: Any
    A: Any
    J: Any
    psi: Any
    beta: Any
    x: Any
    y: Any


class MultiStageGains(NamedTuple):
    """[MS] after eq. 36, and 77; the orientation gains are those of Table I."""

    L: tuple[float, float, float, float] = (4.61, 12.24, 9.83, 4.16)
    L_w: float = 20.0


def multi_stage(s: MultiStage, y: Seen, c: MultiStageGains) -> MultiStage:
    """[MS 27], [MS 40] with the gain of the nearest nominal speed, [MS 64]."""
    i = np.searchsorted(HALF_WAY, s.V)
    e, a, chi = y.S - s.S, wrap(y.alpha - s.psi - s.beta), s.psi + s.beta
    return MultiStage(
        s.V + c.L[0] * e,
        s.A + c.L[1] * e,
        s.J + c.L[2] * e,
        c.L[3] * e,
        s.V * np.sin(s.beta) / L_R + TABLE[1][i] * a,
        TABLE[2][i] * a,
        s.V * np.cos(chi) + c.L_w * (y.x - s.x),
        s.V * np.sin(chi) + c.L_w * (y.y - s.y),
    )


def start_multi_stage(x: Array, y: Array, V: Array, psi: Array) -> MultiStage:
    """Position, speed and yaw as guessed, all else 0."""
    o = np.zeros_like(V)
    return MultiStage(o, V, o, o, psi, o, x, y)


def told_multi_stage(s: MultiStage, c: Any, lost: npt.NDArray[np.bool_]) -> Estimate:
    """States (T, N) in common terms."""
    chi = s.psi + s.beta
    return Estimate(s.x, s.y, s.V * np.cos(chi), s.V * np.sin(chi), s.psi, lost)


# ------------------------------------------------------------------ high-gain


class HighGain(NamedTuple):
    """z = [X X' X'' Y Y' Y''], [HG 30]."""

    z1: Any
    z2: Any
    z3: Any
    z4: Any
    z5: Any
    z6: Any


class HighGainGains(NamedTuple):
    """[HG 92], and the two limits that the paper does not have; by default none."""

    L: Any = (67.20, 823.1, 2818.5)
    c_max: float = np.inf  # of the course rate
    floor: float = 0.0  # of the speed it is divided by


LIMITED = HighGainGains(c_max=1.9, floor=2.0)


def course_rate(z: HighGain, c: HighGainGains) -> Any:
    """[HG 44]."""
    V2 = np.maximum(z.z2 * z.z2 + z.z5 * z.z5, max(c.floor**2, 1e-300))
    return np.clip((z.z6 * z.z2 - z.z3 * z.z5) / V2, -c.c_max, c.c_max)


def high_gain(z: HighGain, y: Seen, c: HighGainGains) -> HighGain:
    """[HG 59] with f of [HG 58]."""
    k = course_rate(z, c)
    ex, ey = y.x - z.z1, y.y - z.z4
    return HighGain(
        z.z2 + c.L[0] * ex,
        z.z3 + c.L[1] * ex,
        -3.0 * z.z6 * k + 2.0 * z.z2 * k * k + c.L[2] * ex,
        z.z5 + c.L[0] * ey,
        z.z6 + c.L[1] * ey,
        3.0 * z.z3 * k + 2.0 * z.z5 * k * k + c.L[2] * ey,
    )


def start_high_gain(x: Array, y: Array, V: Array, psi: Array) -> HighGain:
    """Position, speed and yaw as guessed, no acceleration, no slip."""
    o = np.zeros_like(V)
    return HighGain(x, V * np.cos(psi), o, y, V * np.sin(psi), o)


def told_high_gain(z: HighGain, c: HighGainGains, lost: npt.NDArray[np.bool_]) -> Estimate:
    """States (T, N) in common terms; slip from [HG 44], within 20 degrees."""
    V = np.maximum(np.hypot(z.z2, z.z5), 1e-9)
    largest = np.sin(SLIP_MAX)
    beta = np.arcsin(np.clip(L_R * course_rate(z, c) / V, -largest, largest))
    return Estimate(z.z1, z.z4, z.z2, z.z5, np.arctan2(z.z5, z.z2) - beta, lost)


# ------------------------------------------------------------------ nonlinear (LMI), constant velocity


class ConstantVelocity(NamedTuple):
    """[X Y psi beta], [HG 11]; the speed is given."""

    X: Any
    Y: Any
    psi: Any
    beta: Any


class ConstantVelocityGains(NamedTuple):
    """No gain is printed; ours, from one LMI for 10 m/s, in the frame of the course, which it turns with."""

    L: tuple[float, float, float, float] = (8.004, 12.77, 4.52, 1.508)
    V: float = 10.0  # given speed, [MS V.A]
    slip: float = 1.0  # 1: the course is psi + beta, [MS 1-2]; 0: it is psi, as [HG 11] prints it
    turns: float = 1.0  # 0: the gain stays that of the course 0


def constant_velocity(s: ConstantVelocity, y: Seen, c: ConstantVelocityGains) -> ConstantVelocity:
    """Model [HG 11] plus gain times the position's innovation."""
    chi = s.psi + c.slip * s.beta
    ex, ey, cos, sin = y.x - s.X, y.y - s.Y, np.cos(c.turns * chi), np.sin(c.turns * chi)
    along, across = cos * ex + sin * ey, cos * ey - sin * ex
    return ConstantVelocity(
        c.V * np.cos(chi) + c.L[0] * cos * along - c.L[1] * sin * across,
        c.V * np.sin(chi) + c.L[0] * sin * along + c.L[1] * cos * across,
        c.V * np.sin(s.beta) / L_R + c.L[2] * across,
        c.L[3] * across,
    )


def start_constant_velocity(x: Array, y: Array, V: Array, psi: Array) -> ConstantVelocity:
    """Position and yaw as guessed, no slip; the guess of the speed is not used."""
    return ConstantVelocity(x, y, psi, np.zeros_like(psi))


def told_constant_velocity(
    s: ConstantVelocity, c: ConstantVelocityGains, lost: npt.NDArray[np.bool_]
) -> Estimate:
    """States (T, N) in common terms."""
    chi = s.psi + c.slip * s.beta
    return Estimate(s.X, s.Y, c.V * np.cos(chi), c.V * np.sin(chi), s.psi, lost)


# ------------------------------------------------------------------ all alike


class Published(NamedTuple):
    """One observer: its equations, how it begins, what it says."""

    name: str
    rhs: Callable[..., Any]
    start: Callable[[Array, Array, Array, Array], Any]
    told: Callable[..., Estimate]
    gains: Any


NONLINEAR = Published(
    "nonlinear", constant_velocity, start_constant_velocity, told_constant_velocity, ConstantVelocityGains()
)
HIGH_GAIN = Published("high-gain", high_gain, start_high_gain, told_high_gain, HighGainGains())
MULTI_STAGE = Published("multi-stage", multi_stage, start_multi_stage, told_multi_stage, MultiStageGains())
OBSERVERS = (NONLINEAR, HIGH_GAIN, MULTI_STAGE)  # in the order of the papers' tables


def simulate(o: Published, start: Any, seen: Seen, dt: float) -> Estimate:
    """Estimates (T, N) over the inputs (T, N), dt [s] apart and linear in between; classical Runge-Kutta."""
    s, history = start, [start]
    lost = np.zeros(np.shape(start[0]), bool)
    inputs = np.array(seen)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for k in range(inputs.shape[1] - 1):
            y, rate = Seen(*inputs[:, k]), Seen(*((inputs[:, k + 1] - inputs[:, k]) / dt))
            new = rk4(o.rhs, s, y, rate, o.gains, dt, 1)
            lost = lost | ~(np.max(np.abs(np.array(new)), axis=0) < LOST)
            s = type(s)(*np.where(lost, np.array(s), np.array(new))) if lost.any() else new
            history.append(s)
    return o.told(type(s)(*np.moveaxis(np.array(history), 0, 1)), o.gains, lost)
