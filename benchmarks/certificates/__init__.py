"""The gains and proofs that come with the package, and how each is made."""

from __future__ import annotations

from collections.abc import Callable
from math import exp, radians
from typing import Any, NamedTuple

import numpy as np

from outrider import design, proof_file
from outrider.observers import certificate_of, constant_velocity, high_gain, invariant, multi_stage
from outrider.observers._invariant_proof import DECAY, STEP

TOLERANCE = 0.002  # of designed gains, relative [-]
BOUNDS = 0.02  # of proven bounds, relative [-]


class Shipped(NamedTuple):
    """One proof of the package: what it is made by, and the gains of the source text that it is for."""

    name: str  # of the file, without .json
    gains: Any
    form: str
    rate: float  # of the proof: [1/s], sampled [-]
    asked: dict[str, Any]
    names: tuple[str, ...] = ()  # of the gains that were designed
    designed: Callable[[], design.Design] | None = None  # None: the gains come from elsewhere

    def proven(self) -> design.Design:
        """Proof of these gains, searched anew."""
        return design.certify(self.name.partition(".")[0], self.gains, self.form, self.rate, self.asked)

    def off(self) -> float:
        """Largest relative difference between the gains designed anew and these."""
        if self.designed is None:
            return 0.0
        file = self.designed().file
        assert file is not None
        made, kept = (np.array([g[n] for n in self.names]) for g in (file.gains, self.gains._asdict()))
        return float((np.abs(made - kept) / np.abs(kept)).max())

    def bounds_off(self) -> float:
        """Largest relative difference between bounds proven anew and shipped ones."""
        anew = {(b.of, b.by): b.gain for b in self.proven().certificate.bounds}
        kept = {(b.of, b.by): b.gain for b in certificate_of(proof_file.shipped(self.name)).bounds}
        if anew.keys() != kept.keys():
            return 1.0
        return max((abs(anew[k] / kept[k] - 1.0) for k in kept), default=0.0)


STAGES = ("L_S", "L_V", "L_A", "L_J", "L_w", "psi_0", "psi_V", "beta_0", "beta_V")
ALL = (
    Shipped("multi_stage", multi_stage.Gains(), "continuous", 0.05, {}),
    Shipped("multi_stage.designed", multi_stage.DESIGNED, "continuous", 0.05, {}, STAGES, design.multi_stage),
    Shipped("high_gain", high_gain.Gains(), "sampled", 0.992, {}),
    Shipped(
        "high_gain.designed",
        high_gain.DESIGNED,
        "continuous",
        0.5,
        {"speed": 5.0, "acceleration": 3.0, "yaw_rate": 0.4},
        ("L1", "L2", "L3"),
        lambda: design.high_gain(5.0, 3.0, 0.4, rate=0.5, fastest=8.0),
    ),
    Shipped(
        "high_gain.published",
        high_gain.PUBLISHED,
        "continuous",
        0.0,
        {"speed": 2.0, "acceleration": 1.0, "yaw_rate": 1.9},
    ),
    Shipped("constant_velocity", constant_velocity.Gains(), "sampled", 0.96, {}),
    Shipped(
        "constant_velocity.designed",
        constant_velocity.DESIGNED,
        "continuous",
        1.5,
        {"speed": (10.0, 10.0), "window": radians(36.0), "yaw_rate": 0.5},
        ("L_x", "L_y", "L_psi", "L_beta"),
        lambda: design.constant_velocity([10.0], radians(36.0), 0.5, rate=1.5, fastest=10.0),
    ),
    Shipped("invariant", invariant.Gains(), "sampled", exp(-DECAY * STEP), {}),
)
