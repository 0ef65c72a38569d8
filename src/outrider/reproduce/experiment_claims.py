"""What the papers say of their experiments, judged on the rebuilt ones.

With the corner of the car as input where nothing else is said: a single reflecting point, as in the papers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from outrider.geometry import wrap
from outrider.records import Array
from outrider.reproduce.experiment_runs import INPUTS, LABELS, NOISES, NUMBERS, THETAS, Input, Score
from outrider.reproduce.section import Claim, verdict

Scores = Mapping[tuple[int, Input, str], Score]  # experiment, input, label

MULTI, HIGH_GAIN, LOW, HIGH, OURS = LABELS
READ = {1: (0.0, 0.0), 2: (180.0, 230.0), 3: (-90.0, 0.0), 4: (-90.0, -90.0)}  # yaw, begin and end [deg]
TOLD = {
    1: ("[MS] V.B, [HG] IV.C", "The orientation of the car that goes straight across remains at zero."),
    2: ("[MS] V.B, [HG] IV.C", "The orientation of the car that turns left goes from 180 to 230 deg."),
    3: ("[HG] IV.C", "The orientation of the oncoming car that turns left goes from -90 to about 0 deg."),
    4: ("[HG] IV.C", "The orientation of the oncoming car remains fairly constant at -90 deg."),
}
YAW_DEG = 5.0  # an angle read off a figure is right to this
SWAY_DEG = 10.0  # and one that wanders by less is constant
LIKE = 1.25  # figures within this factor are alike
MUCH = 2.0  # a figure this many times another is much larger
TURNED_DEG = 45.0  # an estimate further off has lost the orientation


def claims(every: Scores, near: tuple[float, float]) -> Iterator[Claim]:
    """All claims; near: from the EKF with low noise to high gain and to multi-stage, velocity [m/s]."""
    jumpy = "With a jumping point the multi-stage estimates of speed and orientation are smoother than the"
    ahead = "In the experiments the multi-stage observer is better in speed and orientation than the"
    yield _fewer(every, "[MS] V.B, Figs. 8, 9", f"{jumpy} high-gain ones.", "rough", (HIGH_GAIN,))
    yield _fewer(every, "[MS] VI", f"{jumpy} EKF's.", "rough", (LOW, HIGH))
    yield _fewer(every, "[MS] V.A", f"{ahead} high-gain observer.", "error", (HIGH_GAIN,))
    yield _fewer(every, "[MS] VI", f"{ahead} EKF.", "error", (LOW, HIGH))
    yield _alike(every, near)
    yield _slow(every)
    yield from (_yaw(every, number) for number in NUMBERS)
    yield _accelerates(every)
    yield _theta(every)
    yield _one_gain(every)
    yield _reference(every)


def _fewer(every: Scores, source: str, text: str, what: str, others: Sequence[str]) -> Claim:
    """The multi-stage figures are below all others'; in part: those of one quantity are in most cases."""
    fields = ("rough_speed", "rough_yaw") if what == "rough" else ("velocity", "yaw")
    pairs = _pairs(every, fields, others)
    won, n = (pairs[:, 0] < pairs[:, 1]).sum(axis=0), len(pairs)
    (speed, yaw), (speed_of, yaw_of) = np.median(pairs, axis=0)
    kind, also = "roughness", ""
    if what != "rough":
        against = _pairs(every, ("velocity_ref", "yaw_ref"), others)
        by = (against[:, 0] < against[:, 1]).sum(axis=0)
        kind, also = "error against the truth", f"; against the reference in {by[0]} and {by[1]} of {n}"
    return Claim(
        source,
        text,
        verdict(bool((won == n).all()), 2 * int(won.max()) > n),
        f"{kind} lower in {won[0]} of {n} for the velocity (medians {speed:.2f} against {speed_of:.2f} m/s), "
        f"in {won[1]} of {n} for the yaw ({yaw:.1f} against {yaw_of:.1f} deg){also}",
    )


def _pairs(every: Scores, fields: Sequence[str], others: Sequence[str]) -> Array:
    """(pairs, 2, 2): experiment and other observer; multi-stage, the other; velocity [m/s], yaw [deg]."""
    cases = [(n, label) for label in others for n in NUMBERS]
    of = [[every[n, "corner", who] for who in (MULTI, label)] for n, label in cases]
    values = np.array([[[getattr(s, f) for f in fields] for s in pair] for pair in of])
    return values * [1.0, 180.0 / np.pi]


def _alike(every: Scores, near: tuple[float, float]) -> Claim:
    low, high_gain = every[3, "corner", LOW], every[3, "corner", HIGH_GAIN]
    ratio = high_gain.velocity_ref / low.velocity_ref
    return Claim(
        "[MS] V.B, Fig. 10",
        "An EKF with a low noise covariance performs much as the high-gain observer does.",
        verdict(1.0 / LIKE < ratio < LIKE and near[0] < near[1] / MUCH, near[0] < near[1]),
        f"experiment 3: their velocities are {near[0]:.2f} m/s apart (RMS), the EKF's and the multi-stage "
        f"one's {near[1]:.2f}; delays {low.delay:.2f} and {high_gain.delay:.2f} s; error against the "
        f"reference: {ratio:.1f} times the EKF's",
    )


def _slow(every: Scores) -> Claim:
    slowest = NOISES[-1]
    multi, high, most = (every[3, "corner", label] for label in (MULTI, HIGH, slowest))
    return Claim(
        "[MS] V.B, Fig. 11",
        "An EKF with a higher noise covariance is very slow compared to the multi-stage observer.",
        verdict(
            min(high.delay / multi.delay, high.settled / multi.settled) >= MUCH,
            high.delay > multi.delay or high.settled > multi.settled,
        ),
        f"experiment 3: delay {high.delay:.2f} s with 0.5 m and {most.delay:.2f} s with 2 m, multi-stage "
        f"{multi.delay:.2f} s; near the reference after {high.settled:.1f}, {most.settled:.1f} and "
        f"{multi.settled:.1f} s; the covariance is not printed",
    )


def _yaw(every: Scores, number: int) -> Claim:
    source, text = TOLD[number]
    ends, steady, shown = [], [], []
    for label in (HIGH_GAIN, MULTI):
        s = every[number, "corner", label]
        off = wrap(np.array([s.begin, s.end]) - np.radians(READ[number]))
        ends.append(bool((np.abs(np.degrees(off)) <= YAW_DEG).all()))
        steady.append(READ[number][0] != READ[number][1] or np.degrees(s.sway) <= SWAY_DEG)
        begin, end = np.array(READ[number]) + np.degrees(off)
        shown.append(f"{label.partition(':')[0]} {_round(begin)} to {_round(end)} deg")
        if READ[number][0] == READ[number][1]:
            shown[-1] += f", never more than {np.degrees(s.sway):.1f} from its mean"
    return Claim(source, text, verdict(all(ends) and all(steady), any(ends)), "; ".join(shown))


def _round(angle: float) -> str:
    return f"{angle:.0f}".replace("-0", "0") if abs(angle) < 0.5 else f"{angle:.0f}"


def _accelerates(every: Scores) -> Claim:
    pushes = [every[1, "corner", label].push for label in (HIGH_GAIN, MULTI)]
    true = every[1, "corner", "truth"].push
    right = [abs(p / true - 1.0) < LIKE - 1.0 for p in pushes]
    return Claim(
        "[MS] V.B, [HG] IV.C",
        "The estimated speed of the car that goes straight across rises: it accelerates.",
        verdict(all(right), all(p > 0.0 for p in pushes)),
        f"slope of the speed: high-gain {pushes[0]:.2f}, multi-stage {pushes[1]:.2f}, truth {true:.2f} m/s2",
    )


def _theta(every: Scores) -> Claim:
    plain, *larger = (
        np.array([[s.rough_speed, s.rough_yaw] for s in (every[n, "corner", label] for n in NUMBERS)])
        for label in THETAS
    )
    ratios = np.array([rough / plain for rough in larger])  # (theta, experiment, quantity)
    return Claim(
        "[HG] III, IV.C, Figs. 9, 10",
        "Values of theta above 6.72 (8.6, 8.7) make the estimates significantly noisier.",
        verdict(bool((ratios > LIKE).all()), bool((ratios > 1.0).mean() >= 0.5)),
        f"roughness times {ratios[..., 0].min():.2f} to {ratios[..., 0].max():.2f} (speed), "
        f"{ratios[..., 1].min():.2f} to {ratios[..., 1].max():.2f} (yaw) over the four experiments",
    )


def _one_gain(every: Scores) -> Claim:
    worst = {kind: max(np.degrees(every[n, kind, HIGH_GAIN].off) for n in NUMBERS) for kind in INPUTS}
    return Claim(
        "[HG] IV.C, V",
        "One constant gain tracks all orientations, stably.",
        verdict(max(worst.values()) < TURNED_DEG, worst["corner"] < TURNED_DEG),
        "largest error of the yaw in any experiment: "
        + ", ".join(f"{angle:.0f} deg ({kind})" for kind, angle in worst.items()),
    )


def _reference(every: Scores) -> Claim:
    """It can tell observers apart whose errors are twice its own."""
    shares = []
    for n in NUMBERS:
        best = [min(getattr(every[n, "corner", label], f) for label in LABELS) for f in ("velocity", "yaw")]
        own = every[n, "corner", "reference"]
        shares.append([own.velocity / best[0], own.yaw / best[1]])
    share = np.array(shares)
    return Claim(
        "[HG] IV.C",
        "Positions filtered forward and backward, and their derivatives, serve as ground truth.",
        verdict(bool((share <= 1.0 / MUCH).all()), bool((share < 1.0).all(axis=1).any())),
        f"its own error is {share[:, 0].min():.1f} to {share[:, 0].max():.1f} times the best observer's in "
        f"velocity, {share[:, 1].min():.1f} to {share[:, 1].max():.1f} times in yaw",
    )
