"""Live: scans as they come, frames to whoever wants them; the contract of sources and sinks.

A source has a thread of its own and hands over turns, or says what is wrong. The engine makes a frame of each
turn and hands it to every sink. A sink never blocks and never raises: newest wins, what it drops it counts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from outrider.records import Frame, Raw, Scan, Trouble, Turn

__all__ = ["Event", "Health", "Raw", "Shot", "Silent", "Sink", "Source", "Trouble"]

Event = Turn | Scan | Raw | Trouble  # a turn or scan says that all is well again


@dataclass(frozen=True, slots=True)
class Health:
    """How far what is shown can be trusted now."""

    degraded: tuple[str, ...]  # why it cannot be trusted, in words; empty when it can
    counts: Mapping[str, int]  # since the start: turns, dropped turns, bytes lost, reconnections, ...


@dataclass(frozen=True, slots=True)
class Shot:
    """All that is known after one turn."""

    frame: Frame
    turn: Turn | None  # None where the source gives scans, as a recording does
    health: Health
    last_beam: float  # when the last beam was measured, clock of the host [s]
    decided: float  # when the alert was ready, clock of the host [s]


class Source(Protocol):
    """Where turns come from: a sensor, or a recording played at its own pace."""

    about: Mapping[str, Any]  # model, serial number, mode, port or path; may become known later

    def start(self, put: Callable[[Event], None]) -> None:
        """Begin to hand over events from a thread of its own; `put` never blocks.

        InputError where it cannot ever work, such as a port that is not there by name or a recording without
        scans; what may pass, such as a sensor unplugged, is Trouble instead, and tried again.
        """

    def stop(self) -> None:
        """End the thread, leave the sensor at rest; a second call does nothing."""

    @property
    def finished(self) -> bool:
        """Whether no event will ever come again, as at the end of a recording."""


class Sink(Protocol):
    """Whoever wants to know; called from the engine's thread only."""

    def shot(self, shot: Shot) -> None:
        """One frame further."""

    def raw(self, raw: Raw) -> None:
        """Bytes of the sensor, in the order they came; before the turn they end in."""

    def health(self, health: Health) -> None:
        """The trust has changed while no turn came."""

    def close(self) -> None:
        """No more comes; everything taken is finished. A second call does nothing."""

    @property
    def report(self) -> Mapping[str, Any]:
        """What it did and what it dropped, for people."""


@dataclass(slots=True)
class Silent:
    """A sink that does nothing: base of those that do not want everything."""

    counts: dict[str, int] = field(default_factory=dict)

    def shot(self, shot: Shot) -> None:
        """Nothing."""

    def raw(self, raw: Raw) -> None:
        """Nothing."""

    def health(self, health: Health) -> None:
        """Nothing."""

    def close(self) -> None:
        """Nothing."""

    @property
    def report(self) -> Mapping[str, Any]:
        """What was counted."""
        return dict(self.counts)
