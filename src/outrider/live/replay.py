"""A recording as a live source: its scans come when their last beam was measured, at its own pace."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from outrider import offline
from outrider.errors import InputError, OutriderError
from outrider.io import _live_mcap
from outrider.live import Event, Raw, Trouble
from outrider.live.clock import Pace, now
from outrider.records import Scan, Turn
from outrider.rplidar.decoder import BEHIND, Decoder
from outrider.rplidar.models import Mode
from outrider.settings import Settings

Decode = Callable[[bytes, float], Iterable[Turn]]  # bytes, clock of the host when they came -> whole turns


class Replay:
    """Source of events with times of their own, such as `scans` and `turns` give.

    `pace` tells the engine how the recording's clock runs; a clock that jumps back is followed.
    """

    def __init__(
        self, timed: Iterable[tuple[float, Event]], about: Mapping[str, Any], speed: float = 1.0
    ) -> None:
        if not 0.0 < speed < float("inf"):
            raise InputError(f"--speed {speed:g}: want a number above 0, such as 1.0")
        self.about = about
        self.pace = Pace(speed)
        self._timed = timed
        self._stop, self._finished = threading.Event(), False
        self._thread: threading.Thread | None = None

    def start(self, put: Callable[[Event], None]) -> None:
        """Begin to play, from a thread of its own."""
        self._thread = threading.Thread(target=self._play, args=(put,), name="replay", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread; a second call does nothing."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    @property
    def finished(self) -> bool:
        """Whether the recording is at its end."""
        return self._finished

    def _play(self, put: Callable[[Event], None]) -> None:
        before = float("inf")
        try:
            for t, event in self._timed:
                if t < before - 1.0:  # the first one, or the recording's clock was set back
                    self.pace.begin(t)
                before = t
                if self._stop.wait(max(0.0, self.pace.to_host(t) - now())):
                    return
                put(event)
        except OutriderError as error:  # damaged in the middle: what came before was played
            put(Trouble(now(), str(error)))
        finally:
            self._finished = True


def open_replay(
    recording: str, settings: offline.Given, changes: Sequence[str], speed: float = 1.0
) -> tuple[Replay, Settings]:
    """A recording by path or `dataset:` name, ready to be played, and the settings for it.

    One of a live run that holds the bytes of its sensor is decoded again, any other is played scan by scan.
    Raises InputError as `offline.open_source` does.
    """
    told = None if recording.startswith("dataset:") else _live_mcap.about(Path(recording))
    if told is not None and told.keys() >= {"mode", "answer", "sample_us", "range_min", "range_max", "baud"}:
        mode = Mode(0, told["mode"], told["answer"], told["sample_us"], told["range_max"])
        decoder = Decoder(mode, told["baud"], told["range_min"], BEHIND)
        timed = turns(_live_mcap.raws(Path(recording)), decoder.feed)
        about = {"recording": recording, "speed": speed, "sensor": told.get("sensor"), "mode": mode.name}
        return Replay(timed, about, speed), offline.settle({}, settings, changes)
    opened = offline.open_source(recording, settings, changes)
    return Replay(scans(opened.stream), {"recording": opened.name, "speed": speed}, speed), opened.settings


def scans(stream: Iterable[Scan]) -> Iterable[tuple[float, Event]]:
    """Scans of a recording as `offline.open_source` prepares them, each due at its last beam."""
    return ((scan.t, scan) for scan in stream)


def turns(raws: Iterable[Raw], decode: Decode) -> Iterable[tuple[float, Event]]:
    """The bytes of a live recording, each piece due when it came, and the turns that they decode to."""
    for raw in raws:
        yield raw.received, raw
        for turn in decode(raw.data, raw.received):
            yield raw.received, turn
