"""Pure integration of what accelerates the car sideways in its own frame: no model, hence drift.

    vy' = ay - vx r - leak vy

By the trapezoidal rule; ay at the centre of gravity, gravity by bank and roll taken for acceleration. Where
ay is missing only the leak acts.
"""

from __future__ import annotations

from math import exp, expm1, isfinite
from typing import NamedTuple

from outrider.cars import Car
from outrider.errors import InputError
from outrider.kernel import kernel
from outrider.lateral import Estimate, Sample
from outrider.lateral.estimators._linear import steady

reference = "kinematics of a rigid body; Fenyes, Hegedus, Van Tan and Gaspar, ICINCO 2023, section 3.2"


class State(NamedTuple):
    """Estimate at the time of the last sample."""

    vy: float  # [m/s]
    yaw_rate: float  # as measured [rad/s]
    rate: float  # ay - vx r of the last sample, 0 where ay is missing [m/s2]


class Gains(NamedTuple):
    """How fast the past is forgotten."""

    leak: float = 0.0  # 0: never [1/s]


class Design(NamedTuple):
    """What is computed once."""

    leak: float  # [1/s]


def prepare(car: Car, gains: Gains, dt: float) -> Design:
    """The leak; InputError where it is negative: the estimate would grow by itself."""
    if not 0.0 <= gains.leak < float("inf"):
        raise InputError(f"integration: leak = {gains.leak:g}; want 0 or more")
    return Design(gains.leak)


@kernel
def start(sample: Sample, car: Car, design: Design) -> State:
    """In a steady turn at the measured yaw rate."""
    return State(steady(sample.yaw_rate, sample.vx, car), sample.yaw_rate, _rate(sample))


@kernel
def step(state: State, sample: Sample, car: Car, design: Design) -> State:
    """The mean rate of both ends of the step is integrated."""
    now, decay = _rate(sample), design.leak * sample.dt
    way = -expm1(-decay) / design.leak if decay > 1e-9 else sample.dt
    return State(state.vy * exp(-decay) + 0.5 * (state.rate + now) * way, sample.yaw_rate, now)


@kernel
def output(state: State, sample: Sample, car: Car, design: Design) -> Estimate:
    """The integral, and the yaw rate as measured."""
    return Estimate(state.vy, state.yaw_rate, 0.0)


@kernel
def _rate(sample: Sample) -> float:
    """vy' [m/s2]."""
    return sample.ay - sample.vx * sample.yaw_rate if isfinite(sample.ay) else 0.0
