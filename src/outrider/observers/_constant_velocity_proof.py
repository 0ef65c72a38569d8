"""What is claimed of the constant-velocity observer: continuous, over a window; sampled, for every heading.

Sampled: errors are truth minus estimate, the position in the frame of the estimated course, course and slip.
Over a step of dt, course errors within D, the exact error dynamics before the correction is

    p -> R(-d) p + V dt (n e_chi + V dt / (2 l_r) k m e_beta),   e_chi -> e_chi + V dt / l_r k e_beta

d: turn of the frame. k: mean value of cos(beta). n, m: means of sin(e/2)/(e/2) (-sin, cos) of the course half
way between truth and estimate, at most D / 2 and the turn off the frame. All enter apart from each other, so
the corners of their ranges span every case.
"""

from __future__ import annotations

from itertools import product
from math import cos, pi, sin
from typing import Any

import numpy as np

from outrider import family as polytopes
from outrider.certificate import Array
from outrider.claim import CONTINUOUS, ON_THE_LINE, WITHOUT_HOLD, Claim, Sought
from outrider.errors import InputError
from outrider.family import Family
from outrider.inequalities import SLIP, Form

PACE = 0.3  # [s]: errors are weighed as 1 m, 1 m / V / PACE and 1 m l_r / (V PACE)^2


def family(gains: Any, dt: float, window: float, turn: float) -> tuple[Array, Array]:
    """Error matrices (128, 4, 4) over a step of dt [s], correction to correction, and gain (4, 2); scaled."""
    from outrider.observers.constant_velocity import SLIP_MAX, sampled

    V, l_r, k = gains.speed, gains.l_r, sampled(dt, gains)
    correct = np.eye(4)
    correct[:, 0] -= [k.x, 0.0, 0.0, 0.0]
    correct[:, 1] -= [0.0, k.y, k.chi / V, k.beta * l_r / V**2]
    turn = turn * dt
    off = 0.5 * window + turn
    least = sin(0.5 * window) / (0.5 * window)
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
    return np.array(out), S[:, None] * (correct[:, :2] - np.eye(4, 2))


def claim(gains: Any, form: Form = "sampled", **asked: Any) -> Claim:
    """Claim for `constant_velocity.Gains`; `asked`: arguments of `_continuous` or `_sampled`."""
    if form not in ("continuous", "sampled"):
        raise InputError(f"constant_velocity has no proof in {form!r} form; want continuous or sampled")
    return _continuous(gains, **asked) if form == "continuous" else _sampled(gains, **asked)


def _continuous(
    gains: Any,
    speed: tuple[float, float] | None = None,
    window: float = pi / 5.0,
    yaw_rate: float = 0.5,
    slip: float = SLIP,
) -> Claim:
    """At speeds [m/s], courses within `window` [rad] of the frame, which turns at up to `yaw_rate` [rad/s].

    The gain turns with the frame; nothing is proven to be the same at all of the speeds but the gain.
    InputError for a speed or window that is not positive, or a window beyond a right angle.
    """
    speeds = (gains.speed, gains.speed) if speed is None else speed
    if not (0.0 < speeds[0] <= speeds[1] < np.inf and 0.0 < window < 0.5 * pi and yaw_rate >= 0.0):
        raise InputError(
            f"speeds {speeds[0]:g} to {speeds[1]:g} m/s, window {window:g} rad, yaw rate {yaw_rate:g}; want "
            "0 < low <= high, a window below pi/2 and a rate of 0 or more: no proof crosses standstill"
        )
    F, corners = polytopes.constant_velocity(sorted(set(speeds)), window, yaw_rate, gains.l_r, slip)
    T = np.array([1.0, 1.0, 0.2, 0.1])
    L = np.array([[gains.L_x, 0.0], [0.0, gains.L_y], [0.0, gains.L_psi], [0.0, gains.L_beta]])
    A = (F - L @ np.eye(2, 4)) / T[:, None] * T
    B = np.repeat((-L / T[:, None])[None], len(A), axis=0)
    return Claim(
        "constant_velocity",
        "continuous",
        Family(A, corners),
        {
            "speed [m/s]": speeds,
            "course minus that of the frame [rad]": (-window, window),
            "yaw rate [rad/s]": (-yaw_rate, yaw_rate),
        },
        (
            "The speed is given exactly.",
            f"The slip is constant, within {np.degrees(slip):g} degrees; its changes act like a disturbance.",
            "Positions are the only output: heading = 0.",
            ON_THE_LINE,
            CONTINUOUS,
            WITHOUT_HOLD,
        ),
        {"speed": speeds, "window": window, "yaw_rate": yaw_rate, "slip": slip},
        sought=(
            Sought("position", "position", A, B, np.eye(2, 4)),
            Sought("course", "position", A, B, np.array([[0.0, 0.0, T[2], T[3]]])),
        ),
    )


def _sampled(
    gains: Any,
    window: float = pi / 3.0,
    turn: float = 1.0,
    dt: tuple[float, ...] = (0.05, 0.1, 0.15, 0.2, 0.25),
) -> Claim:
    """For course errors within `window` [rad], an estimate turning at up to `turn` [rad/s], steps dt [s]."""
    made = [family(gains._replace(speed_chain=0.0), h, window, turn) for h in dt]
    A = np.concatenate([matrices for matrices, _ in made])
    B = np.concatenate([np.repeat(L[None], len(matrices), axis=0) for matrices, L in made])
    each = len(A) // len(dt)
    names = tuple(f"step of {h:g} s, corner {i}" for h in dt for i in range(each))
    return Claim(
        "constant_velocity",
        "sampled",
        Family(A, names),
        {
            "speed [m/s]": (gains.speed, gains.speed),
            f"time step, one of {', '.join(f'{h:g}' for h in dt)} [s]": (min(dt), max(dt)),
            "error of the course [rad]": (-window, window),
            "turn of the estimated course [rad/s]": (-turn, turn),
        },
        (
            "The speed is given exactly: speed_chain = 0, and the vehicle keeps it.",
            "The gain turns with the course: switched = 0.",
            "The slip is constant and within 20 degrees; what it changes acts like a disturbance.",
            "Positions are the only output: heading = 0; nothing is missing or limited.",
        ),
        {"window": window, "turn": turn, "dt": dt},
        sought=(
            Sought("position", "position", A, B, np.eye(2, 4)),
            Sought("course", "position", A, B, np.array([[0.0, 0.0, 1.0 / (gains.speed * PACE), 0.0]])),
        ),
    )
