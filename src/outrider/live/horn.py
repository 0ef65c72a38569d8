"""The horn: a two-tone sound whose pattern tells the level of the alert, sent to whoever makes the noise."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from outrider.live import Health, Raw, Shot
from outrider.live.clock import now
from outrider.live.latency import Latency
from outrider.records import Level

RATE = 44100  # samples a second
LOW_HZ, HIGH_HZ = (
    420,
    525,
)  # a major third, as car horns have; whole numbers, so that a pattern can be repeated
OVERTONES = (1.0, 0.55, 0.35, 0.2, 0.12)  # of each tone: enough of the upper ones to be heard on a street
RAMP_S = 0.004  # of a blast's beginning and end: no click, and no delay worth the name
PATTERNS = {  # loudness, seconds until it is repeated, blasts as (begin, end) [s]
    Level.NOTICE: (0.25, 2.0, ((0.0, 0.12),)),
    Level.CAUTION: (0.6, 1.0, ((0.0, 0.18), (0.28, 0.46))),
    Level.DANGER: (1.0, 1.0, ((0.0, 1.0),)),
}

TEND_S = 0.05  # how often the sounder is tended
ASK_AGAIN_S = 0.01  # how long a sounder that is busy is left alone
SILENT_AFTER_S = 2.0  # without a scan

Samples = npt.NDArray[np.int16]


def pattern(level: Level) -> Samples:
    """One period (n,) of the sound of a level, to be repeated without a seam; silence of 1 s for NONE."""
    if level is Level.NONE:
        return np.zeros(RATE, np.int16)
    loudness, period, blasts = PATTERNS[level]
    t = np.arange(round(period * RATE)) / RATE
    sound = np.zeros(len(t))
    for tone in (LOW_HZ, HIGH_HZ):
        for k, strength in enumerate(OVERTONES, start=1):
            sound += strength * np.sin(2.0 * np.pi * k * tone * t)
    envelope = np.zeros(len(t))
    for begin, end in blasts:
        if begin == 0.0 and end == period:
            envelope[:] = 1.0
        else:
            envelope = np.maximum(envelope, np.clip(np.minimum(t - begin, end - t) / RAMP_S, 0.0, 1.0))
    sound *= loudness * envelope / (2.0 * sum(OVERTONES))
    return np.rint(32767.0 * sound).astype(np.int16)


class Sounder(Protocol):
    """Who makes the noise; called from the horn's thread only, and may take its time."""

    def play(self, level: Level) -> bool:
        """Go over to the sound of a level now, NONE is silence; False where it must be asked again soon."""

    def tend(self) -> None:
        """Called often, whether or not anything has changed."""

    def close(self) -> None:
        """Fall silent and let go of everything."""

    @property
    def report(self) -> Mapping[str, Any]:
        """What it did, for people; `trouble` in one line where there is any."""


class Horn:
    """Sink that follows the alert's level: the newest wins, a thread of its own waits for the sounder."""

    def __init__(self, sounder: Sounder) -> None:
        self._sounder = sounder
        self._changed = threading.Condition()
        self._wanted: tuple[Level, float] = (Level.NONE, 0.0)  # and when its last beam was measured
        self._playing = Level.NONE
        self._seen = now()  # when the last shot came
        self._closing = False
        self._starts = Latency()
        self._blasts, self._overtaken, self._trouble = 0, 0, ""
        self._thread = threading.Thread(target=self._work, name="horn", daemon=True)
        self._thread.start()

    def shot(self, shot: Shot) -> None:
        """Follow the level."""
        self._seen = now()
        self._ask(shot.frame.alert.level, shot.last_beam)

    def raw(self, raw: Raw) -> None:
        """Nothing."""

    def health(self, health: Health) -> None:
        """Fall silent where no scan has come for long: what was a danger is one no more."""
        if now() - self._seen > SILENT_AFTER_S:
            self._ask(Level.NONE, self._seen)

    def close(self) -> None:
        """Silence; the sounder is let go. A second call does nothing."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()

    @property
    def report(self) -> Mapping[str, Any]:
        """How often it sounded, how many levels were overtaken by newer ones, last beam to sound [ms]."""
        starts = {"blasts": self._blasts, "overtaken": self._overtaken}
        told = {**starts, "last_beam_to_sound": self._starts.as_dict(), **self._sounder.report}
        return {**told, "trouble": self._trouble} if self._trouble else told

    def _ask(self, level: Level, last_beam: float) -> None:
        with self._changed:
            if level != self._wanted[0]:
                self._overtaken += self._wanted[0] != self._playing
                self._wanted = (level, last_beam)
                self._changed.notify()

    def _work(self) -> None:
        """The horn's thread: a sounder that fails is told of and let go, the rest goes on."""
        try:
            while not self._closing:
                self._step()
            self._sounder.play(Level.NONE)
        except Exception as error:  # a sound card's driver or a disk may fail in any way
            self._trouble = f"horn failed: {' '.join(str(error).split()) or type(error).__name__}"
        with suppress(Exception):
            self._sounder.close()

    def _step(self) -> None:
        """Wait for another level, or a little; sound it."""
        with self._changed:
            if self._wanted[0] == self._playing and not self._closing:
                self._changed.wait(TEND_S)
            level, last_beam = self._wanted
        if level != self._playing:
            if self._sounder.play(level):
                if level > self._playing:
                    self._blasts += 1
                    self._starts.add(now() - last_beam)
                self._playing = level
            else:
                time.sleep(ASK_AGAIN_S)
        self._sounder.tend()
