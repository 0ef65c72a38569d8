"""Gains of the multi-stage observer, stage by stage, each with a proof of its own."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np
import numpy.typing as npt

from outrider import family
from outrider.certificate import Certificate
from outrider.claim import CONTINUOUS, WITHOUT_HOLD, Claim, Sought
from outrider.design._solve import Design, Solved
from outrider.design.prove import prove
from outrider.design.synthesis import Entry, Weights, rounded, synthesise
from outrider.family import Family, Line, Point, Table
from outrider.inequalities import SLIP

Array = npt.NDArray[np.float64]
Pair = tuple[float, float]

ORIENTATION = Weights(np.ones((1, 2)), np.eye(2), np.eye(2, 1), 36.0)  # 36: as in [MS 58]


def speed(rate: float = 0.4, fastest: float = 5.0, gain_bound: float | None = None) -> Design:
    """Gain (4,) of the speed chain [1/s to 1/s4]: least energy of speed and acceleration errors, [MS 36].

    rate: decay [1/s]; fastest: no pole further from 0 [1/s]. Bounds on speed and acceleration by the path's
    error, exact, and the energy bound with its P. NotCertified where there is none.
    """
    weights = Weights(np.eye(1, 4), np.eye(4)[1:3], np.zeros((4, 0)))
    entry = Entry(family.speed_chain(), rate, fastest)
    scale = sqrt(max(rate, 0.01 * fastest) * fastest) ** np.arange(4.0)
    gains, _, _, said = synthesise([entry], weights, scale=scale, gain_bound=gain_bound)
    return certify_speed(rounded(gains[0])[:, 0], rate, said)


def certify_speed(gain: Sequence[float] | Array, rate: float, said: Solved | None = None) -> Design:
    """Proof of a given gain (4,) of the speed chain at a decay rate [1/s], with its bounds."""
    L, one = np.asarray(gain, float).reshape(4, 1), np.eye(4)
    T = float(np.abs(L[3, 0])) ** (0.25 * np.arange(4.0))
    A, B, C = (
        ((family.speed_chain()[0] - L @ one[:1]) / T[:, None] * T)[None],
        (-L / T[:, None])[None],
        np.diag(T),
    )
    claim = Claim(
        "multi_stage: speed",
        "continuous",
        Family(A, ("the one matrix there is",)),
        {},
        ("The jerk is constant; what it changes acts like a disturbance.", CONTINUOUS),
        {},
        sought=(
            Sought("speed", "path", A, B, C[1:2]),
            Sought("acceleration", "path", A, B, C[2:3]),
            Sought("(speed, acceleration)", "path", A, B, C[1:3], "energy"),
        ),
    )
    certificate, (energy,), solved = prove(claim, rate)
    return Design(L[:, 0], certificate, said or solved, energy.gain)


def table(
    speeds: Sequence[float],
    rate: Pair = (0.1, 0.03),
    fastest: Pair = (1.5, 0.5),
    mismatch: float = 0.1,
    l_r: float = 2.0,
    slip: float = SLIP,
) -> Design:
    """Orientation gains (k, 2) [1/s] for nominal speeds (k,) [m/s], [MS 58] with the tight sector condition.

    Decay rate and limit of the poles are a + b V at the nominal speed V: pairs ([1/s], [1/m]). All entries
    share one P, so the table may be switched at will (E11) while the true speed is within `mismatch` of the
    entry's span. Weighed are the errors of yaw and slip against the course's error and the speed's, as in the
    paper. NotCertified where there is no proof.
    """
    spans = Table(speeds, (), ()).spans(mismatch)
    entries = [
        Entry(family.orientation(*span, l_r, slip), rate[0] + rate[1] * v, fastest[0] + fastest[1] * v)
        for v, span in zip(speeds, spans, strict=True)
    ]
    gains, _, noise, solved = synthesise(entries, ORIENTATION)
    L = np.array([rounded(g)[:, 0] for g in gains])
    made = Table(list(speeds), list(L[:, 0]), list(L[:, 1]))
    certificate = certify_schedule(made.points(mismatch), min(e.rate for e in entries), l_r, slip)
    return Design(L, certificate, solved, max(noise))


def line(
    low: float,
    high: float,
    rate: Pair = (0.05, 0.03),
    fastest: Pair = (1.0, 0.25),
    mismatch: float = 0.1,
    l_r: float = 2.0,
    slip: float = SLIP,
    gain_bound: float | None = None,
) -> Design:
    """Orientation gains (2, 2) a [1/s] and b [1/m] of psi and beta: a + b V from `low` to `high` [m/s].

    Model, gain, rate and limit of the poles are affine in the speed, so both ends prove all in between and
    nothing switches; true and estimated speed may differ by `mismatch` [-]. Else as `table`.
    """
    entries = [
        Entry(
            family.orientation(v * (1.0 - mismatch), v * (1.0 + mismatch), l_r, slip),
            rate[0] + rate[1] * v,
            fastest[0] + fastest[1] * v,
        )
        for v in (low, high)
    ]
    gains, _, noise, solved = synthesise(entries, ORIENTATION, gain_bound=gain_bound)
    first, last = (g[:, 0] for g in gains)
    slope = (last - first) / (high - low)
    L = rounded(np.column_stack([first - slope * low, slope]))
    made = Line(low, high, *map(tuple, L.tolist()))
    certificate = certify_schedule(made.points(mismatch), min(e.rate for e in entries), l_r, slip)
    return Design(L, certificate, solved, max(noise))


def certify_schedule(
    points: Sequence[Point], rate: float, l_r: float = 2.0, slip: float = SLIP
) -> Certificate:
    """Proof, by one P, that orientation gains may change among these points at will, at a rate [1/s]."""
    speeds = [p.speed for p in points]
    claim = Claim(
        "multi_stage: orientation",
        "continuous",
        family.orientation_errors(points, l_r, slip),
        {"speed [m/s]": (min(speeds), max(speeds))},
        (
            "The true speed is as near to what chooses the gain as the points say.",
            f"The slip is constant, within {np.degrees(slip):g} degrees; its changes act like a disturbance.",
            CONTINUOUS,
            WITHOUT_HOLD,
        ),
        {},
    )
    return prove(claim, rate)[0]


def position(rate: float = 10.0, fastest: float = 20.0, gain_bound: float | None = None) -> Design:
    """Gain (2, 2) of the position observer [1/s], [MS 70]: least energy of errors of velocity and sensor."""
    one = np.eye(2)
    entry = Entry(np.zeros((1, 2, 2)), rate, fastest)
    gains, _, noise, said = synthesise([entry], Weights(one, one, one), axes=2, gain_bound=gain_bound)
    L = rounded(gains[0])
    A, B = -L[None], np.hstack([one, -L])[None]
    claim = Claim(
        "multi_stage: position",
        "continuous",
        Family(A, ("the one matrix there is",)),
        {},
        (CONTINUOUS,),
        {},
        sought=(Sought("position", "(velocity, position)", A, B, one, "energy"),),
    )
    certificate, _, _ = prove(claim, rate)
    return Design(L, certificate, said, noise[0])
