"""Ultra-local model on an LQ observer, as published, in the three ways it can be read.

    x+ = Phi x + Gamma (delta + u) + L (r_measured - r),   vd = ay - vx r_measured     x = (vy, r)

    1  u  = (vd - (A1 x + B1 delta)) / alpha             against the observer's own model
    2  u += (vd - (A1 x + B1 (delta + u))) / alpha       the same, summed up: the model-free controller's form
    3  u  = (vd - (A1 xn + B1 delta)) / alpha            against the free model, xn+ = Phi xn + Gamma delta

Step 6 of the source has lost sign, difference and reference; u is minus its difference over alpha.
Readings 1 and 2 are unstable for small alpha: below 80 to 100 and below about 42 for its car at 10 ms. For
reproduction; `ultra_local` is the form to use. A predictor: what it says at a sample rests on those before.
"""

from __future__ import annotations

from math import isfinite
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.cars import Car
from outrider.kernel import kernel
from outrider.lateral import Estimate, Sample
from outrider.lateral.estimators._linear import positive, steady
from outrider.lateral.estimators._ultra import (
    FARTHEST,
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
    "Autonomous Vehicles, ICINCO 2023, section 3, step 6"
)

NONE = 1e6  # from this alpha on the ultra-local model adds nothing [m/s2 per rad]
TURNED = 10.0  # of u, beyond any car: only keeps numbers finite [rad]


class State(NamedTuple):
    """Prediction for the last sample, and that sample: the next prediction is made from both."""

    vy: float  # [m/s]
    yaw_rate: float  # [rad/s]
    u: float  # steering that stands for what is not modelled [rad]
    vy_free: float  # of the model running free [m/s]
    yaw_rate_free: float  # [rad/s]
    vx: float  # of the last sample [m/s]
    measured: float  # yaw rate [rad/s]
    steering: float  # [rad]
    rate: float  # ay - vx yaw rate [m/s2]
    known: float  # 1: that is measured, 0: ay was missing


class Gains(NamedTuple):
    """alpha in seven bins of speed (edges in `_ultra`), its inverse linear between their middles."""

    reading: float = 1.0  # of step 6: 1, 2 or 3 [-]
    alpha1: float = NONE  # [m/s2 per rad]
    alpha2: float = NONE  # [m/s2 per rad]
    alpha3: float = NONE  # [m/s2 per rad]
    alpha4: float = NONE  # [m/s2 per rad]
    alpha5: float = NONE  # [m/s2 per rad]
    alpha6: float = NONE  # [m/s2 per rad]
    alpha7: float = NONE  # [m/s2 per rad]
    base: float = 0.0  # 0: model and gain at 10 m/s, as in the source; 1: scheduled over speed [-]
    share: float = 1.0  # of the observer's gain on vy that is used, L1: 0 none, 1 all as in the source [-]


class Design(NamedTuple):
    """What is computed once."""

    L: Array  # (m, 2) gain of the yaw rate on vy, the wanted share of it, and on itself, over speed
    at: Array  # (7,) middles of the bins [m/s]
    inverse: Array  # (7,) 1 / alpha [rad s2/m]
    reading: float
    scheduled: bool


def prepare(car: Car, gains: Gains, dt: float) -> Design:
    """Gains over speed and the table of 1 / alpha; InputError for an alpha that is not positive."""
    name = "ultra_local_published"
    positive(name, dt=dt, **{key: value for key, value in gains._asdict().items() if key[:5] == "alpha"})
    one_of(name, "reading", gains.reading, (1.0, 2.0, 3.0))
    one_of(name, "base", gains.base, (0.0, 1.0))
    L = observer(car, bool(gains.base), dt)[0] * (gains.share, 1.0)
    alpha = np.array(gains[1:8])
    inverse = np.where(alpha < NONE, 1.0 / alpha, 0.0)
    return Design(L, middles(SPEED), inverse, gains.reading, bool(gains.base))


@kernel
def start(sample: Sample, car: Any, design: Any) -> State:
    """In a steady turn at the measured yaw rate."""
    r = sample.yaw_rate
    vy = steady(r, sample.vx, car)
    return _kept(vy, r, 0.0, vy, r, sample)


@kernel
def step(state: State, sample: Sample, car: Any, design: Any) -> State:
    """Prediction for this sample from the last one: its inputs, and its yaw rate as the correction."""
    s = state
    m = model(design.scheduled, s.vx, car)
    d = sampled(m, sample.dt)
    u = s.u if design.reading == 2.0 else 0.0
    if s.known > 0.0:
        vy, r = (s.vy_free, s.yaw_rate_free) if design.reading == 3.0 else (s.vy, s.yaw_rate)
        pull = between(abs(s.vx), design.at, design.inverse)
        u += pull * (s.rate - (m.a11 * vy + m.a12 * r + m.b1 * (s.steering + u)))
    L1, L2 = gain(design.L, s.vx)
    e, delta = s.measured - s.yaw_rate, s.steering + u
    return _kept(
        d.a11 * s.vy + d.a12 * s.yaw_rate + d.b1 * delta + L1 * e,
        d.a21 * s.vy + d.a22 * s.yaw_rate + d.b2 * delta + L2 * e,
        u,
        d.a11 * s.vy_free + d.a12 * s.yaw_rate_free + d.b1 * s.steering,
        d.a21 * s.vy_free + d.a22 * s.yaw_rate_free + d.b2 * s.steering,
        sample,
    )


@kernel
def _kept(vy: float, r: float, u: float, vy_free: float, r_free: float, sample: Sample) -> State:
    known = isfinite(sample.ay)
    return State(
        bounded(vy, FARTHEST),
        bounded(r, SPUN),
        bounded(u, TURNED),
        bounded(vy_free, FARTHEST),
        bounded(r_free, SPUN),
        sample.vx,
        sample.yaw_rate,
        sample.steering,
        sample.ay - sample.vx * sample.yaw_rate if known else 0.0,
        1.0 if known else 0.0,
    )


@kernel
def output(state: State, sample: Sample, car: Any, design: Any) -> Estimate:
    """Lateral velocity and yaw rate as predicted for this sample; the sensor's bias is not estimated."""
    return Estimate(state.vy, state.yaw_rate, 0.0)
