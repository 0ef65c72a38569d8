"""Who makes the horn's noise: a WAV file, a sound card, or a program of the user's (pin, bus, relay)."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import wave
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from outrider.errors import InputError, OutputError
from outrider.live.clock import now
from outrider.live.horn import RATE, Samples, Sounder, pattern
from outrider.records import Level

WAV_EVERY_S = 0.5  # how often the file is brought up to date
WAV_MOST = 1 << 30  # samples in a file: 2 GiB, over six hours
OPEN_AGAIN_S = 1.0  # how often a sound card that went away is looked for
HANGS_S = 2.0  # a program that runs longer than this is ended when there is another level to tell
KINDS = "none, wav:FILE, device, device:NAME or command:PROGRAM"


def sounder(words: str) -> Sounder | None:
    """The sounder of a `--horn` option; None for `none`. Raises InputError and OutputError."""
    kind, _, rest = words.partition(":")
    if words == "none":
        return None
    if kind == "wav" and rest:
        return Wav(Path(rest))
    if kind == "device":
        return Device(rest or None)
    if kind == "command" and rest:
        return Command(rest)
    raise InputError(f"--horn {words}: want {KINDS}")


@dataclass(slots=True)
class _Place:
    samples: Samples
    at: int = 0


class Loop:
    """Patterns repeated without a seam; a level always begins at its pattern's beginning."""

    def __init__(self) -> None:
        self._patterns = {level: pattern(level) for level in Level}
        self.begin(Level.NONE)

    def begin(self, level: Level) -> None:
        """Go over to another level."""
        self._place = _Place(self._patterns[level])

    def take(self, n: int) -> Samples:
        """The next n samples (n,)."""
        place = self._place  # another thread may put another one there meanwhile
        rows = (place.at + np.arange(n)) % len(place.samples)
        place.at = (place.at + n) % len(place.samples)
        return place.samples[rows]


class Wav:
    """One file that holds, in time, what would have been heard from now on."""

    def __init__(self, path: Path) -> None:
        try:
            self._disk = path.open("wb")
        except OSError as error:
            raise OutputError(f"{path}: cannot be written ({error.strerror}); name another file") from error
        self._file = wave.open(self._disk)  # noqa: SIM115 (as long as the run; its header is right after every write)
        self._file.setparams((1, 2, RATE, 0, "NONE", "not compressed"))
        self._path, self._loop = path, Loop()
        self._begun, self._written = now(), 0

    def play(self, level: Level) -> bool:
        """What was heard until now is written; from here on another pattern."""
        self._write()
        self._loop.begin(level)
        return True

    def tend(self) -> None:
        """Bring the file up to date."""
        if (now() - self._begun) * RATE - self._written > WAV_EVERY_S * RATE:
            self._write()

    def close(self) -> None:
        """The file is whole."""
        self._write()
        self._file.close()
        self._disk.close()

    @property
    def report(self) -> Mapping[str, Any]:
        """Where it is and how long."""
        full = (
            {"trouble": f"{self._path}: full, no more sound is written"} if self._written >= WAV_MOST else {}
        )
        return {"file": str(self._path), "seconds": round(self._written / RATE, 2), **full}

    def _write(self) -> None:
        until = min(int((now() - self._begun) * RATE), WAV_MOST)
        while self._written < until:
            n = min(until - self._written, 10 * RATE)
            self._file.writeframes(self._loop.take(n).astype("<i2").tobytes())
            self._written += n


class Device:
    """A sound card, by part of its name or the usual one; one that goes away is looked for again."""

    def __init__(self, name: str | None = None) -> None:
        try:
            import sounddevice
        except (ImportError, OSError) as error:  # OSError: the package is there, its library is not
            raise InputError(
                f"--horn device: no sound ({' '.join(str(error).split())}); "
                "want pip install 'outrider[audio]' and the system's libportaudio2"
            ) from error
        self._library, self._name, self._loop = sounddevice, name, Loop()
        self._tried, self._lost, self._again = now(), False, 0
        try:
            self._stream = self._opened()
        except sounddevice.PortAudioError as error:
            raise InputError(
                f"--horn device{f':{name}' if name else ''}: cannot be opened "
                f"({' '.join(str(error).split())}); see python -m sounddevice"
            ) from error

    def play(self, level: Level) -> bool:
        """The card's next block is of this level."""
        self._loop.begin(level)
        return True

    def tend(self) -> None:
        """Open the card again where it went away."""
        self._lost = not self._stream.active
        if self._lost and now() - self._tried > OPEN_AGAIN_S:
            self._tried = now()
            self._stream.close()
            try:
                self._stream = self._opened()
                self._again += 1
            except self._library.PortAudioError:
                return

    def close(self) -> None:
        """The card is free for others."""
        self._stream.close()

    @property
    def report(self) -> Mapping[str, Any]:
        """Which card, and how often it was opened again."""
        gone = {"trouble": "sound card gone: the horn is silent"} if self._lost else {}
        return {"device": self._name or "default", "opened_again": self._again, **gone}

    def _opened(self) -> Any:
        """The card's stream, running; PortAudioError where that cannot be."""
        stream = self._library.OutputStream(
            samplerate=RATE,
            channels=1,
            dtype="int16",
            device=self._name,
            latency="low",
            callback=lambda out, n, *_: out.__setitem__((slice(None), 0), self._loop.take(n)),
        )
        stream.start()
        return stream


class Command:
    """A program that is run with the level as its last word, one at a time; its output is thrown away."""

    def __init__(self, words: str) -> None:
        self._words = shlex.split(words)
        if not self._words or shutil.which(self._words[0]) is None:
            raise InputError(
                f"--horn command:{words}: no such program; want one that takes a level as its last word"
            )
        self._running: subprocess.Popen[bytes] | None = None
        self._begun = 0.0
        self._counts = {"runs": 0, "failed": 0, "killed": 0}

    def play(self, level: Level) -> bool:
        """Run it with `none`, `notice`, `caution` or `danger`; not before the last one has ended."""
        if self._busy() and now() - self._begun > HANGS_S:
            self._kill()
        if self._busy():
            return False
        quiet = subprocess.DEVNULL
        self._running = subprocess.Popen(
            [*self._words, level.name.lower()],
            stdin=quiet,
            stdout=quiet,
            stderr=quiet,
            start_new_session=True,
        )
        self._begun = now()
        self._counts["runs"] += 1
        return True

    def tend(self) -> None:
        """See whether it has ended, and how."""
        self._busy()

    def close(self) -> None:
        """Wait a little for the last one, then end it."""
        if self._running is not None:
            try:
                self._running.wait(HANGS_S)
            except subprocess.TimeoutExpired:
                self._kill()
        self._busy()

    @property
    def report(self) -> Mapping[str, Any]:
        """How often it ran, failed and had to be killed."""
        hangs = self._running is not None and now() - self._begun > HANGS_S
        told = {"command": shlex.join(self._words), **self._counts}
        if hangs:
            return {**told, "trouble": f"{self._words[0]} has run for {now() - self._begun:.0f} s"}
        failed = self._counts["failed"]
        return {**told, "trouble": f"{self._words[0]} failed {failed} times"} if failed else told

    def _busy(self) -> bool:
        if self._running is None or (code := self._running.poll()) is None:
            return self._running is not None
        self._counts["failed"] += code > 0
        self._running = None
        return False

    def _kill(self) -> None:
        if self._running is not None:
            if hasattr(os, "killpg"):
                os.killpg(self._running.pid, signal.SIGKILL)  # with all that it started
            else:
                self._running.kill()
            self._running.wait()
            self._counts["killed"] += 1
