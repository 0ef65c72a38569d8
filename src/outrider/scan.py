"""From messages in receive order to repaired scans in time order, and a count of all that was wrong."""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from outrider.ego import EgoBuffer, pose_stamp_s
from outrider.records import LaserScan, Pose, Scan
from outrider.repair import BACK, GAP, POSE_BEGINS, SKIPPED, TOLD_ONCE, kind, repair
from outrider.settings import Settings
from outrider.timing import HEAD, BeamTiming, TimingEstimate, measure_period, resolve, scan_stamp_s

BACK_S = 1.0  # a clock that goes back by more has been restarted; by less, the scan is late
GAP_S = 0.5  # between scans: longer, and longer than GAP_PERIODS, is a gap
GAP_PERIODS = 3.0
KEEP_POSES_S = 10.0  # while no scan waits for them
POSE_WAIT_S = 0.2  # beyond one period: how long a scan waits for the pose after its last beam, receive time


@dataclass(slots=True)
class ScanReport:
    """What came in, what was repaired and what was left out, over a whole stream; plain numbers and words."""

    scans_in: int = 0
    scans_out: int = 0
    poses_in: int = 0
    poses_left_out: int = 0  # not finite, no quaternion, or not later than the one before
    beams: int = 0
    valid: int = 0
    masked: dict[str, int] = field(default_factory=dict)  # beams, by reason
    skipped: dict[str, int] = field(default_factory=dict)  # scans, by reason
    faults: dict[str, int] = field(default_factory=dict)  # scans, by kind of fault
    period_s: float = math.nan
    time_increment_s: float = math.nan  # of the first scan
    stamp_offset_s: float = math.nan
    repairs: list[str] = field(default_factory=list)  # of the driver's mistakes, in words, each once

    def as_dict(self) -> dict[str, Any]:
        """For summary.json; numbers that are not known are None."""
        values = dataclasses.asdict(self)
        return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in values.items()}


class ScanStream:
    """Messages in receive order in, repaired scans in time order out: iterate over it, or `feed` it live.

    A scan is held until a pose later than its last beam has come, or has kept it waiting for POSE_WAIT_S
    beyond one period of receive time. The first scans are held until `head` of them have told the period.
    Memory stays flat. `report` counts everything, at any time.
    """

    def __init__(
        self,
        messages: Iterable[LaserScan | Pose],
        scan_topic: str,
        ego_topic: str | None,
        settings: Settings,
        estimate: TimingEstimate | None = None,
        head: int = HEAD,
    ) -> None:
        self.report = ScanReport()
        self._messages, self._scan_topic, self._ego_topic = messages, scan_topic, ego_topic
        self._settings, self._estimate, self._head = settings, estimate, head
        self._ego = EgoBuffer(settings.recording.scale) if ego_topic is not None else None
        self._waiting: deque[tuple[LaserScan, list[str]]] = deque()
        self._period: float | None = None
        self._stamp = -math.inf  # of the last scan taken
        self._end = -math.inf  # of the last scan given
        self._skipped: dict[str, int] = {}  # since the last scan taken
        self._missing_pose = False  # scans went out without a pose
        self._told: set[str] = set()

    def __iter__(self) -> Iterator[Scan]:
        for message in self._messages:
            yield from self.feed(message)
        yield from self.finish()

    def feed(self, message: LaserScan | Pose) -> list[Scan]:
        """Scans that became ready with this message, in time order."""
        ready: list[Scan] = []
        if isinstance(message, LaserScan):
            if message.topic == self._scan_topic:
                ready += self._take_scan(message)
        elif self._ego is not None and message.topic == self._ego_topic:
            ready += self._take_pose(message, self._ego)
        if self._period is None and len(self._waiting) >= self._head:
            self._settle()
        while self._period is not None and self._waiting and self._ready(message.received_ns):
            ready += self._give()
        return ready

    def finish(self) -> list[Scan]:
        """Scans still held when no more messages come."""
        if self._period is None and self._waiting:
            self._settle()
        ready: list[Scan] = []
        while self._waiting:
            ready += self._give()
        return ready

    def _settle(self) -> None:
        self._period = measure_period([scan_stamp_s(raw) for raw, _ in self._waiting])

    def _restart(self) -> list[Scan]:
        """The scans from before the clock jumped; a period not known yet is measured again."""
        before = self.finish()
        if self._period is not None and math.isnan(self._period):
            self._period = None
        return before

    def _take_scan(self, raw: LaserScan) -> list[Scan]:
        """Queue a scan, or skip it; a clock that has jumped back empties the queue first."""
        self.report.scans_in += 1
        stamp = scan_stamp_s(raw)
        step = stamp - self._stamp
        if -BACK_S <= step <= 0.0:
            self._skip("duplicated stamp" if step == 0.0 else "out of order")
            return []
        ready: list[Scan] = []
        faults = [f"{SKIPPED}: {reason}, {count} of them" for reason, count in self._skipped.items()]
        if step < 0.0:
            ready = self._restart()
            faults.append(f"{BACK} by {-step:.1f} s")
            if self._ego and self._ego.newest > stamp + BACK_S:
                self._ego.clear()
        elif math.isfinite(step) and step > max(GAP_S, GAP_PERIODS * (self._period or 0.0)):
            faults.append(f"{GAP} of {step:.1f} s")
        self._stamp, self._skipped = stamp, {}
        self._waiting.append((raw, faults))
        return ready

    def _skip(self, reason: str) -> None:
        """Count a scan that is left out; the next one taken tells."""
        _count(self._skipped, reason)
        _count(self.report.skipped, reason)

    def _take_pose(self, pose: Pose, ego: EgoBuffer) -> list[Scan]:
        """Keep a pose; a clock that has jumped back empties the queue and the buffer first."""
        self.report.poses_in += 1
        ready: list[Scan] = []
        if pose_stamp_s(pose) < ego.newest - BACK_S:
            ready = self._restart()
            ego.clear()
        if not ego.add(pose):
            self.report.poses_left_out += 1
        if not self._waiting:
            ego.forget(ego.newest - KEEP_POSES_S)
        return ready

    def _timing(self, raw: LaserScan) -> BeamTiming:
        period = math.nan if self._period is None else self._period
        return resolve(raw, period, self._settings.timing, self._estimate)

    def _ready(self, now_ns: int) -> bool:
        """Whether the oldest scan held has the poses it can get, at receive time `now_ns`."""
        if self._ego is None:
            return True
        raw, _ = self._waiting[0]
        timing = self._timing(raw)
        if self._ego.newest >= timing.end(scan_stamp_s(raw), len(raw.ranges)):
            return True
        waited = (now_ns - raw.received_ns) * 1e-9
        return not 0.0 <= waited <= POSE_WAIT_S + timing.period

    def _give(self) -> list[Scan]:
        """The oldest scan held, repaired, its faults counted; none if it ends before the last one."""
        raw, faults = self._waiting.popleft()
        timing = self._timing(raw)
        end = timing.end(scan_stamp_s(raw), len(raw.ranges))
        if end <= self._end and not any(fault.startswith(BACK) for fault in faults):
            self._skip("ends before the last one")
            return []
        self._end = end
        if self._ego is not None:
            self._ego.forget(scan_stamp_s(raw) - BACK_S)
            if self._ego and self._missing_pose:
                faults = [*faults, POSE_BEGINS]
            self._missing_pose = not self._ego
        scan = repair(raw, timing, self._ego, self._settings)
        notes = [*faults, *timing.repairs]
        if timing.repaired and self._estimate is not None and not self.report.scans_out:
            notes.append(self._estimate.words)
        return [self._tell(dataclasses.replace(scan, faults=(*notes, *scan.faults)), timing)]

    def _tell(self, scan: Scan, timing: BeamTiming) -> Scan:
        """The scan without what the driver's mistakes have been told for already; everything is counted."""
        report = self.report
        if not report.scans_out:
            report.period_s, report.time_increment_s = timing.period, timing.time_increment
            report.stamp_offset_s = timing.stamp_offset
        report.scans_out += 1
        report.beams += len(scan.valid)
        report.valid += int(np.count_nonzero(scan.valid))
        for reason, count in scan.masked.items():
            _count(report.masked, reason, count)
        fresh = []
        for fault in scan.faults:
            name = kind(fault)
            _count(report.faults, name)
            if name not in TOLD_ONCE:
                fresh.append(fault)
            elif name not in self._told:
                self._told.add(name)
                fresh.append(fault)
                report.repairs.append(fault)
        return dataclasses.replace(scan, faults=tuple(fresh))


def _count(counts: dict[str, int], name: str, more: int = 1) -> None:
    counts[name] = counts.get(name, 0) + more


def prepare(
    messages: Iterable[LaserScan | Pose],
    scan_topic: str,
    ego_topic: str | None,
    settings: Settings,
    estimate: TimingEstimate | None = None,
) -> Iterator[Scan]:
    """Repaired scans of one scanner from messages in receive order; `ScanStream` also gives the report."""
    return iter(ScanStream(messages, scan_topic, ego_topic, settings, estimate))
