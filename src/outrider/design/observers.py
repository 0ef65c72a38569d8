"""Gains for each observer of the package: its model and region go to `synthesise`, its proof to `prove`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from outrider import family
from outrider.certificate import Certificate
from outrider.design._solve import Design, Solved
from outrider.design.bounds import bound, exact
from outrider.design.prove import prove, refuse_unstable
from outrider.design.synthesis import Entry, rounded, synthesise
from outrider.family import Family, Table
from outrider.inequalities import alike
from outrider.observers import _cascade

Array = npt.NDArray[np.float64]

NO_JERK = "The jerk is constant; what it changes acts like a disturbance."
NO_SLIP = "The slip is constant and within 20 degrees; what it changes acts like a disturbance."
ON_THE_LINE = "Every state on the line between estimate and truth is within the region."
WITHOUT_HOLD = "Every sample is used: nothing is missing, held or limited."
CONTINUOUS = "The observer runs in continuous time; between two samples the measurement is on their line."


def speed(rate: float = 0.4, fastest: float = 5.0) -> Design:
    """Gain (4,) of the speed chain [1/s to 1/s4]: least energy of speed and acceleration errors, [MS 36].

    rate: decay [1/s]; fastest: no pole further from 0 [1/s]. Bounds on speed and acceleration by the path's
    error, exact, and the energy bound with its P. NotCertified where there is none.
    """
    F, H, C, T = family.speed_chain()[0], np.eye(1, 4), np.eye(4)[1:3], _powers(np.sqrt(rate * fastest), 4)
    gains, _, _, solved = synthesise([Entry(F[None], rate, fastest)], H, C, scale=T)
    L = rounded(gains[0])
    return certify_speed(L[:, 0], rate, solved)


def certify_speed(gain: Sequence[float] | Array, rate: float, said: Solved | None = None) -> Design:
    """Proof of a given gain (4,) of the speed chain at a decay rate [1/s], with its bounds."""
    L = np.asarray(gain, float).reshape(4, 1)
    T = _powers(float(np.abs(L[3, 0])) ** 0.25, 4)
    A = (family.speed_chain()[0] - L @ np.eye(1, 4)) / T[:, None] * T
    B, C = -L / T[:, None], np.diag(T)
    energy = bound("(speed, acceleration)", "path", A[None], B[None], C[1:3], kind="energy")
    bounds = (exact("speed", "path", A, B, C[1:2]), exact("acceleration", "path", A, B, C[2:3]), energy)
    certificate, solved = prove(
        "multi_stage: speed",
        Family(A[None], ("the one matrix there is",)),
        rate,
        region={},
        assumptions=(NO_JERK, CONTINUOUS),
        bounds=bounds,
    )
    return Design(L[:, 0], certificate, said or solved, energy.gain)


def table(
    speeds: Sequence[float],
    rate: tuple[float, float] = (0.1, 0.03),
    fastest: tuple[float, float] = (1.5, 0.5),
    mismatch: float = 0.1,
    l_r: float = 2.0,
) -> Design:
    """Orientation gains (k, 2) [1/s] for nominal speeds (k,) [m/s], [MS 58] with the tight sector condition.

    Decay rate and limit of the poles are a + b V at the nominal speed V: pairs ([1/s], [1/m]). All entries
    share one P, so the table may be switched at will (E11) while the true speed is within `mismatch` of the
    entry's span. Weighed are the errors of yaw and slip against the course's error and the speed's, as in the
    paper. NotCertified where there is no proof.
    """
    entries = [
        Entry(family.orientation(*span, l_r), rate[0] + rate[1] * v, fastest[0] + fastest[1] * v)
        for v, span in zip(speeds, family.spans(speeds, mismatch), strict=True)
    ]
    H, G = np.ones((1, 2)), np.eye(2, 1)
    gains, _, noise, solved = synthesise(entries, H, np.eye(2), G=G, weight=36.0)
    L = np.array([rounded(g)[:, 0] for g in gains])
    made = Table(list(speeds), list(L[:, 0]), list(L[:, 1]))
    certificate = certify_table(made, min(e.rate for e in entries), mismatch, l_r)
    return Design(L, certificate, solved, max(noise))


def certify_table(table: Table, rate: float, mismatch: float = 0.1, l_r: float = 2.0) -> Certificate:
    """Proof, by one P, that a table of orientation gains may be switched at will at a decay rate [1/s]."""
    matrices, corners = [], []
    spans = family.spans(table.speed, mismatch)
    for v, psi, beta, span in zip(*table, spans, strict=True):
        for F in family.orientation(*span, l_r):
            matrices.append(F - np.array([[psi], [beta]]) @ np.ones((1, 2)))
            corners.append(f"entry {v:g} m/s, slope times speed {F[0, 1] * l_r:.3g} m/s")
    certificate, _ = prove(
        "multi_stage: orientation",
        Family(np.array(matrices), tuple(corners)),
        rate,
        region={"speed [m/s]": (min(table.speed), max(table.speed))},
        assumptions=(_mismatch(mismatch), NO_SLIP, CONTINUOUS, WITHOUT_HOLD),
    )
    return certificate


def position(rate: float = 10.0, fastest: float = 20.0) -> Design:
    """Gain (2, 2) of the position observer [1/s], [MS 70]: least energy of errors of velocity and sensor."""
    one = np.eye(2)
    entry = Entry(np.zeros((1, 2, 2)), rate, fastest)
    gains, _, noise, solved = synthesise([entry], one, one, G=one, axes=2)
    L = rounded(gains[0])
    A, B = -L[None], np.hstack([one, -L])[None]
    energy = bound("position", "(velocity, position)", A, B, one, kind="energy")
    certificate, _ = prove(
        "multi_stage: position", Family(A, ("the one matrix there is",)), rate, region={},
        assumptions=(CONTINUOUS,), bounds=(energy,),
    )  # fmt: skip
    return Design(L, certificate, solved, noise[0])


def multi_stage(gains: Any, rate: float = _cascade.RATE) -> Certificate:
    """One proof for the whole cascade with given `multi_stage.Gains`, table switched at will, rate [1/s].

    The heading of the rectangle may correct with any gain from 0 to `gains.heading`.
    """
    claim = _cascade.claim(gains, np.eye(8), rate)
    certificate, _ = prove(
        "multi_stage",
        _cascade.errors(gains),
        rate,
        blocks=_cascade.BLOCKS,
        region=claim.region,
        assumptions=claim.assumptions,
        bounds=claim.bounds,
    )
    return certificate


def high_gain(
    speed: float = 2.0,
    acceleration: float = 3.0,
    yaw_rate: float = 1.0,
    *,
    rate: float = 1.0,
    fastest: float = 15.0,
    gain: Sequence[float] | None = None,
) -> Design:
    """Gain (3,) per axis of the high-gain observer [1/s, 1/s2, 1/s3], or the proof of a given one.

    Proven for every state faster than `speed` [m/s] with |acceleration| along the course [m/s2] and |course
    rate| [rad/s] within the given ones, at a decay rate [1/s]; no pole is faster than `fastest` [1/s] for any
    corner. Weighed is the velocity's error against the position's. NotCertified where there is no proof.
    """
    F, _ = family.companion(speed, acceleration, yaw_rate)
    said = None
    if gain is None:
        C, H = alike(np.eye(3)[1:2]), alike(np.eye(1, 3))
        T = np.tile(_powers(fastest / 3.0, 3), 2)
        gains, _, _, said = synthesise([Entry(F, rate, fastest)], H, C, axes=2, scale=T)
        gain = rounded(gains[0][:3, 0]).tolist()
    frozen = family.frozen_high_gain(gain, speed, acceleration, yaw_rate)
    refuse_unstable("high_gain", frozen, rate, "continuous", "no proof can exist")
    certificate, solved = prove(
        "high_gain",
        family.high_gain(gain, speed, acceleration, yaw_rate),
        rate,
        blocks=[[range(3), range(3, 6)]],
        region={
            "speed [m/s]": (speed, 70.0),
            "acceleration [m/s2]": (-acceleration, acceleration),
            "yaw rate [rad/s]": (-yaw_rate, yaw_rate),
        },
        assumptions=(ON_THE_LINE, CONTINUOUS, WITHOUT_HOLD),
    )
    return Design(np.asarray(gain, float), certificate, said or solved)


def constant_velocity(
    speeds: Iterable[float],
    window: float = 75.0 * pi / 180.0,
    yaw_rate: float = 0.5,
    *,
    rate: float = 0.5,
    fastest: float = 20.0,
    l_r: float = 2.0,
    gain: Array | None = None,
) -> Design:
    """Gain (4, 2) [1/s, rad/(m s)] in a frame that turns with the estimate, or the proof of a given one.

    For given speeds [m/s], a true course within `window` [rad] of the frame (the estimated yaw or course),
    and a frame that turns at up to `yaw_rate` [rad/s]. Mirroring left and right changes nothing, so the gains
    from x to the rest and from y to x are 0. Weighed are the errors of yaw and slip against the position's.
    NotCertified where there is no proof.
    """
    speeds = list(speeds)
    F, corners = family.constant_velocity(speeds, window, yaw_rate, l_r)
    T, H, C = np.array([1.0, 1.0, 0.2, 0.1]), np.eye(2, 4), np.eye(4)[2:]
    said = None
    if gain is None:
        gains, _, _, said = synthesise([Entry(F, rate, fastest)], H, C, scale=T)
        free = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0], [0.0, 1.0]])
        gain = rounded(gains[0] * free) + 0.0  # no minus zeros
    L = np.asarray(gain, float)
    certificate, solved = prove(
        "constant_velocity",
        Family((F - L @ H) / T[:, None] * T, corners),
        rate,
        region={
            "speed [m/s]": (min(speeds), max(speeds)),
            "course minus that of the frame [rad]": (-window, window),
            "yaw rate [rad/s]": (-yaw_rate, yaw_rate),
        },
        assumptions=("The speed is given exactly.", NO_SLIP, ON_THE_LINE, CONTINUOUS, WITHOUT_HOLD),
    )
    return Design(L, certificate, said or solved)


def _powers(pace: float, n: int) -> Array:
    """Sizes (n,) of position, speed, ... that change at a pace [1/s]."""
    return np.asarray(pace, float) ** np.arange(n)


def _mismatch(mismatch: float) -> str:
    return f"The true speed is within {100.0 * mismatch:g} % of the span of the table's entry in use."
