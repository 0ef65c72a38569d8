"""A car's lateral velocity from its own sensors: the contract of an estimator, and the loop that runs any.

One file is one estimator, named as the file is. Body frame: x forward, y left; vy of the centre of gravity.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from outrider import extension
from outrider.cars import Car
from outrider.errors import InputError

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

LEAST_SPEED = 1.0  # slower, the single track says nothing: the estimate is held [m/s]
LONGEST_GAP = 0.5  # a longer gap is not coasted over: the estimate is held and starts anew [s]


class Sample(NamedTuple):
    """What the sensors say at one instant; NaN where missing."""

    dt: float  # since the last sample [s]
    vx: float  # forward, negative in reverse [m/s]
    yaw_rate: float  # [rad/s]
    ay: float  # lateral acceleration at the centre of gravity, to the left [m/s2]
    steering: float  # angle of the front wheels, the car's gain and offset applied [rad]


class Estimate(NamedTuple):
    """What an estimator says; columns of an estimate array, in this order."""

    vy: float  # lateral velocity [m/s]
    yaw_rate: float  # [rad/s]
    bias: float  # of the yaw-rate sensor, measured minus true [rad/s]; 0 where it is not estimated


class Estimator(Protocol):
    """The contract of a file in `estimators/`: names at module level, functions pure and marked `@kernel`."""

    reference: str  # where the equations are published
    State: Any  # NamedTuple of floats
    Gains: Any  # NamedTuple of floats, defaults that work, a unit in the comment of each

    def prepare(self, car: Car, gains: Any, dt: float) -> Any:
        """Whatever can be computed once: a NamedTuple of floats and arrays; dt [s] usual step."""

    def start(self, sample: Sample, car: Car, design: Any) -> Any:
        """State from the first usable sample."""

    def step(self, state: Any, sample: Sample, car: Car, design: Any) -> Any:
        """State at the next sample, sample.dt [s] later; vx, yaw_rate and steering are finite, ay may not be.

        |vx| is at least LEAST_SPEED; vx may be negative. The state is never non-finite afterwards.
        """

    def output(self, state: Any, sample: Sample, car: Car, design: Any) -> Estimate:
        """What is known now."""

    # Only some have: claim(car, gains, **asked) -> claim.Claim, as the observers of other vehicles have; and
    # still(state, sample, car, design) -> state: what a sample slower than LEAST_SPEED, its output held, says
    # of the sensors; the drive after it goes on by `step`, however long the car stood.


class Track(NamedTuple):
    """An estimate at every row of a log."""

    estimate: Array  # (n, 3) as Estimate; NaN before the first usable row
    held: Bools  # (n,) nothing was estimated here: too slow, in a gap, or before the first usable row


def names() -> list[str]:
    """Names of all estimators: the files of `estimators/`."""
    return extension.files(Path(__file__).parent / "estimators")


def get(name: str) -> Estimator:
    """Estimator by name; InputError, with the nearest names, for an unknown one."""
    found: Estimator = extension.load(f"{__name__}.estimators", name, names(), "estimator")
    return found


def gains_from(estimator: Estimator, values: Mapping[str, float]) -> Any:
    """The estimator's Gains with some replaced; InputError for an unknown name or no finite number."""
    return extension.replaced(estimator.Gains(), values)


def estimate(estimator: Estimator, samples: Array, car: Car, gains: Any = None, dt: float = 0.0) -> Track:
    """Estimates for samples (n, 5) as `Sample`; the first row's dt is ignored. Bit for bit what `step` gives.

    dt: usual step [s]; 0: the median. InputError where the shape does not fit.
    """
    from outrider import compiler

    samples = np.ascontiguousarray(samples, float)
    if samples.ndim != 2 or samples.shape[1] != len(Sample._fields):
        raise InputError(f"samples {samples.shape}; want (n, {len(Sample._fields)})")
    gains = estimator.Gains() if gains is None else gains
    steps = samples[1:, 0]
    usual = dt or (float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.01)
    out, held = np.full((len(samples), len(Estimate._fields)), np.nan), np.ones(len(samples), np.bool_)
    still = getattr(estimator, "still", None)
    run = compiler.log(estimator.start, estimator.step, estimator.output, estimator.State, Sample, still)
    run(samples, car, estimator.prepare(car, gains, usual), LEAST_SPEED, LONGEST_GAP, out, held)
    return Track(out, held)
