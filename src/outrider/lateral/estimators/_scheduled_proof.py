"""What is claimed of the scheduled observer: one P for all speeds, so speed may change as it likes.

Errors are truth minus estimate. Over a step of dt, from correction to correction,

    e+ = (I - K(v) c) Phi(u, dt) e

u: mean speed of the step, v: measured at its end. The tyres' own pace (C_f + C_r) / (m vx) is what the decay
is counted in, for a fast car forgets slowly: |e| falls as exp(-share * integral of pace dt).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import exp
from pathlib import Path
from typing import Any

import numpy as np

from outrider import cars, proof_file
from outrider.cars import Car
from outrider.certificate import Array, Certificate
from outrider.claim import Claim, Sought
from outrider.errors import InputError
from outrider.family import Family
from outrider.lateral.estimators._linear import C, phi, tabled
from outrider.models.single_track import linear, sampled

SHIPPED = Path(__file__).parents[1] / "shipped"
SIZE = np.array([1.0, 0.03])  # errors of like size [m/s, rad/s]
DECAY = 0.9  # of the tyres' own pace that the error falls at [-]
LONGEST = 3.0  # pace that a step counts for at most: exp(-3) is gone anyway [-]
SPEEDS = 5.0, 15.0, 30.0  # that bounds are stated for [m/s]
STEP = 0.1  # matrices are brought to a step in which the pace amounts to this [-]


def claim(
    car: Car,
    gains: Any,
    speed: tuple[float, float] = (2.0, 60.0),
    acceleration: float = 10.0,
    usual: float = 0.01,
    dt: tuple[float, ...] = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5),
    points: int = 40,
) -> Claim:
    """At speeds [m/s], |change of speed| up to `acceleration` [m/s2], steps of dt [s]; K made for `usual`.

    InputError for a region that reaches standstill or has no width.
    """
    from outrider.lateral.estimators import scheduled

    if not (1.0 <= speed[0] < speed[1] < np.inf and acceleration >= 0.0 and min(dt) > 0.0 and points >= 2):
        raise InputError(
            f"speeds {speed[0]:g} to {speed[1]:g} m/s, |acceleration| {acceleration:g} m/s2, steps {dt}; "
            "want 1 <= low < high, 0 or more, and positive steps"
        )
    K = scheduled.prepare(car, gains, usual).K
    made = [
        error(car, K, float(v), u, h)
        for v, h in product(np.geomspace(*speed, points), dt)
        for u in _before(float(v), acceleration, h)
    ]
    names = tuple(name for _, _, _, _, name in made)
    A = np.array([m[0] for m in made])
    grown = np.array([exp(DECAY * (min(m[3], LONGEST) - STEP)) for m in made])[:, None, None]
    return Claim(
        "scheduled",
        "sampled",
        Family(A * grown, names),
        {
            "speed [m/s]": speed,
            "change of speed [m/s2]": (-acceleration, acceleration),
            f"time step, one of {', '.join(f'{h:g}' for h in dt)} [s]": (min(dt), max(dt)),
        },
        (
            "The car is the single track with the stiffness, mass and inertia given, its tyres linear.",
            "Steering is known; over a step, speed and steering are the means of both ends.",
            f"The error falls by the rate as t (C_f + C_r) / (m vx) grows by {STEP:g}.",
            f"A step makes that grow by {LONGEST:g} at most: a longer one counts for no more.",
            "Bounds are for one speed and the usual step.",
            "Between grid points of speed matrices differ from interpolated ones by less than the margin.",
        ),
        {
            "speed": speed,
            "acceleration": acceleration,
            "usual": usual,
            "dt": tuple(dt),
            "points": points,
        },
        sought=tuple(_sought(car, K, usual)),
    )


def _sought(car: Car, K: Array, dt: float) -> Iterator[Sought]:
    """Error of the lateral velocity by those of the yaw rate and the steering, at some speeds; all exact."""
    for v in SPEEDS:
        A, noise, steering, _, _ = error(car, K, v, v, dt)
        for by, B in (("yaw rate measured", noise), ("steering", steering)):
            yield Sought(f"lateral velocity at {v:g} m/s", by, A[None], B[None], np.array([[1.0, 0.0]]))


def error(car: Car, K: Array, v: float, u: float, dt: float) -> tuple[Array, Array, Array, float, str]:
    """Error matrix (2, 2), what noise and steering add to it (2, 1) each, scaled; pace of the step; name."""
    i, w = tabled(v)
    k = (w * K[i] + (1.0 - w) * K[i + 1])[:, None]
    m, left = sampled(linear(u, car), dt), np.eye(2) - k @ C
    A = left @ phi([u], car, dt)[0]
    steering = left @ np.array([[m.b1], [m.b2]])
    S = SIZE[:, None]
    return A / S * SIZE, -k / S, steering / S, -linear(u, car).a11 * dt, f"{v:.3g} m/s, step {dt:g} s"


def _before(v: float, acceleration: float, dt: float) -> tuple[float, ...]:
    """Mean speeds of a step that ends at v, least to greatest [m/s]; the car does not turn back in it."""
    half = 0.5 * acceleration * dt
    return max(v - half, 0.5 * v), v, v + half


def certificate(car: str, gains: Any = None) -> Certificate:
    """The claim for a shipped car with the shipped proof; InputError for a car that has none."""
    from outrider.lateral.estimators import scheduled

    path = SHIPPED / f"scheduled.{car}.json"
    if not path.exists():
        able = ", ".join(sorted(p.name.split(".")[1] for p in SHIPPED.glob("scheduled.*.json")))
        raise InputError(f"no proof for car {car!r} comes with the package; want one of {able}, or `prove`")
    file = proof_file.read(path)
    made = claim(cars.load(car), scheduled.Gains(**file.gains) if gains is None else gains, **file.asked)
    return made.certificate(file.P, file.rate, file.proofs)


def prove(car: Car, gains: Any, **asked: Any) -> proof_file.ProofFile:
    """A proof of `claim(car, gains, **asked)` searched anew; NotCertified where there is none."""
    from importlib.metadata import version

    from outrider import design

    made = claim(car, gains, **asked)
    rate = exp(-DECAY * STEP)
    proven, _, said = design.prove(made, rate)
    about = {
        "outrider": version("outrider"),
        "solver": said.solver,
        "status": said.status,
        "margin": float(f"{proven.margin():.3g}"),
    }
    return proof_file.ProofFile(
        "scheduled", "sampled", gains._asdict(), made.asked, rate, proven.P, (), about
    )
