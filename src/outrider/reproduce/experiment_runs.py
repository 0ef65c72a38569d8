"""The papers' four experiments as simulated scans, through the whole pipeline, and figures for each observer.

Frame of the papers: x to the right, y ahead of the standing scooter, yaw counter-clockwise from x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal, NamedTuple

import numpy as np

from outrider import compare, observers, simulate
from outrider.compare import Estimate, Series
from outrider.geometry import corners, rotate, wrap
from outrider.measured import collect
from outrider.metrics import Truth
from outrider.observers import Measurement, Motion
from outrider.offline import open_source
from outrider.records import Array, Bools, Frame, Pose, Scan
from outrider.scenario import Scenario, parse
from outrider.segment import segment
from outrider.settings import Detect

Input = Literal["rectangle", "corner", "nearest"]

INPUTS: tuple[Input, ...] = ("rectangle", "corner", "nearest")
NUMBERS = (1, 2, 3, 4)
SEEDS = 5  # of the sensor's errors, from the scenario's own one on
CAR = "car"
CORNER = {1: 3, 2: 0, 3: 3, 4: 0}  # front right or left: the one in sight, of `geometry.corners`
CORNER_M = 1.0  # a return further from the corner is not the corner's
EPOCH_S = simulate.EPOCH_NS * 1e-9
GATE_M = 3.0  # a segment with its middle further from the car's is not the car's
HOP_M = 0.2  # a longer way of the measured point over the body is a hop
SKIP_S = 1.0  # from the first measurement on, not judged
THETA = 6.7205  # of the published high gain, [HG] eq. 91
CUTOFF_HZ, ORDER = 1.0, 2  # of the reference's low-pass; the source says neither
NEAR_MPS, STAY = 1.0, 5  # what counts as near the reference, and for how many scans
LATEST_S = 1.0  # the longest delay that is looked for
RATE_HZ = 10.0

LABELS = ("multi_stage:published", "high_gain:published", "ekf:low_noise", "ekf:high_noise", "ekf")
THETAS = ("high_gain:published", "high_gain, theta 8.6", "high_gain, theta 8.7")
NOISES = ("ekf:low_noise", "ekf, noise 0.2 m", "ekf:high_noise", "ekf, noise 2 m")


class Score(NamedTuple):
    """One observer, or the reference, on one experiment; RMS where nothing else is said."""

    velocity: float  # error of the vector against the truth [m/s]
    yaw: float  # the same of the yaw [rad]
    velocity_ref: float  # error against the reference [m/s]
    yaw_ref: float  # [rad]
    rough_speed: float  # second difference of the speed from scan to scan [m/s]
    rough_yaw: float  # the same of the yaw [rad]
    delay: float  # shift in time by which the velocity is nearest to that of the reference [s]
    settled: float  # from the first scan until it stays near the reference [s]
    begin: float  # mean yaw over the first second that counts, not wrapped [rad]
    end: float  # over the last second [rad]
    sway: float  # largest change of the yaw from its mean [rad]
    off: float  # largest error of the yaw [rad]
    push: float  # slope of a straight line through the speed [m/s2]


@dataclass(frozen=True, slots=True)
class Track:
    """What came out over one series; row i is scan i, NaN before the start."""

    p: Array  # (n, 2) [m]
    v: Array  # (n, 2) [m/s]
    yaw: Array  # (n,) next to the true one, not wrapped [rad]


@dataclass(frozen=True, slots=True)
class Run:
    """One experiment with one seed and one kind of measurement."""

    number: int
    input: Input
    series: Series  # times from the scenario's beginning [s]
    tracks: dict[str, Track]  # by label; "truth" and "reference" too
    scores: dict[str, Score]  # of the same labels
    hops: tuple[float, float]  # share of scans, and the longest one [m]


@cache
def world(number: int) -> Scenario:
    """The scenario of an experiment, 1 to 4; the distances and speeds are chosen here."""
    name = f"experiment_{number}.toml"
    return parse((resources.files("outrider.reproduce") / name).read_bytes(), name)


def gains(label: str) -> tuple[Any, Any]:
    """Observer and gains of a label: those of `observers.variant`, and what the papers used besides."""
    if label == "multi_stage:published":  # positions only
        observer: Any = observers.get("multi_stage")
        return observer, observer.Gains()._replace(heading=0.0)
    if ", theta " in label:
        v = observers.variant("high_gain:published")
        r = float(label.rpartition(" ")[2]) / THETA
        g = v.gains
        return v.observer, g._replace(L1=r * g.L1, L2=r**2 * g.L2, L3=r**3 * g.L3)
    if ", noise " in label:
        v = observers.variant("ekf:low_noise")
        return v.observer, v.gains._replace(noise=float(label.split()[-2]))
    v = observers.variant(label)
    return v.observer, v.gains


@cache
def runs(number: int, seeds: int = SEEDS) -> tuple[Run, ...]:
    """All inputs of one experiment, for each seed; the first three have the scenario's own seed."""
    what = world(number)
    return tuple(
        _run(number, kind, series) for i in range(seeds) for kind, series in _measured(number, what.seed + i)
    )


def typical(found: Sequence[Run], label: str) -> Score:
    """Median of each figure over the seeds."""
    table = np.array([run.scores[label] for run in found])
    return Score(*(float(np.median(column)) for column in table.T))


def apart(found: Sequence[Run], a: str, b: str) -> float:
    """How far the velocities of two labels are apart [m/s], RMS over the scans that count; median of runs."""
    rms = [_rms(np.hypot(*(r.tracks[a].v - r.tracks[b].v)[counted(r.series)].T)) for r in found]
    return float(np.median(rms))


# ------------------------------------------------------------------ scans to series


def _measured(number: int, seed: int) -> list[tuple[Input, Series]]:
    """What the observers get: rectangles of the tracker, or one return of the car's segment."""
    what = world(number)
    messages = list(simulate.record(what, seed))
    true_poses = [m for m in messages if isinstance(m, Pose) and m.topic.startswith("/truth/")]
    scans = [m for m in messages if not m.topic.startswith("/truth/")]
    frames: list[Frame] = []
    opened = open_source(scans)
    longest = max(collect(opened, true_poses, watch=frames.append).series, key=lambda s: len(s.t))
    t = longest.t - EPOCH_S
    true = truth(what, np.array([frame.t for frame in frames]) - EPOCH_S)
    car = np.column_stack([true.W_p, true.yaw])
    (body,) = what.vehicles
    corner = corners(car, np.array([body.length_m, body.width_m]))[:, CORNER[number]]
    settings = opened.settings.detect
    at = zip(frames, car[:, :2], corner, strict=True)
    rows = [_returns(frame.scan, centre, tip, settings) for frame, centre, tip in at]
    points = np.array([row for row in rows if row is not None])
    return [
        ("rectangle", Series("rectangle", t, longest.y, truth(what, t))),
        ("corner", _series("corner", points[:, 0], what)),
        ("nearest", _series("nearest", points[:, 1], what)),
    ]


def truth(what: Scenario, t: Array) -> Truth:
    """The car's exact motion at times t (n,) from the scenario's beginning [s]."""
    s = simulate.truth_at(what, t)[CAR]
    course = s.yaw + s.slip
    v = s.speed[:, None] * np.column_stack([np.cos(course), np.sin(course)])
    return Truth(t, np.column_stack([s.x, s.y]), v, s.yaw)


def _series(name: str, points: Array, what: Scenario) -> Series:
    """Points (n, 3) of time and place, NaN: not seen, as measurements of a position alone."""
    seen = np.flatnonzero(np.isfinite(points[:, 1]))
    points = points[seen[0] : seen[-1] + 1]
    y = np.tile(np.array(Measurement(np.nan, np.nan)), (len(points), 1))
    y[:, :2] = points[:, 1:]
    return Series(name, points[:, 0], y, truth(what, points[:, 0]))


def _returns(scan: Scan, W_car: Array, W_corner: Array, settings: Detect) -> Array | None:
    """Time [s] and place [m] (2, 3) of the return next to the front corner, and of that next to the sensor.

    Of the segments with their middle on the car; None: there is none, NaN: the corner is not seen.
    """
    s = segment(scan, settings)
    parts = [s.beams[a:b] for a, b in zip(s.start, s.stop, strict=True)]
    own = [part for part in parts if np.hypot(*(scan.W_p[part].mean(axis=0) - W_car)) < GATE_M]
    if not own:
        return None
    beams = np.concatenate(own)
    off = np.hypot(*(scan.W_p[beams] - W_corner).T)
    picked = beams[[np.argmin(off), np.argmin(scan.range[beams])]]
    rows = np.column_stack([scan.beam_t[picked] - EPOCH_S, scan.W_p[picked]])
    rows[0, 1:] = np.where(off.min() < CORNER_M, rows[0, 1:], np.nan)
    return rows


# ------------------------------------------------------------------ series to tracks and scores


def _run(number: int, kind: Input, series: Series) -> Run:
    true = Track(series.truth.W_p, series.truth.W_v, np.unwrap(series.truth.yaw))
    tracks = {"truth": true, "reference": reference(series)}
    for label in dict.fromkeys((*LABELS, *THETAS, *NOISES)):
        observer, g = gains(label)
        tracks[label] = _track(compare.estimate(observer, g, series), true)
    scores = {label: score(track, tracks["reference"], series) for label, track in tracks.items()}
    return Run(number, kind, series, tracks, scores, hops(series))


def _track(e: Estimate, true: Track) -> Track:
    m = Motion(*e.motion.T)
    v = np.asarray(m.speed)[:, None] * np.column_stack([np.cos(m.course), np.sin(m.course)])
    return Track(e.motion[:, :2], v, true.yaw + wrap(m.yaw - true.yaw))


def reference(series: Series, cutoff: float = CUTOFF_HZ) -> Track:
    """Positions through a low-pass forward and backward, and their derivative; the yaw is its direction.

    As the source: `filtfilt`, and all of the recording is known. Butterworth of `ORDER` at `cutoff` [Hz].
    """
    from scipy.signal import butter, filtfilt

    seen = np.isfinite(series.y[:, 0])
    n = round((series.t[-1] - series.t[0]) * RATE_HZ) + 1
    even = np.linspace(series.t[0], series.t[-1], n)
    b, a = butter(ORDER, cutoff, fs=(n - 1) / (even[-1] - even[0]))
    given = np.column_stack([np.interp(even, series.t[seen], column[seen]) for column in series.y[:, :2].T])
    smooth = filtfilt(b, a, given, axis=0)
    both = np.column_stack([smooth, np.gradient(smooth, even, axis=0)])
    p, v = np.split(np.column_stack([np.interp(series.t, even, c) for c in both.T]), 2, axis=1)
    true = np.unwrap(series.truth.yaw)
    return Track(p, v, true + wrap(np.arctan2(v[:, 1], v[:, 0]) - true))


def hops(series: Series) -> tuple[float, float]:
    """Share of scans in which the measured point hops over the body, and the longest way [m]."""
    A_p = rotate(series.y[:, :2] - series.truth.W_p, -series.truth.yaw)
    way = np.hypot(*np.diff(A_p, axis=0).T)
    way = way[np.isfinite(way)]
    return float(np.mean(way > HOP_M)), float(way.max())


def score(track: Track, against: Track, series: Series) -> Score:
    """Figures of a track over the scans that count; see Score."""
    late = counted(series)
    t, v, yaw = series.t[late], track.v[late], track.yaw[late]
    dv, dv_ref = v - series.truth.W_v[late], v - against.v[late]
    dyaw, dyaw_ref = wrap(yaw - series.truth.yaw[late]), wrap(yaw - against.yaw[late])
    begin, end = t < t[0] + 1.0, t > t[-1] - 1.0
    return Score(
        velocity=_rms(np.hypot(*dv.T)),
        yaw=_rms(dyaw),
        velocity_ref=_rms(np.hypot(*dv_ref.T)),
        yaw_ref=_rms(dyaw_ref),
        rough_speed=_rms(np.diff(np.hypot(*v.T), 2)),
        rough_yaw=_rms(np.diff(np.unwrap(yaw), 2)),
        delay=_delay(t, v, against, series.t),
        settled=_settled(series.t, track.v - against.v),
        begin=float(yaw[begin].mean()),
        end=float(yaw[end].mean()),
        sway=float(np.abs(yaw - yaw.mean()).max()),
        off=float(np.abs(dyaw).max()),
        push=float(np.polyfit(t - t[0], np.hypot(*v.T), 1)[0]),
    )


def counted(series: Series) -> Bools:
    """The scans that count: later than `SKIP_S` after the first."""
    late: Bools = series.t - series.t[0] >= SKIP_S - 1e-6
    return late


def _delay(t: Array, v: Array, against: Track, at: Array) -> float:
    """The shift in time that brings the reference, given at times `at`, nearest to v (n, 2) at t (n,) [s]."""
    shifts = np.arange(-0.3, LATEST_S + 0.005, 0.01)
    then = t[:, None] - shifts
    off = sum((v[:, [k]] - np.interp(then, at, against.v[:, k])) ** 2 for k in range(2))
    return float(shifts[np.argmin(np.sum(off, axis=0))])


def _settled(t: Array, dv: Array) -> float:
    """Time until dv (n, 2) is below `NEAR_MPS` for `STAY` scans in a row; all of it: never [s]."""
    near = (np.hypot(*dv.T) < NEAR_MPS).astype(int)
    stays = np.flatnonzero(np.convolve(near, np.ones(STAY, int), "valid") == STAY)
    return float(t[stays[0] if len(stays) else -1] - t[0])


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))
