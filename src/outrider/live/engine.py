"""The loop of a live run: events in, one frame a turn out to every sink; data flows one way.

The source's thread puts events into the inbox; this thread makes scans of turns, steps the pipeline and hands
what came out to the sinks. Between scans it asks whether one is overdue.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

import msgspec

from outrider import alert, pipeline, simulate
from outrider.live import Event, Health, Raw, Shot, Sink, Source, Trouble
from outrider.live.clock import Pace, now
from outrider.live.inbox import Inbox
from outrider.live.latency import Latency
from outrider.live.scans import TurnsToScans
from outrider.records import Frame, LaserScan, Level, Scan, Turn
from outrider.scan import ScanStream
from outrider.settings import Recording, Settings, Timing

TICK_S = 0.1  # how often it is asked whether a scan is overdue
REMIND_S = 0.5  # how often sinks are told again that no scan comes
WARM_SCANS = 30


class Live:
    """A live run: `warm` it up, then `run` it; its counts can be read by any thread at any time."""

    def __init__(
        self, source: Source, sinks: Sequence[Sink], settings: Settings, pace: Pace | None = None
    ) -> None:
        self._source, self._sinks, self._settings = source, sinks, settings
        self._pace = pace or Pace()
        self._inbox = Inbox()
        self._turns = TurnsToScans(settings)
        self._engine, self._memory = pipeline.engine(settings), pipeline.start(settings)
        self._trouble: tuple[str, ...] = ()
        self._told: tuple[float, tuple[str, ...]] = (-REMIND_S, ())
        self._scans = self._degraded = self._troubles = 0
        self._alerts = dict.fromkeys((level.name.lower() for level in Level if level), 0)
        self._level = Level.NONE
        self._arrived, self._computed, self._decided = Latency(), Latency(), Latency()

    def warm(self, stop: threading.Event | None = None) -> None:
        """Compile, on scans that are made up, whatever a first scan would have to wait for."""
        memory = pipeline.start(self._settings)
        world = simulate.load("demo")
        usual = msgspec.structs.replace(self._settings, recording=Recording(), timing=Timing())
        stream = ScanStream((), "/scan", None, usual, head=1)
        taken = 0
        for message in simulate.record(world):
            if isinstance(message, LaserScan):
                for scan in stream.feed(message):
                    memory, _ = pipeline.step(memory, scan, self._settings, self._engine)
                taken += 1
            if taken == WARM_SCANS or (stop and stop.is_set()):
                return

    def run(self, stop: threading.Event | None = None, seconds: float = float("inf")) -> dict[str, Any]:
        """Until `stop` is set, the source is at its end or `seconds` have passed; the figures of the run.

        `ended` in them: "asked", by stop or time, or "source".

        Source and sinks are stopped and closed whatever happens. Raises InputError as `Source.start` does.
        """
        stop = stop or threading.Event()
        begun, ended = now(), "asked"
        try:
            self._source.start(self._inbox.put)
            while not stop.is_set() and now() - begun < seconds:
                done = self._source.finished
                event = self._inbox.get(TICK_S)
                if event is not None:
                    self.take(event)
                elif done:
                    ended = "source"
                    break
                self._watch()
        finally:
            self._source.stop()
            for sink in self._sinks:
                sink.close()
        return {"ended": ended, **self.figures(now() - begun)}

    def take(self, event: Event) -> None:
        """One event, to its end; `run` does this with each that comes."""
        if isinstance(event, Raw):
            for sink in self._sinks:
                sink.raw(event)
        elif isinstance(event, Trouble):
            self._troubles += 1
            self._trouble = (event.words,)
        elif isinstance(event, Turn):
            scan = self._turns.scan(event)
            if scan is not None:
                self._scan(scan, event)
        else:
            self._scan(event, None)

    def _scan(self, scan: Scan, turn: Turn | None) -> None:
        """One scan to its alert, and to every sink."""
        self._trouble = ()
        last_beam = self._pace.to_host(scan.t)
        begun = now()
        self._memory, frame = pipeline.step(self._memory, scan, self._settings, self._engine)
        decided = now()
        if turn is not None:
            self._arrived.add(turn.received - scan.t)
        self._computed.add(decided - begun)
        self._decided.add(decided - last_beam)
        self._count(frame)
        self._told = (-REMIND_S, ())
        shot = Shot(frame, turn, Health(frame.alert.degraded, self.counts), last_beam, decided)
        for sink in self._sinks:
            sink.shot(shot)

    def _watch(self) -> None:
        """Tell the sinks why the last warning cannot be trusted, where no scan has come."""
        at = now()
        late = alert.overdue(self._memory.alerts, self._pace.to_beams(at), self._settings.alert)
        reasons = self._trouble + late
        since, before = self._told
        if len(reasons) != len(before) or (reasons and at - since >= REMIND_S):
            self._told = (at, reasons)
            for sink in self._sinks:
                sink.health(Health(reasons, self.counts))

    @property
    def counts(self) -> dict[str, int]:
        """Since the start: what the engine took and left out, and what the source counts."""
        return {
            "scans": self._scans,
            "degraded scans": self._degraded,
            "dropped turns": self._inbox.dropped_turns,
            "dropped bytes": self._inbox.dropped_bytes,
            "troubles": self._troubles,
            **self._source.about.get("counts", {}),
        }

    def figures(self, seconds: float) -> dict[str, Any]:
        """What a run of so many seconds came to: times from last beam to alert, counts, reports."""
        return {
            "seconds": seconds,
            "source": dict(self._source.about),
            "counts": self.counts,
            "alerts": self._alerts,
            "trouble": self._trouble,
            "last_beam_to_alert": self._decided.as_dict(),
            "of_it_on_the_way": self._arrived.as_dict(),
            "of_it_computing": self._computed.as_dict(),
            "sinks": {name_of(sink): dict(sink.report) for sink in self._sinks},
        }

    def _count(self, frame: Frame) -> None:
        self._scans += 1
        self._degraded += bool(frame.alert.degraded)
        for level in Level:
            if self._level < level <= frame.alert.level:
                self._alerts[level.name.lower()] += 1
        self._level = frame.alert.level


def name_of(sink: Sink) -> str:
    """What a sink is called in the figures."""
    return type(sink).__name__.lower().removesuffix("sink")
