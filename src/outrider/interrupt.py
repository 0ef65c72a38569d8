"""Ctrl-C that neither cuts a row in half nor gets lost in a library's callback."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any, Self


class Interrupts:
    """Context in which Ctrl-C raises KeyboardInterrupt at once, but inside `held` only at that block's end.

    Compilers and readers run Python in callbacks that swallow exceptions: an interrupt lost there is raised
    at the end of the next `held` block. Outside the main thread, which alone gets signals, it does nothing.
    """

    def __init__(self) -> None:
        self._asked = self._holding = False
        self._before: Any = None
        self._main = threading.current_thread() is threading.main_thread()

    def __enter__(self) -> Self:
        if self._main:
            self._before = signal.signal(signal.SIGINT, self._take)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        if self._main:
            signal.signal(signal.SIGINT, self._before or signal.default_int_handler)

    def _take(self, number: int, frame: FrameType | None) -> None:
        self._asked = True
        if not self._holding:
            raise KeyboardInterrupt

    @contextmanager
    def held(self) -> Iterator[None]:
        """A block that is finished first; whatever was asked until its end is raised then, once."""
        self._holding = True
        try:
            yield
        finally:
            self._holding = False
        if self._asked:
            self._asked = False
            raise KeyboardInterrupt
