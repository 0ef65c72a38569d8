"""What `outrider live` tells on stderr while it runs, and in a few lines at its end."""

import re
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from outrider.cli import show
from outrider.cli.demo import about

if TYPE_CHECKING:
    from outrider.live import Health, Raw, Shot, Sink, Source

EVERY_S = 0.2  # between two looks of the line at the bottom
SINKS_S = 1.0  # between two questions to the other sinks whether all is well
RATE_S = 2.0  # over which scans are counted
NAMED = ("sensor", "recording", "speed", "port", "baud", "mode", "firmware")  # of what a source tells
OWN = ("scans", "degraded scans", "dropped turns", "dropped bytes")  # counts with a line of their own


class Status:
    """Sink that tells on stderr: a line for each change, and on a terminal one that is kept up to date."""

    def __init__(self, source: "Source", others: "Sequence[Sink]") -> None:
        from outrider.live.engine import name_of

        self._source, self._others = source, others
        self._terminal = sys.stderr.isatty()
        self._begun: float | None = None
        self._told: dict[str, str] = {}  # by subject: what was said last
        self._shown = self._asked = 0.0
        self._times: list[float] = []  # of the last scans
        for sink in others:
            if isinstance(where := getattr(sink, "url", getattr(sink, "address", None)), str):
                self.say(f"{name_of(sink)}: {where}")

    def say(self, words: str) -> None:
        """A line that stays."""
        if self._terminal:
            print("\r\x1b[K", end="", file=sys.stderr)
        print(words, file=sys.stderr, flush=True)

    def shot(self, shot: "Shot") -> None:
        """What has changed; else how things are."""
        now = time.monotonic()
        self._times = [*(t for t in self._times if t > now - RATE_S), now]
        self._tell("sensor", _named(self._source.about))
        alert = shot.frame.alert
        level = alert.level.name.lower()
        words = f"{level:<8} {about(shot.frame)}".rstrip() if alert.level else "no alert"
        self._tell("alert", words, f"{alert.level} {alert.track}")
        late = f"{1e3 * (shot.decided - shot.last_beam):.0f} ms"
        self.health(shot.health, f"{self._pace(now)}, {late} | {words}")

    def raw(self, raw: "Raw") -> None:
        """Nothing."""

    def health(self, health: "Health", state: str = "no scans") -> None:
        """What cannot be trusted, and that it can be again."""
        now = time.monotonic()
        self._tell(
            "trust", f"degraded: {'; '.join(health.degraded)}" if health.degraded else "", kind(health)
        )
        if now - self._asked > SINKS_S:
            self._asked = now
            for i, sink in enumerate(self._others):
                self._tell(f"sink {i}", str(sink.report.get("trouble", "")))
        if self._terminal and now - self._shown > EVERY_S:
            self._shown = now
            worse = f" | degraded: {'; '.join(health.degraded)}" if health.degraded else ""
            line = f"{self._seconds():7.1f} s  {state}{worse}"
            print(
                "\r\x1b[K" + line[: shutil.get_terminal_size().columns - 1],
                end="",
                file=sys.stderr,
                flush=True,
            )

    def close(self) -> None:
        """The line at the bottom goes."""
        if self._terminal:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    @property
    def report(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def _tell(self, subject: str, words: str, key: str | None = None) -> None:
        """Say it if it is new; that a subject is well again is said as that."""
        key = words if key is None else key
        if self._told.get(subject, "") == key:
            return
        first = subject not in self._told
        self._told[subject] = key
        if not (subject == "alert" and first and key.startswith("0")):
            self.say(f"{self._seconds():7.1f} s  {words or 'all is well again'}")

    def _seconds(self) -> float:
        if self._begun is None:
            self._begun = time.monotonic()
        return time.monotonic() - self._begun

    def _pace(self, now: float) -> str:
        span = now - self._times[0]
        return f"{(len(self._times) - 1) / span:.1f} scans/s" if span > 0.0 else "first scan"


def kind(health: "Health") -> str:
    """What is wrong, without the numbers in it, which change all the time."""
    return re.sub(r"[\d.]+", "#", "; ".join(health.degraded))


def _named(source: Mapping[str, Any]) -> str:
    """A source in one line."""
    told = [f"{key} {source[key]}" for key in NAMED if source.get(key) is not None]
    return ", ".join(told) or "unknown"


def rows(figures: dict[str, Any]) -> list[tuple[str, str]]:
    """What a run came to, in a few lines."""
    counts = figures["counts"]
    table = [
        ("source", _named(figures["source"])),
        ("scans", f"{counts['scans']} in {figures['seconds']:.1f} s, {counts['degraded scans']} degraded"),
        ("left out", show.listed({k: counts[k] for k in ("dropped turns", "dropped bytes")})),
        ("alerts", show.listed(figures["alerts"])),
    ]
    told = show.listed({k: n for k, n in counts.items() if k not in OWN})
    table += [("of the sensor", told)] if told != "none" else []
    parts = ("last_beam_to_alert", "of_it_on_the_way", "of_it_computing")
    table += [(name.replace("_", " "), _times(figures[name])) for name in parts if figures[name]["n"]]
    for name, report in figures["sinks"].items():
        table += [(name, _line(report))] if report else []
    return table


def _line(report: dict[str, Any]) -> str:
    """A sink's report in one line; what it has nothing of is left out."""
    parts = []
    for name, value in report.items():
        label = name.replace("_", " ")
        if isinstance(value, dict):
            parts += [f"{label} {_times(value)}"] if value.get("n") else []
        elif isinstance(value, list | tuple):
            parts += [f"{label} {', '.join(map(str, value))}"] if value else []
        elif value:
            parts.append(f"{label} {value}")
    return "; ".join(parts) or "nothing"


def _times(latency: dict[str, Any]) -> str:
    return (
        f"{latency['p50_ms']:.1f} ms (median), {latency['p99_ms']:.1f} ms (99 %), "
        f"{latency['max_ms']:.1f} ms at most"
    )
