"""Gains for each observer of the package, or a proof for given ones: what goes into a file of gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from outrider import family, observers
from outrider.design import stages
from outrider.design._solve import Design, Solved
from outrider.design.prove import prove
from outrider.design.stages import Pair
from outrider.design.synthesis import Entry, Weights, rounded, synthesise
from outrider.errors import InputError
from outrider.inequalities import SLIP, alike
from outrider.proof_file import ProofFile

Array = npt.NDArray[np.float64]


def certify(
    name: str, gains: Any, form: str, rate: float, asked: Mapping[str, Any], said: Solved | None = None
) -> Design:
    """Proof of an observer's claim for given gains, over the region `asked`, at a rate; with all its bounds.

    form: continuous, rate in 1/s; or sampled, rate the factor of a step. InputError for a region, form or
    observer that makes no claim, NotCertified where there is no proof.
    """
    observer: Any = observers.get(name)
    if not hasattr(observer, "claim"):
        able = [n for n in observers.names() if hasattr(observers.get(n), "claim")]
        raise InputError(f"observer {name} has no constant gain to prove; want one of {', '.join(able)}")
    claim = observer.claim(gains, form, **asked)
    certificate, proofs, solved = prove(claim, rate)
    said = said or solved
    made = {
        "outrider": version("outrider"),
        "solver": said.solver,
        "status": said.status,
        "seconds": round(said.seconds, 3),
        "margin": float(f"{certificate.margin():.3g}"),
    }
    file = ProofFile(name, form, gains._asdict(), claim.asked, rate, certificate.P, proofs, made)
    return Design(np.array(gains), certificate, said, file=file)


def multi_stage(
    speed: Pair = (1.0, 20.0),
    *,
    rear_axle: float = 2.0,
    slip: float = SLIP,
    mismatch: float = 0.1,
    rate: float = 1.0,
    fastest: float = 8.0,
    turn_rate: Pair = (0.05, 0.03),
    turn_fastest: Pair = (1.0, 0.25),
    position_rate: float = 10.0,
    position_fastest: float = 20.0,
    gain_bound: float | None = None,
    whole: float = 0.05,
) -> Design:
    """Gains of all three stages over true speeds [m/s], and one proof of all at the rate `whole` [1/s].

    rate, fastest: of the speed stage [1/s]; turn_*: of the orientation, a + b V ([1/s], [1/m]); position_*:
    of the position [1/s]; gain_bound: norm of each stage's gain; rear_axle: l_r [m]; slip [rad].
    InputError for a region that crosses standstill, NotCertified where a stage or the whole has no proof.
    """
    if not 0.0 < speed[0] < speed[1] < np.inf:
        raise InputError(f"speeds {speed[0]:g} to {speed[1]:g} m/s; want 0 < low < high: no proof crosses 0")
    if not 0.0 < rear_axle < np.inf:
        raise InputError(f"rear axle {rear_axle:g} m behind the centre; want a positive distance")
    chain = stages.speed(rate, fastest, gain_bound)
    turn = stages.line(*speed, turn_rate, turn_fastest, mismatch, rear_axle, slip, gain_bound)
    place = stages.position(position_rate, position_fastest, gain_bound)
    Gains = observers.get("multi_stage").Gains
    gains = Gains(*chain.gain, L_w=place.gain[0, 0], l_r=rear_axle)._replace(
        **dict(zip(("psi_0", "psi_V", "beta_0", "beta_V"), turn.gain.ravel().tolist(), strict=True))
    )
    seconds = sum(d.solved.seconds for d in (chain, turn, place))
    said = chain.solved._replace(seconds=seconds)
    asked = {"speed": speed, "slip": slip, "mismatch": mismatch}
    return certify("multi_stage", Gains(*map(float, gains)), "continuous", whole, asked, said)


def high_gain(
    speed: float = 2.0,
    acceleration: float = 3.0,
    yaw_rate: float = 1.0,
    *,
    rate: float = 1.0,
    fastest: float = 15.0,
    gain_bound: float | None = None,
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
        weights = Weights(alike(np.eye(1, 3)), alike(np.eye(3)[1:2]), np.zeros((6, 0)))
        T = np.tile((fastest / 3.0) ** np.arange(3.0), 2)
        entry = Entry(F, rate, fastest)
        gains, _, _, said = synthesise([entry], weights, axes=2, scale=T, gain_bound=gain_bound)
        gain = rounded(gains[0][:3, 0]).tolist()
    Gains = observers.get("high_gain").Gains
    L = [float(g) for g in gain]
    asked = {"speed": speed, "acceleration": acceleration, "yaw_rate": yaw_rate}
    family.high_gain(L, **asked)  # its message for a gain that is none
    made = Gains(*L, c_max=max(yaw_rate, 0.01), floor=speed)
    return certify("high_gain", made, "continuous", rate, asked, said)


def constant_velocity(
    speeds: Pair | Sequence[float],
    window: float = 75.0 * pi / 180.0,
    yaw_rate: float = 0.5,
    *,
    rate: float = 0.5,
    fastest: float = 20.0,
    rear_axle: float = 2.0,
    slip: float = SLIP,
    gain_bound: float | None = None,
    gain: Sequence[float] | None = None,
) -> Design:
    """Gain L_x, L_y, L_psi, L_beta in a frame that turns with the estimate, or the proof of a given one.

    For speeds between the least and largest given [m/s], a true course within `window` [rad] of the frame
    (the estimated yaw or course), and a frame that turns at up to `yaw_rate` [rad/s]. Mirroring left and
    right changes nothing, so the gains from x to the rest and from y to x are 0. Weighed are the errors of
    yaw and slip against the position's. NotCertified where there is no proof.
    """
    span = (float(min(speeds)), float(max(speeds)))
    asked = {"speed": span, "window": window, "yaw_rate": yaw_rate, "slip": slip}
    observer: Any = observers.get("constant_velocity")
    start = observer.Gains(speed=sum(span) / 2.0, speed_chain=0.0, l_r=rear_axle)
    observer.claim(start, "continuous", **asked)  # its message for a region that is none
    said = None
    if gain is None:
        F, _ = family.constant_velocity(sorted(set(span)), window, yaw_rate, rear_axle, slip)
        weights = Weights(np.eye(2, 4), np.eye(4)[2:], np.zeros((4, 0)))
        T = np.array([1.0, 1.0, 0.2, 0.1])
        gains, _, _, said = synthesise([Entry(F, rate, fastest)], weights, scale=T, gain_bound=gain_bound)
        gain = rounded(gains[0][[0, 1, 2, 3], [0, 1, 1, 1]]).tolist()
    names = ("L_x", "L_y", "L_psi", "L_beta")
    made = start._replace(**{n: float(g) for n, g in zip(names, gain, strict=True)})
    return certify("constant_velocity", made, "continuous", rate, asked, said)
