"""A sink that keeps everything: files of a bounded size, on the disk within a second, never to its last byte.

A thread of its own writes, so that a slow card never holds up a warning; what it cannot keep up with is
dropped and counted.
"""

from __future__ import annotations

import shutil
import threading
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from outrider.errors import InputError
from outrider.io._live_mcap import LiveFile, checked_new
from outrider.live import Health, Raw, Shot
from outrider.live.clock import now
from outrider.settings import Settings

SYNC_S = 0.3  # what the loss of power costs at most, but for what the card itself holds back
WAITING = 2000  # frames and pieces of bytes that wait for the disk; of more, the oldest are dropped
MB = 1_000_000
LOOK_S = 5.0  # between two looks at a disk that was full


class Recorder:
    """Writes `NAME.mcap`, then `NAME-0002.mcap` and so on; a new file by size, by time, or after a failure.

    size_mb, minutes: of one file at most. floor_mb: with less room on the disk nothing is written; the
    report says so, and recording goes on in a new file when there is half as much again. about: what the
    sensor is, asked for when a file begins. Raises InputError where `path` may not be written, or a bound
    cannot be.
    """

    def __init__(
        self,
        path: Path | str,
        settings: Settings,
        about: Callable[[], Mapping[str, Any]] = dict,
        *,
        size_mb: float = 1000.0,
        minutes: float = 60.0,
        floor_mb: float = 500.0,
        force: bool = False,
    ) -> None:
        for name, value in (("size_mb", size_mb), ("minutes", minutes)):
            if not value > 0.0:
                raise InputError(f"record {name} = {value:g}; want more than 0")
        if not floor_mb >= 0.0:
            raise InputError(f"record floor_mb = {floor_mb:g}; want 0 or more")
        self._path = checked_new(Path(path), force)
        self._settings, self._about = settings, about
        self._size, self._seconds, self._floor = size_mb * MB, 60.0 * minutes, floor_mb * MB
        self._waiting: deque[Shot | Raw] = deque()
        self._ready, self._over = threading.Condition(), False
        self._file: LiveFile | None = None
        self._opened = self._synced = 0.0
        self._look = -LOOK_S
        self._files: list[Path] = []
        self._written = self._dropped = self._failures = 0
        self._words = ""
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def shot(self, shot: Shot) -> None:
        """One frame further."""
        self._put(shot)

    def raw(self, raw: Raw) -> None:
        """Bytes of the sensor."""
        self._put(raw)

    def health(self, health: Health) -> None:
        """Nothing: what is missing shows by its absence."""

    def close(self) -> None:
        """Everything taken is written, and the file ended; a second call does nothing."""
        with self._ready:
            self._over = True
            self._ready.notify()
        self._thread.join()

    @property
    def report(self) -> Mapping[str, Any]:
        """Files, what was written and dropped, and why nothing is written now."""
        return {
            "files": [str(path) for path in self._files],
            "written": self._written,
            "dropped": self._dropped,
            "failures": self._failures,
            "trouble": self._words,
        }

    def _put(self, item: Shot | Raw) -> None:
        with self._ready:
            self._waiting.append(item)
            if len(self._waiting) > WAITING:
                self._waiting.popleft()
                self._dropped += 1
            self._ready.notify()

    # ------------------------------------------------------------------ the recorder's own thread

    def _work(self) -> None:
        while True:
            with self._ready:
                if not self._waiting and not self._over:
                    self._ready.wait(SYNC_S)
                items, over = list(self._waiting), self._over
                self._waiting.clear()
            for item in items:
                self._guarded(item)
            self._guarded(None)
            if over and not items:
                self._end()
                return

    def _guarded(self, item: Shot | Raw | None) -> None:
        """Write an item, or only what is due; a disk that refuses ends the file and is tried again later."""
        try:
            self._step(item)
        except OSError as error:
            self._failures += 1
            self._words = (
                f"{self._path.name}: cannot write ({error.strerror or error}); recording has stopped"
            )
            self._look = now()
            self._dropped += item is not None
            self._end()

    def _step(self, item: Shot | Raw | None) -> None:
        at = now()
        file = self._file
        if file is None:
            if item is None:
                return
            if not self._room(at):
                self._dropped += 1
                return
            file = self._begin(at)
        if item is not None:
            file.frame(item.frame) if isinstance(item, Shot) else file.raw(item)
            self._written += 1
        if at - self._synced >= SYNC_S:
            file.flush()
            self._synced = at
            self._watch(file, at)

    def _begin(self, at: float) -> LiveFile:
        path = self._path
        while self._files and (path in self._files or path.exists()):
            number = int(path.stem.rpartition("-")[2]) + 1 if path != self._path else 2
            path = self._path.with_stem(f"{self._path.stem}-{number:04d}")
        self._file = file = LiveFile(path, self._settings, self._about())
        self._files.append(path)
        self._opened = self._synced = at
        return file

    def _watch(self, file: LiveFile, at: float) -> None:
        """End the file where it is large or old enough, or the disk nearly full."""
        full = self._free() < self._floor
        if full:
            self._words = f"less than {self._floor / MB:.0f} MB left on the disk; recording has stopped"
            self._look = at
        if full or file.size > self._size or at - self._opened > self._seconds:
            self._end()

    def _room(self, at: float) -> bool:
        """Whether to begin a file now; after a full disk only where there is half as much room again."""
        if self._words:
            if at - self._look < LOOK_S:
                return False
            self._look = at
        wanted = self._floor * (1.5 if self._words else 1.0)
        if self._free() < wanted:
            self._words = self._words or (
                f"less than {self._floor / MB:.0f} MB left on the disk; nothing is recorded"
            )
            self._look = at
            return False
        self._words = ""
        return True

    def _free(self) -> float:
        return float(shutil.disk_usage(self._path.parent).free)

    def _end(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            try:
                file.close()
            except OSError as error:
                self._failures += 1
                self._words = (
                    f"{file.path.name}: cannot be ended ({error.strerror or error}); it stays readable"
                )
