"""Between the source's thread and the engine's: a short queue that never blocks whoever puts."""

from __future__ import annotations

import threading
from collections import deque

from outrider.live import Event, Raw, Trouble

MOST_TURNS = 2  # waiting; of more, the oldest is dropped: a warning about the past is of no use
MOST_BYTES = 4 << 20  # waiting for whoever records


class Inbox:
    """Events in the order they came; when the reader is behind, the oldest turns and bytes are dropped."""

    def __init__(self) -> None:
        self._events: deque[Event] = deque()
        self._ready = threading.Condition()
        self._turns = self._bytes = 0
        self.dropped_turns = self.dropped_bytes = 0

    def put(self, event: Event) -> None:
        """One more event, from any thread."""
        with self._ready:
            self._events.append(event)
            self._count(event, 1)
            if self._turns > MOST_TURNS:
                self._drop(turns=True)
                self.dropped_turns += 1
            while self._bytes > MOST_BYTES:
                self.dropped_bytes += self._drop(turns=False)
            self._ready.notify()

    def get(self, timeout: float) -> Event | None:
        """The oldest event, or None where none came within `timeout` [s]."""
        with self._ready:
            if not self._events:
                self._ready.wait(timeout)
            if not self._events:
                return None
            event = self._events.popleft()
            self._count(event, -1)
            return event

    def _count(self, event: Event, sign: int) -> None:
        if isinstance(event, Raw):
            self._bytes += sign * len(event.data)
        elif not isinstance(event, Trouble):
            self._turns += sign

    def _drop(self, turns: bool) -> int:
        """Remove the oldest turn, or the oldest bytes; how many bytes that were."""
        for i, event in enumerate(self._events):
            if not isinstance(event, Trouble) and isinstance(event, Raw) != turns:
                del self._events[i]
                self._count(event, -1)
                return len(event.data) if isinstance(event, Raw) else 0
        return 0
