"""The linear-quadratic observer over speed: model and gain follow the measured speed.

    x- = Phi(vx, dt) x + Gamma(vx, dt) delta,  x+ = x- + K(vx) (r_measured - r-),  x = (vy, r)

A filter: a sample corrects its own time. Steering and speed of a step are the means of both its ends. K is
Riccati's, solved once on a grid of speeds for the usual step; of its first row only `share` is used, by
default nothing: what the yaw rate says of the lateral velocity, the model says better.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.cars import Car
from outrider.kernel import kernel
from outrider.lateral import Estimate, Sample
from outrider.lateral.estimators._linear import (
    correction,
    midway,
    phi,
    positive,
    predicted,
    riccati,
    steady,
    table,
    tabled,
)

reference = (
    "linear-quadratic observer of D. Fenyes, T. Hegedus, V. Van Tan and P. Gaspar, ICINCO 2023, scheduled "
    "over speed as a linear parameter-varying one; the certificate is our own"
)


class State(NamedTuple):
    """Estimate at the time of the last sample, and that sample's inputs."""

    vy: float  # [m/s]
    yaw_rate: float  # [rad/s]
    steering: float  # [rad]
    vx: float  # [m/s]


class Gains(NamedTuple):
    """Weights of the Riccati equation, and how much of its gain is used."""

    q_vy: float = 1000.0  # weight of the lateral velocity, Q11 [-]
    q_yaw_rate: float = 10.0  # of the yaw rate, Q22 [-]
    r: float = 1.0  # of the measured yaw rate [-]
    share: float = 0.0  # of the gain on the lateral velocity, L1: 0 none, 1 all [-]


class Design(NamedTuple):
    """What is computed once."""

    K: npt.NDArray[np.float64]  # (2 k, 2) gain on vy [m/rad] and r [-]; speeds of `table`


def prepare(car: Car, gains: Gains, dt: float) -> Design:
    """Gains for steps of dt [s]; InputError for a weight that is not positive."""
    positive("scheduled", q_vy=gains.q_vy, q_yaw_rate=gains.q_yaw_rate, r=gains.r, dt=dt)
    R = np.array([[gains.r]])
    P = riccati(phi(table(), car, dt), np.diag([gains.q_vy, gains.q_yaw_rate]), R)
    return Design(correction(P, R)[..., 0] * [gains.share, 1.0])


@kernel
def start(sample: Sample, car: Car, design: Design) -> State:
    """In a steady turn at the measured yaw rate."""
    vy = steady(sample.yaw_rate, sample.vx, car)
    return State(vy, sample.yaw_rate, sample.steering, sample.vx)


@kernel
def step(state: State, sample: Sample, car: Car, design: Design) -> State:
    """Prediction with the mean inputs of the step, then the correction by the yaw rate."""
    delta, v = 0.5 * (state.steering + sample.steering), midway(state.vx, sample.vx)
    vy, r = predicted(state.vy, state.yaw_rate, delta, v, sample.dt, car)
    e = sample.yaw_rate - r
    i, left = tabled(sample.vx)
    vy += (left * design.K[i, 0] + (1.0 - left) * design.K[i + 1, 0]) * e
    r += (left * design.K[i, 1] + (1.0 - left) * design.K[i + 1, 1]) * e
    return State(vy, r, sample.steering, sample.vx)


@kernel
def output(state: State, sample: Sample, car: Car, design: Design) -> Estimate:
    """The state itself."""
    return Estimate(state.vy, state.yaw_rate, 0.0)


def claim(car: Car, gains: Any, **asked: Any) -> Any:
    """What is claimed of the error under these gains; `claim.Claim`, its region in `_scheduled_proof`."""
    from outrider.lateral.estimators import _scheduled_proof

    return _scheduled_proof.claim(car, gains, **asked)


def certificate(car: str = "b_class") -> Any:
    """Proof, for a car that comes with the package, that the error decays however the speed changes."""
    from outrider.lateral.estimators import _scheduled_proof

    return _scheduled_proof.certificate(car)
