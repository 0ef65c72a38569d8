"""The linear-quadratic observer as published: one gain and one model, both made for one speed.

    x+ = Phi x + Gamma delta + L (r_measured - r),  x = (vy, r)
    P  = Phi P Phi' - Phi P c (c'P c + R)^-1 c'P Phi' + Q,  L = Phi P c / (c'P c + R)

A predictor: what it says at a sample rests on the samples before. In reverse it is the model and the gain of
the same speed backwards. The Riccati equation is the discrete one; see docs/lateral.md, F1.
"""

from __future__ import annotations

from math import copysign
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.cars import Car
from outrider.kernel import kernel
from outrider.lateral import Estimate, Sample
from outrider.lateral.estimators._linear import correction, phi, positive, predicted, riccati, steady

reference = (
    "D. Fenyes, T. Hegedus, V. Van Tan and P. Gaspar, An Observer Design Method Using Ultra-Local Model for "
    "Autonomous Vehicles, ICINCO 2023, eq. 4, 9, 11"
)


class State(NamedTuple):
    """Prediction for the time of the last sample, and what that sample was."""

    vy: float  # [m/s]
    yaw_rate: float  # [rad/s]
    innovation: float  # measured minus predicted yaw rate [rad/s]
    steering: float  # [rad]


class Gains(NamedTuple):
    """Weights of the Riccati equation, and the speed it is solved at."""

    speed: float = 10.0  # [m/s]
    q_vy: float = 1000.0  # weight of the lateral velocity, Q11 [-]
    q_yaw_rate: float = 10.0  # of the yaw rate, Q22 [-]
    r: float = 1.0  # of the measured yaw rate [-]


class Design(NamedTuple):
    """What is computed once."""

    speed: float  # [m/s]
    L: npt.NDArray[np.float64]  # (2, 2) gain on vy [m/rad] and r [-]; rows: forward, reverse


def prepare(car: Car, gains: Gains, dt: float) -> Design:
    """Gain for steps of dt [s]; InputError for a weight or speed that is not positive."""
    positive("lq", **gains._asdict(), dt=dt)
    F = phi((gains.speed, -gains.speed), car, dt)
    R = np.array([[gains.r]])
    L = F @ correction(riccati(F, np.diag([gains.q_vy, gains.q_yaw_rate]), R), R)
    return Design(gains.speed, np.ascontiguousarray(L[..., 0]))


@kernel
def start(sample: Sample, car: Car, design: Design) -> State:
    """In a steady turn at the measured yaw rate."""
    return State(steady(sample.yaw_rate, sample.vx, car), sample.yaw_rate, 0.0, sample.steering)


@kernel
def step(state: State, sample: Sample, car: Car, design: Design) -> State:
    """Prediction with the steering and the innovation of the sample before, as published."""
    v = copysign(design.speed, sample.vx)
    row = 0 if sample.vx > 0.0 else 1
    vy, r = predicted(state.vy, state.yaw_rate, state.steering, v, sample.dt, car)
    vy += design.L[row, 0] * state.innovation
    r += design.L[row, 1] * state.innovation
    return State(vy, r, sample.yaw_rate - r, sample.steering)


@kernel
def output(state: State, sample: Sample, car: Car, design: Design) -> Estimate:
    """The prediction itself."""
    return Estimate(state.vy, state.yaw_rate, 0.0)
