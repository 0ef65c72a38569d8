"""Proof that the sampled constant-velocity observer forgets its errors, for every heading.

Errors are truth minus estimate: the position in the frame of the estimated course, course and slip. Over a
step of dt, course errors within D, the exact error dynamics before the correction is

    p -> R(-d) p + V dt (n e_chi + V dt / (2 l_r) k m e_beta),   e_chi -> e_chi + V dt / l_r k e_beta

d: turn of the frame. k: mean value of cos(beta). n, m: means of sin(e/2)/(e/2) (-sin, cos) of the course half
way between truth and estimate, at most D / 2 and the turn off the frame. All enter apart from each other, so
the corners of their ranges span every case.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from math import cos, pi, sin
from typing import Any

import numpy as np

from outrider.certificate import Array, Certificate

DTS = (0.05, 0.1, 0.15, 0.2, 0.25)  # steps [s]
WINDOW = pi / 3.0  # largest error of the course, D [rad]
TURN = 1.0  # largest rate at which the estimated course turns, corrections included [rad/s]
RATE = 0.96  # of decay by a step [-]
PACE = 0.3  # [s]: errors are weighed as 1 m, 1 m / V / PACE and 1 m l_r / (V PACE)^2
P = np.array(
    [
        [0.1566, 0.0, 0.0, 0.0],
        [0.0, 0.5161, -0.1855, -0.0648],
        [0.0, -0.1855, 0.2673, -0.3231],
        [0.0, -0.0648, -0.3231, 0.8569],
    ]
)


def family(gains: Any, dt: float) -> Array:
    """Error matrices (128, 4, 4) over a step of dt [s], from correction to correction, in scaled errors."""
    from outrider.observers.constant_velocity import SLIP_MAX, sampled

    V, l_r, k = gains.speed, gains.l_r, sampled(dt, gains)
    correct = np.eye(4)
    correct[:, 0] -= [k.x, 0.0, 0.0, 0.0]
    correct[:, 1] -= [0.0, k.y, k.chi / V, k.beta * l_r / V**2]
    turn = TURN * dt
    off = 0.5 * WINDOW + turn
    least = sin(0.5 * WINDOW) / (0.5 * WINDOW)
    normals = list(product((-sin(off), sin(off)), (least * cos(off), 1.0)))
    S = np.array([1.0, 1.0, V * PACE, (V * PACE) ** 2 / l_r])
    out = []
    for n, m, slope, c, s in product(
        normals, normals, (cos(SLIP_MAX), 1.0), (cos(turn), 1.0), (-sin(turn), sin(turn))
    ):
        A = np.eye(4)
        A[:2, :2] = [[c, s], [-s, c]]
        A[:2, 2] = V * dt * np.array(n)
        A[:2, 3] = (V * dt) ** 2 / (2.0 * l_r) * slope * np.array(m)
        A[2, 3] = V * dt / l_r * slope
        out.append(S[:, None] * (correct @ A) / S)
    return np.array(out)


@cache
def certificate(gains: Any) -> Certificate:
    """One P for all corners and steps; whether it holds is for `Certificate.margin` to say."""
    return Certificate(
        observer="constant_velocity",
        form="sampled",
        matrices=np.concatenate([family(gains._replace(speed_chain=0.0), dt) for dt in DTS]),
        P=P,
        rate=RATE,
        region={
            "speed [m/s]": (gains.speed, gains.speed),
            "time step, one of 0.05, 0.10, 0.15, 0.20, 0.25 [s]": (DTS[0], DTS[-1]),
            "error of the course [rad]": (-WINDOW, WINDOW),
            "turn of the estimated course [rad/s]": (-TURN, TURN),
        },
        assumptions=(
            "The speed is given exactly: speed_chain = 0, and the vehicle keeps it.",
            "The gain turns with the course: switched = 0.",
            "The slip is constant and within 20 degrees; what it changes acts like a disturbance.",
            "Positions are the only output: heading = 0; nothing is missing or limited.",
        ),
    )
