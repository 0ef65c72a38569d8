"""Ultra-local model on an LQ observer, well posed: the measured acceleration replaces a share of the model's.

    dm  = (Phi11 - 1) vy + Phi12 r + Gamma1 delta          what the model adds to vy over a step
    u   = k (dt (ay - vx r_measured) - dm)                 k in [0, 1); alpha = Gamma1 / (dt k)
    vy+ = vy + dm + u + K1 e,   r+ = Phi21 vy + Phi22 r + Gamma2 delta + K2 e,   e = r_measured - r predicted

So it is a complementary filter: faster than the leak (1 - k) |A11| it integrates the acceleration, slower it
is the model. k = 0 is the observer alone; k = 1 is pure integration, which drifts, and is refused. A constant
error b of the acceleration moves vy by b dt k / ((1 - k) (1 - Phi11)). K1 is 0: K1 e would undo u.

On straights the mean of ay - vx r is the sensors' error, for vy comes back to 0: it is learned and taken off.
Inputs of a step are the means of those at its ends, so a ramp of any of them leaves no error.
"""

from __future__ import annotations

from math import exp, isfinite
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.cars import Car
from outrider.errors import InputError
from outrider.kernel import kernel
from outrider.lateral import Estimate, Sample
from outrider.lateral.estimators._linear import midway, positive, steady
from outrider.lateral.estimators._ultra import (
    FARTHEST,
    SIDE,
    SPEED,
    SPUN,
    between,
    bounded,
    gain,
    middles,
    model,
    observer,
    one_of,
)
from outrider.models.single_track import sampled

Array = npt.NDArray[np.float64]

reference = (
    "D. Fenyes, T. Hegedus, V. Van Tan and P. Gaspar, An Observer Design Method Using Ultra-Local Model for "
    "Autonomous Vehicles, ICINCO 2023, made discrete-consistent with direct injection"
)

STRAIGHT = 1.5  # less lateral acceleration is straight on [m/s2]
LAG = 0.1  # time constant of the |ay| that k depends on [s]


class State(NamedTuple):
    """Estimate at the last sample, and what of that sample the next step needs."""

    vy: float  # [m/s]
    yaw_rate: float  # [rad/s]
    side: float  # low-passed ay [m/s2]
    vx: float  # of the last sample [m/s]
    steering: float  # [rad]
    rate: float  # ay - vx yaw rate, 0 where not measured [m/s2]
    measured: float  # 1: rate is measured, 0: ay was missing
    drift: float  # what of the rate is the sensors' error [m/s2]
    straight: float  # time that drift was learned in, at most `memory` [s]


class Gains(NamedTuple):
    """Share k in seven bins of |ay| or of speed (edges in `_ultra`), linear between their middles."""

    over: float = 1.0  # k depends on 0: speed, 1: low-passed |ay| [-]
    k1: float = 0.0  # [-]; the defaults are for the noise and bias of cheap inertial sensors
    k2: float = 0.0  # [-]
    k3: float = 0.0  # [-]
    k4: float = 0.3  # [-]
    k5: float = 0.3  # [-]
    k6: float = 0.95  # [-]
    k7: float = 0.95  # [-]
    base: float = 1.0  # observer it stands on: 0: the fixed one at 10 m/s, 1: scheduled over speed [-]
    share: float = 0.0  # of the observer's gain on vy that is used, K1: 0 none, 1 all [-]
    memory: float = 30.0  # over how much going straight the sensors' error is learned; 0: it is not [s]
    dt: float = 0.01  # step the table is for; at another one k gives the same leak [s]


class Design(NamedTuple):
    """What is computed once."""

    K: Array  # (m, 2) gain of the yaw rate on vy, the wanted share of it, and on itself, over speed
    at: Array  # (7,) middles of the bins, [m/s] or [m/s2]
    k: Array  # (7,)
    over_side: bool  # the bins are those of ay
    scheduled: bool
    memory: float  # [s]
    dt: float  # [s]


def prepare(car: Car, gains: Gains, dt: float) -> Design:
    """Gains over speed and the table of k; InputError for a k outside [0, 1) or a switch that is none."""
    k = np.array(gains[1:8])
    for i, value in enumerate(k):
        if not 0.0 <= value < 1.0:
            raise InputError(f"ultra_local: k{i + 1} = {value:g}; want 0 <= k < 1: at 1 any bias drifts away")
    one_of("ultra_local", "over", gains.over, (0.0, 1.0))
    if not gains.memory >= 0.0:
        raise InputError(f"ultra_local: memory = {gains.memory:g}; want 0 or a positive time [s]")
    one_of("ultra_local", "base", gains.base, (0.0, 1.0))
    positive("ultra_local", dt=dt, **{"the table's dt": gains.dt})
    K = observer(car, bool(gains.base), dt)[1] * (gains.share, 1.0)
    return Design(
        K,
        middles(SIDE if gains.over else SPEED),
        k,
        bool(gains.over),
        bool(gains.base),
        gains.memory,
        gains.dt,
    )


@kernel
def start(sample: Sample, car: Any, design: Any) -> State:
    """In a steady turn at the measured yaw rate."""
    r, known = sample.yaw_rate, isfinite(sample.ay)
    side = sample.ay if known else sample.vx * r
    return _kept(steady(r, sample.vx, car), r, side, sample, 0.0, 0.0)


@kernel
def step(state: State, sample: Sample, car: Any, design: Any) -> State:
    """The model's step with the share k of the measured one, then the correction by the yaw rate."""
    s, dt = state, sample.dt
    vx, delta = midway(s.vx, sample.vx), 0.5 * (s.steering + sample.steering)
    m = model(design.scheduled, vx, car)
    d = sampled(m, dt)
    dm = (d.a11 - 1.0) * s.vy + d.a12 * s.yaw_rate + d.b1 * delta
    r = d.a21 * s.vy + d.a22 * s.yaw_rate + d.b2 * delta
    side, u, drift, straight = s.side, 0.0, s.drift, s.straight
    if isfinite(sample.ay):
        side += (1.0 - exp(-dt / LAG)) * (sample.ay - side)
        if s.measured > 0.0:
            rate = 0.5 * (s.rate + sample.ay - sample.vx * sample.yaw_rate)
            k = between(abs(side) if design.over_side else abs(vx), design.at, design.k)
            u = same_leak(k, m.a11, dt, design.dt) * (dt * (rate - drift) - dm)
            if abs(side) < STRAIGHT:
                straight = min(straight + dt, design.memory)
                if straight > 0.0:
                    drift += min(dt / straight, 1.0) * (rate - drift)
    K1, K2 = gain(design.K, sample.vx)
    e = sample.yaw_rate - r
    return _kept(s.vy + dm + u + K1 * e, r + K2 * e, side, sample, drift, straight)


@kernel
def same_leak(k: float, a11: float, dt: float, of: float) -> float:
    """The k that over dt [s] leaks as much as k over steps of `of` [s] does; a11 [1/s] of the model."""
    if k == 0.0 or dt == of:
        return k
    kept = (1.0 - (1.0 - k) * (1.0 - exp(a11 * of))) ** (dt / of)
    made: float = 1.0 - (1.0 - kept) / (1.0 - exp(a11 * dt))
    return made


@kernel
def _kept(vy: float, r: float, side: float, sample: Sample, drift: float, straight: float) -> State:
    known = isfinite(sample.ay)
    rate = sample.ay - sample.vx * sample.yaw_rate if known else 0.0
    vy, r = bounded(vy, FARTHEST), bounded(r, SPUN)
    return State(vy, r, side, sample.vx, sample.steering, rate, 1.0 if known else 0.0, drift, straight)


@kernel
def output(state: State, sample: Sample, car: Any, design: Any) -> Estimate:
    """Lateral velocity and yaw rate; the sensor's bias is not estimated."""
    return Estimate(state.vy, state.yaw_rate, 0.0)
