"""What the papers say about how the observers behave, each statement tried in a run without noise."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from outrider.reproduce import plant, published
from outrider.reproduce.plant import Drive, Truth
from outrider.reproduce.published import HIGH_GAIN, MULTI_STAGE, NONLINEAR, Estimate, Published, Seen
from outrider.reproduce.section import Claim, Picture, Section, verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

STEP = 4e-3  # of simulation and sensor [s]
SCAN = 0.1  # between two samples of the slow sensor [s]
OFF = 0.36  # error of the yaw at the beginning [rad]
LITTLE_V, LITTLE_PSI = 0.05, 0.01  # errors that count as none [m/s, rad]

JERK = Drive(5.0, jerk=0.5)
TURNS = (("constant", Drive(10.0, steering=10.0)), ("growing", Drive(10.0, steering_rate=5.0)))
AS_PRINTED = NONLINEAR._replace(gains=NONLINEAR.gains._replace(slip=0.0))
ONE_SECTOR = NONLINEAR._replace(gains=NONLINEAR.gains._replace(turns=0.0))


def section() -> Section:
    """Convergence, drift, offset, headings."""
    claims = (_convergence(), _jerk(), _offset(), *_drift(), _headings(), *_sectors())
    text = f"""
Each statement has a run of its own: observers as printed, no noise, {1 / STEP:g} measurements a second unless
said otherwise, started with the yaw {OFF:g} rad off where the start matters, all else right. Errors below
{LITTLE_V:g} m/s and {LITTLE_PSI:g} rad count as none. What came out is in the table of claims.
"""
    picture = Picture(
        "drift",
        "Left: the nonlinear observer's yaw drifts where its course leaves out the slip, as in [HG 11], "
        "and the more the more it steers. Right: a jerk of 0.5 m/s3.",
        _draw,
    )
    return Section("behaviour", "How the observers behave", text, (), (picture,), claims)


def simulate(
    drive: Drive,
    observer: Published,
    duration: float,
    heading: float = OFF,
    scan: float = STEP,
    late: int = 0,
) -> tuple[Truth, Estimate]:
    """One observer, all runs of a drive; see `between` for a sensor slower than STEP."""
    truth = plant.drive(drive, duration, STEP)
    every = round(scan / STEP)
    seen = plant.measured(truth.x[::every], truth.y[::every])
    if every > 1:
        seen = between(seen, every, late)
    o, V = np.zeros_like(truth.V[0]), truth.V[0]
    n = len(seen.x)
    truth = Truth(*(v[:n] for v in truth))
    return truth, published.simulate(observer, observer.start(o, o, V, truth.psi[0] + heading), seen, STEP)


def between(seen: Seen, every: int, late: int = 0) -> Seen:
    """Samples (T, N) joined by lines of `every` steps; an interval's course holds in it, or `late` on."""
    t, fine = np.arange(len(seen.x)), np.arange((len(seen.x) - 1) * every + 1) / every
    S, x, y = (np.column_stack([np.interp(fine, t, v) for v in c.T]) for c in (seen.S, seen.x, seen.y))
    interval = np.maximum(np.ceil(fine - 1e-9).astype(int) - late, 0)
    return Seen(S, seen.alpha[interval], x, y)


tried = cache(simulate)  # of drives of plain numbers: the picture shows what the claims were taken from


# ------------------------------------------------------------------ errors


def course_error(truth: Truth, e: Estimate) -> Array:
    """Error (T, N) of the direction of motion [rad]."""
    error: Array = published.wrap(np.arctan2(e.V_y, e.V_x) - truth.psi - truth.beta)
    return error


def speed_error(truth: Truth, e: Estimate) -> Array:
    """Error (T, N) of the speed [m/s]."""
    return np.hypot(e.V_x, e.V_y) - truth.V


def yaw_error(truth: Truth, e: Estimate) -> Array:
    """Error (T, N) of the yaw [rad]."""
    error: Array = published.wrap(e.psi - truth.psi)
    return error


def settled(t: Array, error: Array, share: float = 0.05) -> float:
    """Time [s] after which the error (T,) stays within a share of its first value; inf where it does not."""
    outside = np.flatnonzero(np.abs(error) > share * abs(error[0]))
    if not len(outside):
        return 0.0
    return float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else np.inf


# ------------------------------------------------------------------ claims


def _convergence() -> Claim:
    times = []
    for observer in (HIGH_GAIN, MULTI_STAGE):
        truth, e = tried(Drive(10.0), observer, 5.0)
        times.append(settled(truth.t, course_error(truth, e)[:, 0]))
    return Claim(
        "[MS] V.A",
        "With smaller gains the multi-stage observer converges more slowly than the high-gain observer.",
        verdict(times[1] > times[0]),
        f"straight on at 10 m/s, course within 5 % of its first error after {times[1]:.2f} s against "
        f"{times[0]:.2f} s",
    )


def _jerk() -> Claim:
    last, rms = [], []
    for observer in (HIGH_GAIN, MULTI_STAGE):
        error = speed_error(*tried(JERK, observer, 10.0, heading=0.0))[:, 0]
        last.append(abs(float(error[-1])))
        rms.append(float(np.sqrt((error**2).mean())))
    return Claim(
        "[MS] III.A",
        "With its model of the jerk the multi-stage observer is better where the acceleration varies.",
        verdict(last[1] < last[0] and rms[1] < rms[0], last[1] < last[0]),
        f"jerk of 0.5 m/s3 from 5 m/s on, against the high-gain observer: speed error after 10 s "
        f"{last[1]:.4f} against {last[0]:.4f} m/s, RMS over the 10 s {rms[1]:.3f} against {rms[0]:.3f} m/s",
    )


def _offset() -> Claim:
    offsets = []
    for scan, late in ((STEP, 0), (SCAN, 1), (SCAN, 0)):
        truth, e = tried(Drive(10.0, steering=10.0), MULTI_STAGE, 8.0, scan=scan, late=late)
        offsets.append(abs(float(course_error(truth, e)[-round(1.0 / STEP) :, 0].mean())))
    fine, held, joined = offsets
    return Claim(
        "[MS] V.A",
        "Speed and course taken from the last two samples leave a small offset.",
        verdict(held > LITTLE_PSI > fine, held > fine),
        f"10 m/s, steering 10 deg: course off by {held:.3f} rad where the course of the last two of "
        f"{1 / SCAN:g} samples a second is held; {joined:.3f} where it is used between those two; {fine:.3f} "
        f"at {1 / STEP:g} a second",
    )


def _drift() -> Iterator[Claim]:
    found = {}
    for name, drive in (
        ("constant", Drive(10.0, steering=10.0)),
        ("growing", Drive(10.0, steering_rate=5.0)),
    ):
        for observer, label in ((NONLINEAR, "slip"), (AS_PRINTED, "printed")):
            truth, e = tried(drive, observer, 5.0)
            error = np.abs(yaw_error(truth, e)[:, 0])
            found[name, label] = float(error[len(error) // 2]), float(error[-1])
    shown = "; ".join(
        f"{name} steering {a:.3f} and {b:.3f} "
        + ("with the slip in its course" if label == "slip" else "without")
        for (name, label), (a, b) in found.items()
    )
    grows = {key: b > a + LITTLE_PSI for key, (a, b) in found.items()}
    yield Claim(
        "[HG] IV.A, Fig. 2",
        "While the vehicle turns at constant speed, the nonlinear observer's yaw drifts away more and more.",
        verdict(grows["constant", "slip"], any(grows.values())),
        f"yaw error at 2.5 and 5 s [rad]: {shown}, as [HG 11] prints it",
    )
    last = []
    for observer in (NONLINEAR, HIGH_GAIN):
        truth, e = tried(Drive(15.0, -1.0, steering=10.0), observer, 2.5)
        last.append((abs(float(speed_error(truth, e)[-1, 0])), abs(float(course_error(truth, e)[-1, 0]))))
    (V, chi), (good_V, good_chi) = last
    yield Claim(
        "[HG] IV.A, Fig. 3",
        "With acceleration and steering the nonlinear observer is off in speed and orientation, the "
        "high-gain observer in neither.",
        verdict(
            V > LITTLE_V and chi > LITTLE_PSI and good_V < LITTLE_V and good_chi < LITTLE_PSI,
            good_V < V and good_chi < chi,
        ),
        f"A = -1 m/s2, steering 10 deg, after 2.5 s: nonlinear {V:.2f} m/s and course {chi:.3f} rad, "
        f"high-gain {good_V:.3f} m/s and {good_chi:.4f} rad",
    )


def _headings() -> Claim:
    headings = np.linspace(-np.pi, np.pi, 12, endpoint=False)
    truth, e = simulate(Drive(10.0, 1.0, steering=5.0, psi=headings), HIGH_GAIN, 4.0)
    each = np.sqrt((course_error(truth, e) ** 2).mean(axis=0))
    spread = float(each.max() - each.min())
    return Claim(
        "[HG] I.B, V",
        "One constant gain of the high-gain observer serves all orientations of the vehicle.",
        verdict(spread < 1e-6, not e.lost.any()),
        f"course RMSE from {len(headings)} headings all round: {each.mean():.3f} rad, alike within "
        f"{max(spread, 1e-12):.0e}",
    )


def _sectors() -> Iterator[Claim]:
    headings = np.radians(np.arange(0.0, 181.0, 15.0))
    drive = Drive(10.0, psi=headings)
    good = []
    for observer in (ONE_SECTOR, NONLINEAR):
        truth, e = simulate(drive, observer, 8.0, heading=0.2)
        last = np.abs(course_error(truth, e)[-250:]).max(axis=0)
        good.append((last < 0.2) & ~e.lost)
    until = np.degrees(headings[int(np.argmin(good[0]))]) if not good[0].all() else 180.0
    yield Claim(
        "[HG] I.A",
        "An LMI observer with one gain is stable for a limited range of directions, so it must switch gains.",
        verdict(not good[0].all() and not good[1].all(), not good[0].all()),
        f"a gain made for direction 0 fails from {until:.0f} deg on; the same gain turned with the estimated "
        f"course works in {int(good[1].sum())} of {len(headings)} directions, without any switching",
    )


def _draw() -> Figure:
    from outrider.reproduce import draw

    figure, (left, right) = draw.panels(1, 2, height=3.6)
    for i, (name, drive) in enumerate(TURNS):
        for observer, label, line in ((NONLINEAR, "with slip", "-"), (AS_PRINTED, "[HG 11]", "--")):
            truth, e = tried(drive, observer, 5.0)
            error = np.degrees(yaw_error(truth, e)[:, 0])
            left.plot(truth.t, error, line, color=draw.LINES[i], lw=1.4, label=f"{label}, {name} steering")
    left.set(xlabel="time [s]", ylabel="yaw error [deg]", xlim=(0.0, 5.0))
    left.legend(frameon=False)
    for observer in (HIGH_GAIN, MULTI_STAGE):
        truth, e = tried(JERK, observer, 10.0, heading=0.0)
        name = observer.name
        right.plot(truth.t, speed_error(truth, e)[:, 0], color=draw.COLOURS[name], lw=1.4, label=name)
    right.set(xlabel="time [s]", ylabel="speed error [m/s]", xlim=(0.0, 10.0))
    right.legend(frameon=False)
    return figure
