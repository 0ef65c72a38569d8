"""Evidence that the sampled high-gain observer contracts: its Jacobian on a grid of states and time steps.

The step commutes with turning the world and with scaling all lengths, and so does the norm e'Pe with
P = I2 (x) P3. So the Jacobian is needed at one speed and one course only, and depends on the acceleration
over the speed, the course rate and dt. Where it shrinks the norm by `rate` on the whole line between estimate
and truth, so does the step.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from math import ceil
from typing import Any

import numpy as np

from outrider.certificate import Array, Certificate
from outrider.kernel import rk4

DTS = (0.05, 0.1, 0.15, 0.2)  # steps [s]
RATIO = 0.15  # largest acceleration along the course over speed [1/s]
COURSE_RATE = 0.2  # [rad/s]
POINTS = 7  # of the grid, each way
RATE = 0.992  # of decay by a step [-]
PACE = 0.3  # [s]: errors are weighed as 1 m, 1 m / PACE, 1 m / PACE^2
P3 = np.array(
    [
        [0.0894, -0.0783, 0.0170],
        [-0.0783, 0.1697, -0.2774],
        [0.0170, -0.2774, 1.0000],
    ]
)
SPEED = 10.0  # at which the Jacobian is taken [m/s]


def jacobian(gains: Any, ratio: float, course_rate: float, dt: float) -> Array:
    """Of a step (6, 6) at acceleration / speed [1/s] and course rate [rad/s], by central differences."""
    from outrider.observers._sampled import chain_gains
    from outrider.observers.high_gain import SUBSTEP, Free, State, rhs

    z = np.array([0.0, SPEED, ratio * SPEED, 0.0, 0.0, course_rate * SPEED])
    free, n, h = Free(0.0), ceil(dt / SUBSTEP), 1e-4

    def flow(z: Array) -> Array:
        return np.array(rk4(rhs, State(*[*z.tolist(), 0.0, 0.0]), free, free, gains, dt, n)[:6])

    F = np.column_stack([(flow(z + h * e) - flow(z - h * e)) / (2.0 * h) for e in np.eye(6)])
    L = np.kron(np.eye(2), np.array(chain_gains(gains.L1, gains.L2, gains.L3, dt))[:, None])
    S = np.tile([1.0, PACE, PACE**2], 2)
    scaled: Array = S[:, None] * ((np.eye(6) - L @ np.eye(6)[[0, 3]]) @ F) / S
    return scaled


@cache
def certificate(gains: Any) -> Certificate:
    """One P for the whole grid; whether it holds is for `Certificate.margin` to say."""
    ratios, rates = (np.linspace(-most, most, POINTS) for most in (RATIO, COURSE_RATE))
    wide = gains._replace(c_max=1e3)
    return Certificate(
        observer="high_gain",
        form="sampled",
        matrices=np.array([jacobian(wide, *at) for at in product(ratios.tolist(), rates.tolist(), DTS)]),
        P=np.kron(np.eye(2), P3),
        rate=RATE,
        region={
            "acceleration / speed [1/s]": (-RATIO, RATIO),
            "course rate [rad/s]": (-COURSE_RATE, COURSE_RATE),
            "time step, one of 0.05, 0.10, 0.15, 0.20 [s]": (DTS[0], DTS[-1]),
        },
        assumptions=(
            f"Checked on a grid of {POINTS} x {POINTS} states; between its points not proven.",
            "Every state on the line between estimate and truth is within the region.",
            "The speed is above `floor`; course rate, speed, acceleration and innovation are not limited.",
            "Positions are the only output: turn = 0; the yaw, which follows the course, is not part of it.",
            "Jerk along the course and rate of the slip are disturbances.",
        ),
    )
