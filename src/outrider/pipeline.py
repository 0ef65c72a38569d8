"""One scan further: the only file that knows the order of the steps."""

from __future__ import annotations

from dataclasses import dataclass

from outrider import alert as alerts
from outrider import envelope
from outrider.alert import AlertMemory
from outrider.book import TrackMemory
from outrider.detect import detect
from outrider.lag import History, look_back
from outrider.records import Frame, Scan
from outrider.repair import restarts
from outrider.settings import Settings
from outrider.threat import assess
from outrider.tracker import Engine, update
from outrider.tracker import engine as engine  # made once for a run, handed to every step
from outrider.tracker import start as no_tracks


@dataclass(frozen=True, slots=True)
class Memory:
    """What one scan hands to the next."""

    tracks: TrackMemory
    alerts: AlertMemory
    history: History


def start(settings: Settings) -> Memory:
    """Memory before the first scan; InputError for an unknown observer or gain, or limits that cannot be."""
    envelope.check(settings)
    return Memory(no_tracks(settings), alerts.start(), History())


def restart(memory: Memory, settings: Settings) -> Memory:
    """Memory after clock or fixed frame became another: no track lives on, no identity is used twice."""
    nothing = no_tracks(settings)
    tracks = TrackMemory(nothing.book, memory.tracks.next_id, nothing.earlier)
    return Memory(tracks, AlertMemory(memory.alerts.t, {}), History())


def step(memory: Memory, scan: Scan, settings: Settings, engine: Engine) -> tuple[Memory, Frame]:
    """One scan to its alert: detections, tracks, threats, alert; full-size lengths, fixed frame W.

    Any scan that `scan.ScanStream` gives is taken, also one without beams or without a valid one. The engine
    is that of `engine(settings)`. Raises InputError for settings that contradict each other.
    """
    if restarts(scan):
        memory = restart(memory, settings)
    segments, seen = detect(scan, settings.detect)
    tracked, detections, tracks = update(memory.tracks, scan, segments, seen, settings, engine)
    threats = assess(tracks, scan.ego, settings.rider, settings.threat)
    trust = alerts.health(scan, memory.alerts.t, settings.alert)
    alerted, warning = alerts.alert(memory.alerts, threats, tracks, trust, settings.alert)
    history, before = look_back(memory.history, tracked.book, tracks, engine)
    frame = Frame(scan.t, scan, detections, tracks, threats, warning, before)
    return Memory(tracked, alerted, history), frame
