"""What the papers say about their equations of motion, tried on exact motion; and about effort."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import numpy.typing as npt

from outrider import observers
from outrider.compare import Series, step_time
from outrider.metrics import Truth as Known
from outrider.reproduce import plant, published
from outrider.reproduce.plant import Drive, Truth
from outrider.reproduce.published import HighGain, HighGainGains, Seen
from outrider.reproduce.section import Claim, Section, verdict

Array = npt.NDArray[np.float64]

STEP = 1e-3  # [s]
EXACT = 1e-4  # what numerical integration may differ by [m, m/s, m/s2]
CASES = (
    Drive(10.0),
    Drive(10.0, steering=10.0),
    Drive(15.0, -1.0, steering=-20.0),
    Drive(5.0, 2.0, steering=15.0),
)
EFFORT = 0.01  # share of the time between two scans that is little
SCAN_US = 1e5  # time between two scans [us]


def section() -> Section:
    """Claims about the models; no table of its own."""
    text = f"""
The equations are tried on {len(CASES)} exact motions: straight, turning, and turning while braking and
accelerating. What came out is in the table of claims.
"""
    return Section(
        "model",
        "The equations of motion",
        text,
        claims=(*_bicycle(), *_companion(), *_position(), *_effort()),
    )


def _bicycle() -> Iterator[Claim]:
    steering = np.radians(np.linspace(-36.0, 36.0, 73))
    beta = np.arctan(2.0 * np.tan(steering) / 4.0)
    off = float(np.abs(np.cos(beta) * np.tan(steering) / 4.0 - np.sin(beta) / 2.0).max())
    yield Claim(
        "[MS 3, 19], [HG 3, 8]",
        "The yaw rate by the steering angle and the one by the slip are the same.",
        verdict(off < 1e-12),
        f"curvatures differ by at most {max(off, 1e-12):.0e} 1/m over 36 deg of steering either way",
    )
    slip = float(np.degrees(np.arctan(0.5 * np.tan(np.radians(10.0)))))
    yield Claim(
        "[HG 11]",
        "The constant-velocity model, with the velocity along the yaw, follows from the bicycle model.",
        verdict(slip < 0.1),
        f"the slip is missing in the course: {slip:.2f} deg at 10 deg of steering",
    )


def companion(truth: Truth) -> HighGain:
    """z (T, N) of exact motion, [HG 35-36]."""
    chi, accelerated = truth.psi + truth.beta, np.gradient(truth.V, STEP, axis=0)
    across = truth.V**2 * np.sin(truth.beta) / published.L_R
    c, s = np.cos(chi), np.sin(chi)
    return HighGain(
        truth.x, truth.V * c, accelerated * c - across * s, truth.y, truth.V * s, accelerated * s + across * c
    )


def _companion() -> Iterator[Claim]:
    truth = plant.drive(Drive(*np.array(CASES, float).T), 3.0, STEP)
    z = companion(truth)
    free = published.HIGH_GAIN._replace(gains=HighGainGains(L=(0.0, 0.0, 0.0)))
    still = Seen(*(np.zeros_like(truth.x) for _ in Seen._fields))
    start = HighGain(*(v[0] for v in z))
    e = published.simulate(free, start, still, STEP)
    off = float(max(np.abs(e.x - truth.x).max(), np.abs(e.y - truth.y).max()))
    yield Claim(
        "[HG 44, 51-58]",
        "The companion form moves exactly as the bicycle with constant acceleration and slip.",
        verdict(off < 1e-2, off < 0.1),
        f"positions {off:.0e} m apart after 3 s, both integrated in steps of {1e3 * STEP:g} ms",
    )
    rate = published.course_rate(z, HighGainGains())
    known = truth.V * np.sin(truth.beta) / published.L_R
    off = float(np.abs(rate - known)[1:-1].max())
    yield Claim(
        "[HG 44, 89]",
        "The yaw rate can be read from velocity and acceleration.",
        verdict(off < EXACT),
        f"within {max(off, 1e-9):.0e} rad/s",
    )
    constant = [i for i, d in enumerate(CASES) if d.A == 0.0]
    drift = np.abs((z.z2 * z.z3 + z.z5 * z.z6)[:, constant]).max()
    yield Claim(
        "[HG 24-25]",
        "At constant speed the six states of the companion form obey two constraints.",
        verdict(
            bool(drift < EXACT) and bool(np.ptp(np.hypot(z.z2, z.z5)[:, constant], axis=0).max() < EXACT)
        ),
        f"speed constant and acceleration across the velocity, within {EXACT:g}",
    )


def _position() -> Iterator[Claim]:
    V, guessed, off = np.meshgrid(
        np.linspace(0.0, 20.0, 21), np.linspace(0.0, 20.0, 21), np.linspace(-3.1, 3.1, 63)
    )
    g2 = V**2 + guessed**2 - 2.0 * V * guessed * np.cos(off)
    worst = float((g2 - (V - guessed) ** 2 - 2.0 * V * guessed * off**2).max())
    half = float((g2 - (V - guessed) ** 2 - V * guessed * off**2).max())
    yield Claim(
        "[MS 67]",
        "The velocity's error is bounded by those of speed and course.",
        verdict(worst <= 1e-9),
        "on a grid up to 20 m/s and 3.1 rad; "
        + ("half" if half <= 1e-9 else "not half")
        + " the last term is enough",
    )
    ratio = published.HIGH_GAIN.gains.L[0] / published.MULTI_STAGE.gains.L_w
    largest = max(published.HIGH_GAIN.gains.L) / max(published.MULTI_STAGE.gains.L)
    yield Claim(
        "[MS] VI",
        "The multi-stage observer has smaller gains than the high-gain observer.",
        verdict(ratio > 1.0 and largest > 1.0),
        f"{ratio:.1f} times smaller on the position, {largest:.0f} times in the largest gain",
    )


# ------------------------------------------------------------------ effort


@cache
def step_us(name: str) -> float:
    """Time of one step of an observer of this package in a batch [us]; differs from run to run."""
    t: Array = 0.1 * np.arange(50, dtype=float)
    y = np.zeros((len(t), len(observers.Measurement._fields)))
    y[:, 0], y[:, 6] = 8.0 * t, np.inf
    truth = Known(t, y[:, :2], np.column_stack([0.0 * t + 8.0, 0.0 * t]), 0.0 * t)
    series = Series("effort", t, y, truth)
    observer = observers.get(name)
    return step_time(observer, observer.Gains(), [series])


def _effort() -> Iterator[Claim]:
    multi, high, imm = (step_us(name) for name in ("multi_stage", "high_gain", "imm"))
    yield Claim(
        "[MS] Abstract",
        "The multi-stage observer needs little computation.",
        verdict(multi < EFFORT * SCAN_US),
        f"as shipped, a step takes {'less' if multi < EFFORT * SCAN_US else 'more'} than {100 * EFFORT:g} % "
        "of the time between two scans",
    )
    less = [of < imm for of in (high, multi)]
    words = ["less" if one else "not less" for one in less]
    yield Claim(
        "[HG] I.A, I.B; [MS] II.A",
        "The observers need less computation than interacting multiple models.",
        verdict(all(less), any(less)),
        f"time of a step as shipped, beside `imm`: high_gain {words[0]}, multi_stage {words[1]}",
    )
