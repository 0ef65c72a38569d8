"""Threats -> one alert a scan: ladder, debounce, hysteresis, and why the warning cannot be trusted.

Pure functions; what must be remembered is handed in and out. Reasons and sources: docs/warnings.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from outrider import settings
from outrider.errors import InputError
from outrider.records import Alert, Array, Bools, Ints, Level, Scan, Threats, Tracks, TrackState

NEVER = -np.inf
# Faults of a scan that degrade the warning.
UNTRUSTED = ("ego pose stale", "ego pose frozen", "no ego pose", "lost on the way")


class Run(NamedTuple):
    """What is remembered of one track; the tuples hold NOTICE, CAUTION, DANGER in this order."""

    scans: tuple[int, ...] = (0, 0, 0)  # scans in a row that asked for at least this level
    asked: tuple[float, ...] = (
        NEVER,
        NEVER,
        NEVER,
    )  # when a raised level was last asked for [s]; NEVER: not up

    @property
    def level(self) -> Level:
        """Highest level that is up."""
        return Level(sum(t > NEVER for t in self.asked))


@dataclass(frozen=True, slots=True)
class AlertMemory:
    """What one scan's alert hands to the next."""

    t: float | None  # time of the last scan [s], None before the first
    runs: dict[int, Run]  # by track id; only tracks that ask or are up


def start() -> AlertMemory:
    """Memory before the first scan."""
    return AlertMemory(None, {})


def alert(
    memory: AlertMemory, threats: Threats, tracks: Tracks, health: tuple[str, ...], limits: settings.Alert
) -> tuple[AlertMemory, Alert]:
    """The alert after one scan, about the track with the highest level and then the least ttc.

    A level goes up when a track asks for it in `limits.debounce_scans` scans in a row, and comes down when
    it has not been asked for during `limits.release_s`. `health` (see the function) marks the alert and never
    lowers it; tracks that could not be assessed are added to its reasons.

    Raises InputError for a ladder out of order.
    """
    if not limits.notice_s >= limits.caution_s >= limits.danger_s:
        ladder = f"{limits.notice_s}, {limits.caution_s}, {limits.danger_s} s"
        raise InputError(f"alert ladder is {ladder}: want notice_s >= caution_s >= danger_s")
    t = threats.t
    asking = zip(threats.id.tolist(), _wanted(threats, tracks, limits).tolist(), strict=True)
    wanted = {i: level for i, level in asking if level}
    runs = {}
    for i in sorted(memory.runs.keys() | wanted.keys()):
        run = _next(memory.runs.get(i, Run()), wanted.get(i, 0), t, limits)
        if any(run.scans) or run.level:
            runs[i] = run
    ttc = dict(zip(threats.id.tolist(), _times(threats, limits).tolist(), strict=True))
    level, _, track = max(((r.level, -ttc.get(i, np.inf), -i) for i, r in runs.items()), default=(0, 0.0, 1))
    track = -track if level else -1
    lost = int(np.sum(~np.isfinite(threats.closest_distance)))
    reasons = (*health, f"{lost} of {len(threats.id)} tracks could not be assessed") if lost else health
    broken = int(np.sum(tracks.broken & _heard(tracks)))
    if broken and limits.act_on == "earliest":
        reasons = (*reasons, f"the bounds of {broken} of {len(threats.id)} tracks did not hold")
    return AlertMemory(t, runs), Alert(t, Level(level), track, ttc.get(track, np.inf), reasons)


def _times(threats: Threats, limits: settings.Alert) -> Array:
    """Time to collision (n,) that is acted on [s]."""
    return threats.ttc_earliest if limits.act_on == "earliest" else threats.ttc


def _heard(tracks: Tracks) -> Bools:
    """Which tracks (n,) may raise an alert: those that move."""
    heard: Bools = (tracks.state == TrackState.CONFIRMED) | (tracks.state == TrackState.COASTING)
    return heard


def _wanted(threats: Threats, tracks: Tracks, limits: settings.Alert) -> Ints:
    """Level (n,) each track asks for in this scan; by the earliest contact, its path need not be a threat."""
    heard = _heard(tracks)
    if limits.act_on == "expected":
        heard &= threats.in_corridor & (threats.closing_speed >= limits.min_speed_mps)
    ladder = np.array([limits.notice_s, limits.caution_s, limits.danger_s])
    return np.where(heard, (_times(threats, limits)[:, None] <= ladder).sum(axis=1), 0).astype(np.int64)


def _next(run: Run, wanted: int, t: float, limits: settings.Alert) -> Run:
    """The run after a scan at t that asked for level `wanted`."""
    scans, asked = [], []
    for k, (n, last) in enumerate(zip(run.scans, run.asked, strict=True)):
        asks = wanted > k
        n = n + 1 if asks else 0
        last = min(last, t)  # the clock may have jumped back
        if asks and (last > NEVER or n >= limits.debounce_scans):
            last = t
        elif t - last > limits.release_s:
            last = NEVER
        scans.append(n)
        asked.append(last)
    return Run(tuple(scans), tuple(asked))


def health(scan: Scan, previous_t: float | None, limits: settings.Alert) -> tuple[str, ...]:
    """Why a warning from this scan cannot be trusted, in words; empty when it can.

    previous_t [s]: time of the scan before, None for the first. A missing ego pose (`ego.known` False) is no
    reason: the sensor is then taken as standing, by choice.
    """
    reasons = []
    gap = 0.0 if previous_t is None else scan.t - previous_t
    if previous_t is not None and gap <= 0.0:
        reasons.append(f"clock jumped back {-gap:.2f} s" if gap < 0.0 else "clock stood still")
    if gap > limits.stale_after_s:
        reasons.append(_late(gap, limits))
    share = float(scan.valid.mean()) if len(scan.valid) else 0.0
    if share < limits.min_valid:
        percent = f"{100.0 * share:.1f} % of {len(scan.valid)} beams"
        reasons.append(f"mostly invalid: {percent} have a return, want {100.0 * limits.min_valid:.1f} %")
    reasons += [fault for fault in scan.faults if fault.startswith(UNTRUSTED)]
    ego = scan.ego
    if not np.isfinite([*ego.W_pose, *ego.W_v, ego.yaw_rate]).all():
        reasons.append("ego pose not finite")
    return tuple(reasons)


def overdue(memory: AlertMemory, now: float, limits: settings.Alert) -> tuple[str, ...]:
    """Why warnings cannot be trusted while no scan comes, in words; for a live loop to ask between scans.

    now [s]: on the clock of the scans. The last alert's level stays as it was; this only marks it.
    """
    if memory.t is None:
        return ("no scan yet",)
    gap = now - memory.t
    return (_late(gap, limits),) if gap > limits.stale_after_s else ()


def _late(gap: float, limits: settings.Alert) -> str:
    return f"scans late: {gap:.2f} s since the last one, limit {limits.stale_after_s:.2f} s"
