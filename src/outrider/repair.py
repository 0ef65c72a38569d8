"""One raw scan made ready: masked, scaled, every beam at its own time in the fixed frame (docs/scans.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from outrider.ego import REACH_S, EgoBuffer, standing
from outrider.geometry import Array, wrap
from outrider.records import Bools, Ego, Float32s, LaserScan, Scan
from outrider.settings import Mount, Settings
from outrider.timing import BeamTiming, scan_stamp_s

# What the words in Scan.faults begin with; counted under these names in ScanReport.faults.
BACK = "clock jumped back"
GAP = "gap"
SKIPPED = "scan skipped"
NO_BEAMS = "no beams"
NO_RETURN = "no valid beam"
BAD_ANGLES = "angles unusable"
LIMITS = "range limits repaired"
INTENSITIES = "intensities dropped"
NO_STAMP = "no header stamp"
SCAN_TIME = "scan_time repaired"
TIME_INCREMENT = "time_increment repaired"
ORDER = "order of the beams"
LOST = "lost on the way"
FORGOTTEN = "all before forgotten"
POSE_MISSING = "no ego pose yet"
POSE_BEGINS = "ego pose begins"
POSE_STALE = "ego pose stale"
POSE_FROZEN = "ego pose frozen"
KINDS = (
    *(BACK, GAP, SKIPPED, NO_BEAMS, NO_RETURN, BAD_ANGLES, LIMITS, INTENSITIES, NO_STAMP),
    *(SCAN_TIME, TIME_INCREMENT, ORDER, POSE_MISSING, POSE_BEGINS, POSE_STALE, POSE_FROZEN),
    *(LOST, FORGOTTEN),  # of a live sensor alone
)
TOLD_ONCE = (NO_STAMP, SCAN_TIME, TIME_INCREMENT, ORDER, LIMITS)  # of the driver, not of the moment


def kind(fault: str) -> str:
    """Which of KINDS a text of Scan.faults is."""
    return next(k for k in KINDS if fault.startswith(k))


def restarts(scan: Scan) -> bool:
    """Whether all memory from before this scan must be dropped: the clock or the fixed frame is another."""
    return any(f.startswith((BACK, POSE_BEGINS, FORGOTTEN)) for f in scan.faults)


def mask(ranges: Float32s, range_min: float, range_max: float) -> tuple[Bools, dict[str, int]]:
    """Valid beams (n,) and how many were masked by reason; each beam has one reason at most.

    Limits in the unit of `ranges`. A range at or above range_max is a driver's way to say "no return".
    """
    nan, inf = np.isnan(ranges), np.isinf(ranges)
    with np.errstate(invalid="ignore", over="ignore"):
        low = ranges <= 0.0
        near = (ranges < range_min) & ~low
        far = ranges >= range_max
    reasons = {"nan": nan, "infinite": inf, "not_positive": low & ~inf}
    reasons |= {"below_min": near & ~inf, "above_max": far & ~inf & ~low & ~near}
    valid = ~(nan | inf | low | near | far)
    counts = {reason: int(np.count_nonzero(where)) for reason, where in reasons.items()}
    return valid, {reason: count for reason, count in counts.items() if count}


class Beams(NamedTuple):
    """What a sensor says of one turn, each beam with its own time; lengths in the recording's metres."""

    begin: float  # when the turn began, as far as is known without beams [s]
    t: float  # time of the last beam in time [s]
    beam_t: Array  # (n,) [s]
    angle: Array | None  # (n,) in S [rad]; None where it cannot be used
    ranges: Float32s  # (n,) [m]
    intensities: Float32s  # (n,), or any other length where there are none
    range_min: float  # [m]
    range_max: float  # [m]


def repair(raw: LaserScan, timing: BeamTiming, ego: EgoBuffer | None, settings: Settings) -> Scan:
    """One raw scan made ready: masked, scaled, every beam at its own time in W.

    `ego` None or without poses: the sensor stands, W is the body's frame. Never raises for bad sensor data;
    what was wrong is in Scan.masked and Scan.faults.
    """
    faults: list[str] = [f"{NO_STAMP}: receive time taken"] if raw.stamp_ns == 0 else []
    n, stamp = len(raw.ranges), scan_stamp_s(raw)
    angle = _angles(raw, faults)
    limits = _limits(raw, settings, faults)
    t, beam_t = timing.end(stamp, n), timing.beam_t(stamp, n)
    return place(Beams(stamp, t, beam_t, angle, raw.ranges, raw.intensities, *limits), ego, settings, faults)


def place(beams: Beams, ego: EgoBuffer | None, settings: Settings, faults: Sequence[str] = ()) -> Scan:
    """Beams masked, scaled and put where they were in W; `ego` as for `repair`, `faults` known before."""
    told, n, scale = list(faults), len(beams.ranges), settings.recording.scale
    if beams.angle is None:
        angle, valid, masked = np.zeros(n), np.zeros(n, bool), {"no_angle": n}
    else:
        angle, (valid, masked) = beams.angle, mask(beams.ranges, beams.range_min, beams.range_max)
    if not valid.any():
        told.append(NO_RETURN if n else NO_BEAMS)
    distance = np.where(valid, scale * beams.ranges.astype(float), np.nan)
    body, W_body = _body(beams.t, beams.beam_t, ego)
    W_sensor = np.array(np.broadcast_to(_mounted(W_body, settings), (n, 3)), order="C")
    W_p = W_sensor[:, :2] + polar(distance, angle + W_sensor[:, 2])
    intensity = _intensity(beams, told)
    if ego is not None:
        told += _pose_faults(ego, beams.begin, beams.t, beams.beam_t)
    seen = (beams.t, beams.beam_t, angle, distance, valid, intensity, scale * beams.range_max)
    return Scan(*seen, W_sensor, W_p, body, masked, tuple(told))


def polar(distance: Array, bearing: Array) -> Array:
    """Points (n, 2) at distance (n,) and bearing (n,) [rad] from the origin; NaN where either is NaN."""
    p = np.empty((len(distance), 2))
    p[:, 0] = distance * np.cos(bearing)
    p[:, 1] = distance * np.sin(bearing)
    return p


def _angles(raw: LaserScan, faults: list[str]) -> Array | None:
    """Angles (n,) of the beams in S [rad]; None where they cannot be used."""
    n = len(raw.ranges)
    finite = math.isfinite(raw.angle_min) and math.isfinite(raw.angle_increment)
    if n and (not finite or (raw.angle_increment == 0.0 and n > 1)):
        faults.append(f"{BAD_ANGLES}: angle_min {raw.angle_min:g}, angle_increment {raw.angle_increment:g}")
        return None
    return raw.angle_min + raw.angle_increment * np.arange(n, dtype=np.float64)


def _limits(raw: LaserScan, settings: Settings, faults: list[str]) -> tuple[float, float]:
    """(range_min, range_max) in the recording's metres, as the header says or repaired."""
    low, high = raw.range_min, raw.range_max
    if not (math.isfinite(low) and low >= 0.0):
        faults.append(f"{LIMITS}: range_min {low:g}, 0 m taken")
        low = 0.0
    if not (math.isfinite(high) and high > low):
        farthest = settings.detect.max_range_m / settings.recording.scale
        faults.append(f"{LIMITS}: range_max {high:g}, {farthest:g} m taken")
        high = farthest
    return low, high


def _intensity(beams: Beams, faults: list[str]) -> Float32s:
    """Intensities (n,), or (0,) where there are none or not one a beam."""
    if len(beams.intensities) in (0, len(beams.ranges)):
        return beams.intensities
    faults.append(f"{INTENSITIES}: {len(beams.intensities)} for {len(beams.ranges)} beams")
    return beams.intensities[:0]


def _body(t: float, beam_t: Array, ego: EgoBuffer | None) -> tuple[Ego, Array]:
    """The body at t, the time of the last beam [s], and its poses (n, 3) at the beams or (1, 3) for all."""
    if not ego:
        return standing(t), np.zeros((1, 3))
    poses = ego.at(beam_t if len(beam_t) else np.array([t]))
    latest = poses[-1] if len(beam_t) and beam_t[-1] > beam_t[0] else poses[0]
    return ego.ego(t, latest.copy()), poses


def _mounted(W_body: Array, settings: Settings) -> Array:
    """Poses (n, 3) of the sensor in W [m, m, rad], fixed on the body at W_body (n, 3)."""
    mount, scale = settings.mount, settings.recording.scale
    if mount == Mount():
        return W_body
    x, y = scale * mount.x_m, scale * mount.y_m
    c, s = np.cos(W_body[:, 2]), np.sin(W_body[:, 2])
    sensor = np.empty_like(W_body)
    sensor[:, 0] = W_body[:, 0] + c * x - s * y
    sensor[:, 1] = W_body[:, 1] + s * x + c * y
    sensor[:, 2] = wrap(W_body[:, 2] + mount.yaw_rad)
    return sensor


def _pose_faults(ego: EgoBuffer, stamp: float, t: float, beam_t: Array) -> list[str]:
    """What is wrong with the ego pose during a scan."""
    if not ego:
        return [POSE_MISSING]
    faults = []
    first = float(min(beam_t[0], beam_t[-1])) if len(beam_t) else stamp
    stale = ego.staleness(first, t)
    if stale > REACH_S:
        faults.append(f"{POSE_STALE} by {stale:.2f} s")
    if not math.isnan(ego.frozen_since):
        faults.append(f"{POSE_FROZEN} since {ego.frozen_since:.3f} s")
    return faults
