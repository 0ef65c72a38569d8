"""When each beam was measured: the rule that repairs wrong headers, and what the ego motion tells."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from outrider import settings as st
from outrider.ego import columns
from outrider.geometry import TAU, Array, compose, interpolate_poses, rotate
from outrider.records import LaserScan, Pose

HEAD = 21  # scans whose stamps give the period
SCAN_TIME_TOLERANCE = 0.2  # of the period
SPAN = (0.5, 1.05)  # share of the period that |time_increment| * beams may cover
DEFAULT_PERIOD_S = 0.1  # of a single scan whose header says nothing usable

SURVEY_SCANS = 400  # head of a recording that is searched for ego motion
DETECT_SCANS = 100  # scans in motion that are compared
MIN_SCANS = 20
BLOCK = 10  # scans in a row that go to the same half
MOVING = 0.1  # [m/s] or [rad/s]
MIN_GAIN = 0.05  # entropy [nat] by which one direction must beat the other
CELL_SHARE = 0.02  # side of a grid cell / median range


def scan_stamp_s(scan: LaserScan) -> float:
    """Header stamp since the epoch [s], or the receive time where the driver writes 0."""
    return (scan.stamp_ns or scan.received_ns) * 1e-9


@dataclass(frozen=True, slots=True)
class BeamTiming:
    """Times of the beams of one scan."""

    period: float  # between scans [s]
    time_increment: float  # between beams in storage order, negative where stored against time [s]
    stamp_offset: float  # time of beam 0 minus the header stamp [s]
    repaired: bool  # time_increment is not the header's
    repairs: tuple[str, ...]  # what was repaired, in words

    def beam_t(self, stamp: float, n: int) -> Array:
        """Times (n,) of the beams [s]."""
        return stamp + self.stamp_offset + self.time_increment * np.arange(n, dtype=np.float64)

    def end(self, stamp: float, n: int) -> float:
        """Time of the last beam in time [s]; of a scan without beams: where that beam would have been."""
        forward = self.time_increment > 0.0
        span = self.time_increment * (n - 1) if n else self.period
        return stamp + self.stamp_offset + (span if forward else 0.0)


@dataclass(frozen=True, slots=True)
class TimingEstimate:
    """What the ego motion says about order and offset of the beams; entropies in nats, lower is sharper."""

    time_increment: float  # of the sharper direction, magnitude as repaired [s]
    stamp_offset: float  # of the sharpest offset [s]
    forward: float  # least entropy with beams in storage order
    backward: float  # least entropy with beams stored against time
    scans: int  # that were compared
    confident: bool

    @property
    def words(self) -> str:
        """One line for people."""
        if not self.confident:
            return "order of the beams not found from ego motion: sign of the header kept"
        way = "against" if self.time_increment < 0.0 else "with"
        return (
            f"order of the beams found from ego motion: {way} time, beam 0 at stamp "
            f"{self.stamp_offset:+.4f} s (entropy forward {self.forward:.2f}, backward {self.backward:.2f}, "
            f"{self.scans} scans)"
        )


def measure_period(stamps: Sequence[float]) -> float:
    """Time of one turn [s] from header stamps (m,) [s]; NaN with fewer than two different ones.

    Median of the steps, then the mean of the steps within 20 % of it: a driver that stamps by its packets
    alternates between two steps, and their mean is the turn.
    """
    steps = np.diff(np.asarray(stamps, float))
    steps = steps[steps > 0.0]
    if not len(steps):
        return math.nan
    middle = float(np.sort(steps)[(len(steps) - 1) // 2])
    return float(steps[np.abs(steps - middle) <= 0.2 * middle].mean())


def resolve(
    scan: LaserScan, period: float, user: st.Timing, estimate: TimingEstimate | None = None
) -> BeamTiming:
    """Timing of a scan from its header, the measured period (NaN: unknown), the user and the ego motion.

    The rule is stated in docs/scans.md. What the user sets is never repaired.
    """
    repairs: list[str] = []
    turn = _turn(scan, period, user, repairs)
    n = _beams(scan)
    increment, offset = scan.time_increment, 0.0
    repaired = False
    if user.time_increment_s is not None:
        increment = user.time_increment_s
    elif not SPAN[0] * turn <= abs(increment) * n <= SPAN[1] * turn:
        repaired = True
        increment = math.copysign(_nominal_increment(scan, turn), 1.0 if math.isnan(increment) else increment)
        if estimate is not None and estimate.confident:
            increment = math.copysign(increment, estimate.time_increment)
            offset = estimate.stamp_offset
        repairs.append(f"time_increment repaired: header {scan.time_increment:.3g} s, now {increment:.3g} s")
    if user.stamp_offset_s is not None:
        offset = user.stamp_offset_s
    return BeamTiming(turn, increment, offset, repaired, tuple(repairs))


def _turn(scan: LaserScan, period: float, user: st.Timing, repairs: list[str]) -> float:
    """Time of one turn [s]; a repair is added to `repairs`."""
    if user.scan_time_s is not None:
        return user.scan_time_s
    if math.isnan(period):
        usable = math.isfinite(scan.scan_time) and scan.scan_time > 1e-3
        if not usable:
            repairs.append(f"scan_time repaired: header {scan.scan_time:.3g} s, one scan only, 0.1 s taken")
        return scan.scan_time if usable else DEFAULT_PERIOD_S
    if not abs(scan.scan_time - period) <= SCAN_TIME_TOLERANCE * period:
        repairs.append(f"scan_time repaired: header {scan.scan_time:.3g} s, stamps say {period:.4f} s")
    return period


def _beams(scan: LaserScan) -> int:
    """Number of beams, at least 1; of a scan without any: as many as fit on a circle."""
    step = abs(scan.angle_increment)
    return len(scan.ranges) or (max(1, round(TAU / step)) if math.isfinite(step) and step > 1e-6 else 1)


def _nominal_increment(scan: LaserScan, turn: float) -> float:
    """Time between beams of a mirror that turns evenly [s]: the share of the circle between two beams."""
    even = turn / _beams(scan)
    share = abs(scan.angle_increment) / TAU
    return min(even, turn * share) if math.isfinite(share) and share > 0.0 else even


def survey(
    messages: Iterable[LaserScan | Pose], scan_topic: str, ego_topic: str | None, settings: st.Settings
) -> TimingEstimate | None:
    """First pass over the head of a recording: `detect` where the rule of docs/scans.md asks for it.

    None where time_increment needs no repair, the user has set it, or there is no ego pose to judge by.
    At most SURVEY_SCANS scans are read.
    """
    if ego_topic is None or settings.timing.time_increment_s is not None:
        return None
    scans: list[LaserScan] = []
    poses: list[Pose] = []
    for message in messages:
        if isinstance(message, Pose):
            if message.topic == ego_topic:
                poses.append(message)
        elif message.topic == scan_topic:
            scans.append(message)
            if len(scans) == HEAD and not _doubtful(scans, settings):
                return None
            if len(scans) == SURVEY_SCANS:
                break
    if not scans or not poses or not _doubtful(scans, settings):
        return None
    return detect(scans, poses, settings)


def _doubtful(scans: list[LaserScan], settings: st.Settings) -> bool:
    period = measure_period([scan_stamp_s(s) for s in scans[:HEAD]])
    return resolve(scans[0], period, settings.timing).repaired


def detect(scans: Sequence[LaserScan], poses: Sequence[Pose], settings: st.Settings) -> TimingEstimate:
    """Order and offset of the beams that make the standing world sharpest in the fixed frame.

    Both directions and offsets within one period of the stamp are tried; sharpness is the entropy of all
    returns on a grid. Confident when the better direction wins by MIN_GAIN, away from the edge of the
    offsets, and two halves of the scans, cut into alternating blocks, each choose it with offsets at most a
    quarter period apart. Lengths of scans and poses in the recording's metres; settings.mount must be right
    to a few degrees and centimetres.
    """
    period = measure_period([scan_stamp_s(s) for s in scans[:HEAD]])
    timing = resolve(scans[0], period, settings.timing)
    period, step = timing.period, abs(timing.time_increment)
    pose_t, pose = columns(poses)
    chosen = _in_motion(scans, pose_t, pose, period)
    if len(chosen) < MIN_SCANS:
        return TimingEstimate(timing.time_increment, 0.0, math.nan, math.nan, len(chosen), False)
    fixed = settings.timing.stamp_offset_s
    halves = ([s for i, s in enumerate(chosen) if i // BLOCK % 2 == k] for k in (0, 1))
    whole, one, two = (
        _best(_Returns.of(part, pose_t, pose, settings.mount), step, period, fixed)
        for part in (chosen, *halves)
    )
    forward, backward = whole
    sign = 1.0 if forward[0] < backward[0] else -1.0
    i = 0 if sign > 0.0 else 1
    confident = (
        abs(forward[0] - backward[0]) >= MIN_GAIN
        and all(h[i][0] < h[1 - i][0] for h in (one, two))
        and abs(one[i][1] - two[i][1]) <= 0.25 * period
        and (fixed is not None or abs(whole[i][1]) < period)
    )
    return TimingEstimate(sign * step, whole[i][1], forward[0], backward[0], len(chosen), confident)


def _in_motion(scans: Sequence[LaserScan], t: Array, poses: Array, period: float) -> list[LaserScan]:
    """The first DETECT_SCANS scans during which the body moves and its poses are there."""
    if len(t) < 2:
        return []
    stamps = np.array([scan_stamp_s(s) for s in scans])
    covered = (stamps - period >= t[0]) & (stamps + 2.0 * period <= t[-1])
    step = interpolate_poses(t, poses, stamps + period) - interpolate_poses(t, poses, stamps)
    step[:, 2] = np.arctan2(np.sin(step[:, 2]), np.cos(step[:, 2]))
    moving = np.maximum(np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])) > MOVING * period
    return [scans[i] for i in np.flatnonzero(covered & moving)[:DETECT_SCANS]]


@dataclass(frozen=True, slots=True)
class _Returns:
    """All returns of some scans, one row each, with what is needed to place them in the fixed frame."""

    stamp: Array  # (m,) of the scan [s]
    beam: Array  # (m,) index of the beam
    S_p: Array  # (m, 2) [m]
    pose_t: Array
    pose: Array
    mount: Array  # (3,)
    cell: float  # [m]

    @classmethod
    def of(cls, scans: Sequence[LaserScan], pose_t: Array, pose: Array, mount: st.Mount) -> _Returns:
        stamp, beam, S_p = [], [], []
        for scan in scans:
            r = scan.ranges.astype(float)
            top = scan.range_max if scan.range_max > 0.0 else math.inf
            i = np.flatnonzero(np.isfinite(r) & (r > max(scan.range_min, 0.0)) & (r < top))
            ray = np.column_stack([r[i], np.zeros(len(i))])
            stamp.append(np.full(len(i), scan_stamp_s(scan)))
            beam.append(i.astype(float))
            S_p.append(rotate(ray, scan.angle_min + scan.angle_increment * i))
        p = np.concatenate(S_p)
        cell = CELL_SHARE * float(np.median(np.hypot(p[:, 0], p[:, 1]))) if len(p) else 1.0
        on_body = np.array([mount.x_m, mount.y_m, mount.yaw_rad])
        return cls(np.concatenate(stamp), np.concatenate(beam), p, pose_t, pose, on_body, cell)

    def entropy(self, time_increment: float, offset: float) -> float:
        """Of the returns on the grid, placed with this timing [nat]."""
        body = interpolate_poses(self.pose_t, self.pose, self.stamp + offset + time_increment * self.beam)
        sensor = compose(body, np.broadcast_to(self.mount, body.shape))
        W_p = sensor[:, :2] + rotate(self.S_p, sensor[:, 2])
        at = np.floor((W_p - W_p.min(axis=0, initial=0.0)) / self.cell)
        _, count = np.unique(at[:, 0] * (at[:, 1].max(initial=0.0) + 1.0) + at[:, 1], return_counts=True)
        share = count / max(1, len(W_p))
        return float(-(share * np.log(share)).sum())


def _best(
    returns: _Returns, step: float, period: float, fixed: float | None
) -> tuple[tuple[float, float], tuple[float, float]]:
    """(least entropy, its offset [s]) of the forward and of the backward order."""

    def search(increment: float) -> tuple[float, float]:
        if fixed is not None:
            return returns.entropy(increment, fixed), fixed
        offsets = period * np.linspace(-1.0, 1.0, 17)
        coarse = [returns.entropy(increment, float(o)) for o in offsets]
        best = float(offsets[int(np.argmin(coarse))])
        near = best + period * np.linspace(-0.125, 0.125, 9)
        fine = [returns.entropy(increment, float(o)) for o in near]
        return min(fine), float(near[int(np.argmin(fine))])

    return search(step), search(-step)
