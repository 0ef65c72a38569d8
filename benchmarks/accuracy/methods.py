"""The rows of the table: every observer and peer, in every variant it has, and what of it may be tuned.

A variant says what is used beside the positions. Switches that a variant does not name are off.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from benchmarks.accuracy import peers

from outrider import compare, observers
from outrider.compare import Estimate, Series

Range = tuple[float, float]
LAG = 2
AXLE: Mapping[str, Range] = {"l_r": (0.8, 3.0)}
KALMAN: Mapping[str, Range] = {
    "noise": (0.01, 1.0),
    "jerk": (0.3, 60.0),
    "slip": (0.003, 3.0),
    "yaw": (0.003, 1.0),
    **AXLE,
}

# What the search may change where only positions are used, by observer: from, to.
TUNED: Mapping[str, Mapping[str, Range]] = {
    "ekf": {**KALMAN, "coast": (0.2, 20.0)},
    "ukf": {**KALMAN, "coast": (0.2, 20.0)},
    "multi_stage": {
        "speed": (0.3, 8.0),
        "orientation": (0.3, 8.0),
        "L_w": (1.0, 60.0),
        "gate": (0.3, 6.0),
        **AXLE,
    },
    "high_gain": {
        "L1": (3.0, 80.0),
        "L2": (5.0, 1000.0),
        "L3": (5.0, 3000.0),
        "c_max": (0.3, 5.0),
        "noise": (0.01, 1.0),
        **AXLE,
    },
    "constant_velocity": {
        "L_x": (1.0, 40.0),
        "L_y": (2.0, 60.0),
        "L_psi": (0.3, 60.0),
        "L_beta": (0.1, 20.0),
        "speed": (3.0, 30.0),
        "speed_chain": (0.03, 1.0),
        "noise": (0.01, 1.0),
        **AXLE,
    },
    "invariant": {
        "tau": (0.03, 1.5),
        "arc": (0.1, 20.0),
        "relax": (1.0, 60.0),
        "noise": (0.01, 1.0),
    },
    "imm": {
        "noise": (0.01, 1.0),
        "straight": (0.1, 20.0),
        "turning": (0.1, 20.0),
        "turn_rate": (0.01, 10.0),
        "turn": (0.03, 3.0),
        "begin": (0.02, 5.0),
        "end": (0.02, 5.0),
        **AXLE,
    },
    "filterpy_ekf": KALMAN,
    "filterpy_ukf": KALMAN,
    "filterpy_imm": {
        "noise": (0.01, 1.0),
        "straight": (0.1, 20.0),
        "turning": (0.1, 20.0),
        "turn": (0.03, 10.0),
        "stay": (0.003, 0.3),
    },
    "stonesoup_turn": {"noise": (0.01, 1.0), "acceleration": (0.01, 400.0), "turn": (0.001, 100.0)},
    "stonesoup_acceleration": {"noise": (0.01, 1.0), "jerk": (0.1, 1e6)},
}
# What a part of a variant adds to that, where the observer has it.
PARTS: Mapping[str, Mapping[str, Range]] = {
    "position": {"reverse": (0.3, 8.0)},  # without the heading it says where the front is
    "heading": {"heading_noise": (0.003, 0.5)},
    "Huber": {"huber": (0.7, 5.0)},
    "hop": {"hop": (0.03, 1.5), "hop_threshold": (1.5, 6.0), "hop_time": (0.3, 20.0)},
}
PULL: Mapping[str, Range] = {"heading": (1.0, 100.0), "heading_noise": (0.003, 0.5)}
HEADING_GAIN: Mapping[str, Mapping[str, Range]] = {
    "multi_stage": {"heading": (1.0, 100.0)},
    "high_gain": {**PULL, "turn": (0.3, 20.0)},
    "constant_velocity": PULL,
    "invariant": {
        "turn": (0.5, 40.0),
        "yaw": (0.01, 1.0),
        "cross": (0.05, 2.0),
        "heading_noise": (0.003, 0.5),
    },
}  # where the heading needs more than its noise
VARIANTS = ("position", "position, Huber", "heading", "heading, Huber", "heading, Huber, hop")
PEERS = peers.NAMES
NO_HEADING = ("filterpy_imm", "stonesoup_turn", "stonesoup_acceleration")


@dataclass(frozen=True, slots=True)
class Method:
    """One row: an estimator and what it may use."""

    name: str  # observer or peer
    variant: str  # parts, separated by commas; "position" or "heading" first
    lag: int = 0  # samples
    kind: str = "tuned"  # or "default", or the name of a set of gains that the observer's file holds

    @property
    def label(self) -> str:
        """As in the table."""
        return f"{self.name}, {self.variant}" + (f", lag {self.lag}" if self.lag else "")

    @property
    def heading(self) -> bool:
        """Whether the heading of the rectangle is used."""
        return self.variant.startswith("heading")

    @property
    def peer(self) -> bool:
        """Whether it is somebody else's."""
        return self.name in peers.NAMES

    def ranges(self) -> dict[str, Range]:
        """What the search may change."""
        known = dict(TUNED[self.name])
        for part in self.variant.split(", "):
            more = HEADING_GAIN.get(self.name) if part == "heading" else None
            known |= more or PARTS.get(part, {})
        return {k: v for k, v in known.items() if k in self._fields()}

    def gains(self, values: Mapping[str, float] | None = None) -> Any:
        """The observer's gains: those of `kind`, or `values` over the default; what is not used is off."""
        module = self._module()
        start = (
            module.Gains() if self.kind in ("tuned", "default") else observers.gain_sets(module)[self.kind]
        )
        if self.kind != "tuned":
            return start if self.heading else start._replace(**self._off(("heading",)))
        off = self._off([part.lower() for part in ("heading", "Huber", "hop") if part not in self.variant])
        return start._replace(**{**off, **(values or {})})

    def estimates(self, gains: Any, series: Sequence[Series], quick: bool = False) -> list[Estimate]:
        """Of every series; quick: without covariances."""
        shown = series if self.heading else [positions_only(s) for s in series]
        module = self._module()
        if self.peer:
            return [module.estimate(gains, s) for s in shown]
        if quick and not self.lag:
            return [_motion_only(module, gains, s) for s in shown]
        promise = compare.promise(module, gains, self.lag)
        made = (compare.estimate(module, gains, s, self.lag) for s in shown)
        return [replace(e, promise=promise) for e in made]

    def step_us(self, gains: Any, series: Sequence[Series]) -> float:
        """Time of one step [us]."""
        shown = series if self.heading else [positions_only(s) for s in series]
        if not self.peer:
            return compare.step_time(self._module(), gains, shown, self.lag)
        begin = time.process_time()
        self.estimates(gains, series)
        return 1e6 * (time.process_time() - begin) / sum(len(s.t) for s in series)

    def _off(self, names: Sequence[str]) -> dict[str, float]:
        return {name: 0.0 for name in names if name in self._fields()}

    def _fields(self) -> tuple[str, ...]:
        fields: tuple[str, ...] = self._module().Gains._fields
        return fields

    def _module(self) -> Any:
        return _module(self.name)


@cache
def _module(name: str) -> Any:
    return peers.get(name) if name in PEERS else observers.get(name)


def _motion_only(observer: Any, gains: Any, s: Series) -> Estimate:
    states = observers.batch(observer, s.y[None], np.diff(s.t, prepend=s.t[0])[None], gains)[0]
    return Estimate(observers.described(observer, states, gains), np.full((len(s.t), 10), np.nan))


def positions_only(s: Series) -> Series:
    """The series without the headings of the rectangles."""
    y = s.y.copy()
    y[:, 5], y[:, 6] = 0.0, np.inf
    return replace(s, y=y)


def names() -> list[str]:
    """All observers, then the peers."""
    return [*observers.names(), *peers.NAMES]


def searched(name: str) -> Iterator[Method]:
    """The variants of an observer or peer that are tuned; none where no ranges are given for it."""
    if name not in TUNED:
        return
    fields = Method(name, "position")._fields()
    for variant in VARIANTS:
        parts = variant.split(", ")
        has = ("Huber" not in parts or "huber" in fields) and ("hop" not in parts or "hop" in fields)
        if has and not (parts[0] == "heading" and name in NO_HEADING):
            yield Method(name, variant)


def followers(method: Method) -> Iterator[Method]:
    """What else is judged with the gains found for a method: the same, known some samples later."""
    if (
        not method.peer
        and hasattr(method._module(), "smooth")
        and method.heading
        and "hop" not in method.variant
    ):
        yield replace(method, lag=LAG)


def fixed(name: str) -> Iterator[Method]:
    """Sets of gains that an observer's file holds, with and without the heading."""
    if name in peers.NAMES:
        return
    module: Any = observers.get(name)
    for kind in ("default", *observers.gain_sets(module)):
        yield Method(name, "position", kind=kind)
        given = Method(name, "heading", kind=kind)
        if given.gains().heading > 0.0:
            yield given
