"""What is claimed of the high-gain observer: continuous, over corners; sampled, on a grid of states.

Both look at the error in the frame of the velocity. The observer commutes with turning the world and with
scaling all lengths, and so does the norm e'Pe with P = I2 (x) P3. So the Jacobian is needed at one course
only, and depends on acceleration over speed, course rate and dt.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from math import ceil
from typing import Any

import numpy as np

from outrider import family
from outrider.certificate import Array
from outrider.claim import CONTINUOUS, ON_THE_LINE, WITHOUT_HOLD, Claim, Sought
from outrider.errors import InputError
from outrider.family import Family
from outrider.inequalities import Form, alike
from outrider.kernel import rk4

BLOCKS = ((range(3), range(3, 6)),)  # both axes alike: the frame may turn
ERRORS = "position", "velocity", "acceleration"
POINTS = 7  # of the grid, each way
PACE = 0.3  # [s]: errors of the sampled form are weighed as 1 m, 1 m / PACE, 1 m / PACE^2
SPEED = 10.0  # at which the Jacobian is taken [m/s]


def claim(gains: Any, form: Form = "sampled", **asked: Any) -> Claim:
    """Claim for `high_gain.Gains` in either form; `asked`: the arguments of `_continuous` or `_sampled`."""
    if form not in ("continuous", "sampled"):
        raise InputError(f"high_gain has no proof in {form!r} form; want continuous or sampled")
    return _continuous(gains, **asked) if form == "continuous" else _sampled(gains, **asked)


def _continuous(gains: Any, speed: float = 5.0, acceleration: float = 3.0, yaw_rate: float = 0.4) -> Claim:
    """For every state faster than `speed` [m/s] within `acceleration` [m/s2] and `yaw_rate` [rad/s].

    Position, velocity and acceleration are bounded by the position's error, as lengths of vectors.
    InputError for a region down to standstill or a gain that is not finite.
    """
    L = [gains.L1, gains.L2, gains.L3]
    made = family.high_gain(L, speed, acceleration, yaw_rate)
    pace = float(max(abs(L[2]), 1e-9)) ** (1.0 / 3.0)
    T = pace ** np.arange(3.0)
    return Claim(
        "high_gain",
        "continuous",
        made,
        {
            "speed [m/s]": (speed, 70.0),
            "acceleration [m/s2]": (-acceleration, acceleration),
            "course rate [rad/s]": (-yaw_rate, yaw_rate),
        },
        (
            ON_THE_LINE,
            CONTINUOUS,
            WITHOUT_HOLD,
            "Positions are the only output: turn = 0; the yaw, which follows the course, is not part of it.",
            "Jerk along the course and rate of the slip are disturbances.",
        ),
        {"speed": speed, "acceleration": acceleration, "yaw_rate": yaw_rate},
        BLOCKS,
        _sought(made.matrices, [-np.array(L) / T] * len(made.matrices), T),
        family.frozen_high_gain(L, speed, acceleration, yaw_rate),
    )


def _sampled(
    gains: Any,
    ratio: float = 0.15,
    course_rate: float = 0.2,
    dt: tuple[float, ...] = (0.05, 0.1, 0.15, 0.2),
) -> Claim:
    """For |acceleration / speed| [1/s] and |course rate| [rad/s] within these, on a grid, at steps dt [s]."""
    if not (ratio >= 0.0 and course_rate >= 0.0 and min(dt) > 0.0):
        raise InputError(f"ratio {ratio:g}, course rate {course_rate:g}, steps {dt}; want positive numbers")
    ratios, rates = (np.linspace(-most, most, POINTS).tolist() for most in (ratio, course_rate))
    at = list(product(ratios, rates, dt))
    made = [_step(gains._replace(c_max=1e3), *point) for point in at]
    names = tuple(f"acceleration / speed {r:.3g} 1/s, course rate {k:.3g} rad/s, {h:g} s" for r, k, h in at)
    matrices, inputs = np.array([A for A, _ in made]), [B for _, B in made]
    return Claim(
        "high_gain",
        "sampled",
        Family(matrices, names),
        {
            "acceleration / speed [1/s]": (-ratio, ratio),
            "course rate [rad/s]": (-course_rate, course_rate),
            f"time step, one of {', '.join(f'{h:g}' for h in dt)} [s]": (min(dt), max(dt)),
        },
        (
            f"Checked on a grid of {POINTS} x {POINTS} states; between its points not proven.",
            ON_THE_LINE,
            "The speed is above `floor`; course rate, speed, acceleration and innovation are not limited.",
            "Positions are the only output: turn = 0; the yaw, which follows the course, is not part of it.",
            "Jerk along the course and rate of the slip are disturbances.",
        ),
        {"ratio": ratio, "course_rate": course_rate, "dt": dt},
        BLOCKS,
        _sought(matrices, inputs, PACE ** -np.arange(3.0)),
    )


def _sought(A: Array, inputs: list[Array], T: Array) -> tuple[Sought, ...]:
    """Lengths of the errors of position, velocity and acceleration; T (3,): what a scaled error counts."""
    B = np.array([alike(b[:, None]) for b in inputs])
    return tuple(
        Sought(of, "position", A, B, alike(T[i] * np.eye(3)[[i]]), blocks=BLOCKS)
        for i, of in enumerate(ERRORS)
    )


@cache
def _step(gains: Any, ratio: float, course_rate: float, dt: float) -> tuple[Array, Array]:
    """Scaled Jacobian of a step (6, 6) at acceleration / speed [1/s] and course rate, and the gain (3,)."""
    from outrider.observers._sampled import chain_gains
    from outrider.observers.high_gain import SUBSTEP, Free, State, rhs

    z = np.array([0.0, SPEED, ratio * SPEED, 0.0, 0.0, course_rate * SPEED])
    free, n, h = Free(0.0), ceil(dt / SUBSTEP), 1e-4

    def flow(z: Array) -> Array:
        return np.array(rk4(rhs, State(*[*z.tolist(), 0.0, 0.0]), free, free, gains, dt, n)[:6])

    F = np.column_stack([(flow(z + h * e) - flow(z - h * e)) / (2.0 * h) for e in np.eye(6)])
    L = np.array(chain_gains(gains.L1, gains.L2, gains.L3, dt))
    S = PACE ** np.arange(3.0)
    M = np.eye(6) - alike(L[:, None]) @ np.eye(6)[[0, 3]]
    return np.tile(S, 2)[:, None] * (M @ F) / np.tile(S, 2), -S * L
