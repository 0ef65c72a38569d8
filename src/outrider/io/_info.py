"""What is inside a recording: the numbers behind `outrider info`."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from outrider.errors import InputError
from outrider.io._choose import Chosen, choose_topics
from outrider.io._recording import Message, Recording, Topic
from outrider.records import LaserScan

NS = 1e-9


@dataclass(frozen=True, slots=True)
class ScanInfo:
    """The scans of one topic; pairs are smallest and largest."""

    beams: tuple[int, int]
    angle_min_rad: tuple[float, float]
    angle_max_rad: tuple[float, float]
    angle_increment_rad: tuple[float, float]
    range_min_m: tuple[float, float]
    range_max_m: tuple[float, float]
    header_time_increment_s: tuple[float, float]  # as the driver says
    header_scan_time_s: tuple[float, float]
    period_s: float | None  # measured: median difference of the header stamps
    longest_gap_s: float | None
    backward_stamps: int  # scans whose header stamp is not after the one before
    has_intensities: bool
    invalid: dict[
        str, float
    ]  # share of all beams: nan, inf, zero (or less), below range_min, above range_max


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """The messages of one topic."""

    name: str
    type: str
    role: str  # "scan", "ego", "truth", "not used"
    count: int
    rate_hz: float | None  # by receive time
    first_s: float | None  # receive time of the first and the last message [s, the recording's clock]
    last_s: float | None
    delay_s: float | None  # median of receive time minus header stamp
    scan: ScanInfo | None


@dataclass(frozen=True, slots=True)
class Info:
    """A recording as `outrider info` shows it."""

    path: str
    format: str
    truncated: bool
    first_s: float | None
    duration_s: float
    chosen: Chosen | None
    problem: str  # why no topics could be chosen, or where the file is damaged; "" if all is well
    topics: tuple[TopicInfo, ...]


@dataclass(slots=True)
class _Clock:
    """Stamps of one topic: 16 bytes a message, an hour of 100 Hz is 6 MB."""

    stamps: array[int] = field(default_factory=lambda: array("q"))
    received: array[int] = field(default_factory=lambda: array("q"))


@dataclass(slots=True)
class _Beams:
    """Running ranges and counts of one scan topic."""

    low: dict[str, float] = field(default_factory=dict)
    high: dict[str, float] = field(default_factory=dict)
    total: int = 0
    invalid: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(("nan", "inf", "zero", "below", "above"), 0)
    )
    has_intensities: bool = False

    def add(self, scan: LaserScan) -> None:
        r, n = scan.ranges, len(scan.ranges)
        seen = {
            "beams": n,
            "angle_min": scan.angle_min,
            "angle_max": scan.angle_min + scan.angle_increment * max(n - 1, 0),
            "angle_increment": scan.angle_increment,
            "range_min": scan.range_min,
            "range_max": scan.range_max,
            "time_increment": scan.time_increment,
            "scan_time": scan.scan_time,
        }
        for name, value in seen.items():
            self.low[name] = min(self.low.get(name, value), value)
            self.high[name] = max(self.high.get(name, value), value)
        finite = np.isfinite(r)
        counts = {
            "nan": np.isnan(r),
            "inf": np.isinf(r),
            "zero": finite & (r <= 0),
            "below": finite & (r > 0) & (r < scan.range_min),
            "above": finite & (r > scan.range_max),
        }
        for name, mask in counts.items():
            self.invalid[name] += int(np.count_nonzero(mask))
        self.total += n
        self.has_intensities = self.has_intensities or len(scan.intensities) > 0

    def info(self, stamps: array[int]) -> ScanInfo:
        steps = np.diff(np.asarray(stamps)) * NS
        pair = {name: (low, self.high[name]) for name, low in self.low.items()}
        return ScanInfo(
            beams=(int(pair["beams"][0]), int(pair["beams"][1])),
            angle_min_rad=pair["angle_min"],
            angle_max_rad=pair["angle_max"],
            angle_increment_rad=pair["angle_increment"],
            range_min_m=pair["range_min"],
            range_max_m=pair["range_max"],
            header_time_increment_s=pair["time_increment"],
            header_scan_time_s=pair["scan_time"],
            period_s=float(np.median(steps)) if len(steps) else None,
            longest_gap_s=float(np.max(steps)) if len(steps) else None,
            backward_stamps=int(np.count_nonzero(steps <= 0)),
            has_intensities=self.has_intensities,
            invalid={name: count / max(self.total, 1) for name, count in self.invalid.items()},
        )


def describe_recording(recording: Recording) -> Info:
    """Read all of a recording once; damage on the way ends the reading and is told in `problem`."""
    clocks: dict[str, _Clock] = {topic.name: _Clock() for topic in recording.topics}
    beams: dict[str, _Beams] = {}
    problems: list[str] = []
    chosen: Chosen | None = None
    try:
        chosen = choose_topics(recording)
    except InputError as error:
        problems.append(str(error))
    try:
        for message in recording.messages():
            _add(message, clocks[message.topic], beams)
    except InputError as error:
        problems.append(str(error))
    ends = [(c.received[0], c.received[-1]) for c in clocks.values() if c.received]
    first, last = min((a for a, _ in ends), default=0), max((b for _, b in ends), default=0)
    used = tuple(_topic(t, _role(t, chosen), clocks[t.name], beams) for t in recording.topics)
    others = tuple(_topic(t, "not used", _Clock(), {}) for t in recording.others)
    return Info(
        path=str(Path(recording.path)),
        format=recording.format,
        truncated=recording.truncated,
        first_s=first * NS if ends else None,
        duration_s=(last - first) * NS,
        chosen=chosen,
        problem="; ".join(problems),
        topics=used + others,
    )


def _add(message: Message, clock: _Clock, beams: dict[str, _Beams]) -> None:
    clock.stamps.append(message.stamp_ns)
    clock.received.append(message.received_ns)
    if isinstance(message, LaserScan):
        beams.setdefault(message.topic, _Beams()).add(message)


def _role(topic: Topic, chosen: Chosen | None) -> str:
    if chosen and topic.name == chosen.scan:
        return "scan"
    if chosen and topic.name == chosen.ego:
        return "ego"
    return "truth" if chosen and topic.name in chosen.truth else "not used"


def _topic(topic: Topic, role: str, clock: _Clock, beams: dict[str, _Beams]) -> TopicInfo:
    stamps, received = np.asarray(clock.stamps, np.int64), np.asarray(clock.received, np.int64)
    span = (received[-1] - received[0]) * NS if len(received) else 0.0
    return TopicInfo(
        name=topic.name,
        type=topic.type,
        role=role,
        count=len(received) or topic.count,
        rate_hz=float((len(received) - 1) / span) if span > 0 else None,
        first_s=float(received[0] * NS) if len(received) else None,
        last_s=float(received[-1] * NS) if len(received) else None,
        delay_s=float(np.median((received - stamps) * NS)) if len(received) else None,
        scan=beams[topic.name].info(clock.stamps) if topic.name in beams else None,
    )
