"""Proof of the multi-stage observer as a whole: speed, orientation and position in one Lyapunov function.

The numbers were found by `outrider.design.multi_stage`; `certificate(gains).margin()` checks them anew.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np
import numpy.typing as npt

from outrider import family
from outrider.certificate import Bound, Certificate, peak
from outrider.family import Family
from outrider.inequalities import SLIP, chain
from outrider.observers import multi_stage

Array = npt.NDArray[np.float64]

RATE = 0.05  # decay of all errors [1/s]
MISMATCH = 0.1  # how far the true speed may be outside the span of the entry in use [-]

# Lower halves of the blocks of P, states scaled as in `family`: (S, V, A, J), (psi, beta), each coordinate.
PUBLISHED = (
    (0.6952, -0.2172, 0.2615, -0.2651, -0.007916, 0.2049, 0.02164, -0.1913, -0.03406, 0.8983),
    (0.08012, -0.004654, 0.01624),
    (2.508e-4,),
)
OURS = (
    (
        1.0,
        -0.21637,
        0.154678,
        -0.157672,
        -0.00225327,
        0.0497734,
        0.00550699,
        -0.0467318,
        -0.00419056,
        0.0983357,
    ),
    (0.0879597, -0.00623151, 0.0146476),
    (0.000347559,),
)
BLOCKS = ((range(4),), ((4, 5),), ((6,), (7,)))  # the states of each block
ASSUMPTIONS = (
    f"The true speed is within {100.0 * MISMATCH:g} % of the span of the table's entry in use.",
    "The vehicle goes forward.",
    "Jerk and slip are constant, the slip within 20 degrees; what they change acts like a disturbance.",
    "The measurement runs along the line between two samples, and the equations are integrated exactly.",
    "Every sample is used: none is missing, held or limited.",
)


def certificate(gains: Any) -> Certificate:
    """What is claimed for these gains; proven for the default ones and for DESIGNED, check it for others."""
    halves, P = (OURS if gains.table > 0.5 else PUBLISHED), np.zeros((8, 8))
    for group, half in zip(BLOCKS, halves, strict=True):
        for states in group:
            i, j = np.tril_indices(len(states))
            first = states[0]
            P[first + i, first + j] = P[first + j, first + i] = half
    return claim(gains, P, RATE)


def claim(gains: Any, P: Array, rate: float) -> Certificate:
    """Certificate of the whole cascade with P (8, 8) and a rate [1/s]; not checked."""
    return Certificate(
        "multi_stage",
        "continuous",
        errors(gains).matrices,
        P,
        rate,
        {
            "speed [m/s]": (multi_stage.NOMINAL[0], multi_stage.NOMINAL[-1]),
            "slip [rad]": (-SLIP, SLIP),
            "gain on the heading [1/s]": (0.0, gains.heading),
        },
        ASSUMPTIONS,
        _bounds(speed_gain(gains)),
    )


def errors(gains: Any) -> Family:
    """Error dynamics of the whole cascade with these gains."""
    m, k = multi_stage, gains.orientation
    psi, beta = (m.OUR_PSI, m.OUR_BETA) if gains.table > 0.5 else (m.L_PSI, m.L_BETA)
    table = family.Table(m.NOMINAL, [k * g for g in psi], [k * g for g in beta])
    return family.multi_stage(speed_gain(gains), table, gains.L_w, gains.heading, MISMATCH, gains.l_r)


def speed_gain(gains: Any) -> list[float]:
    """L_s (4,) of the speed chain in use."""
    chain_of = (gains.L_S, gains.L_V, gains.L_A, gains.L_J)
    return [g * gains.speed**power for power, g in enumerate(chain_of, 1)]


def _bounds(L_s: list[float]) -> tuple[Bound, ...]:
    """Of speed and acceleration by the error of the measured path: exact, since this stage is linear."""
    L, one, bounds = np.array(L_s)[:, None], np.eye(4), []
    A = chain(4) - L @ one[:1]
    for of, C in (("speed", one[1:2]), ("acceleration", one[2:3])):
        gain = peak(A, -L, C, "continuous")
        if isfinite(gain):
            bounds.append(Bound(of, "path", gain, True, "peak", A[None], -L[None], C))
    return tuple(bounds)
