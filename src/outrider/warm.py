"""Compile, in a process of its own, the loops that a first run needs last."""

from __future__ import annotations

import numpy as np

from outrider import associate, body, change, tracker
from outrider.book import empty
from outrider.records import Ego, TrackState
from outrider.settings import Observer, Settings
from outrider.threat import assess


def compile_later_steps(observer: str = Observer().name) -> None:
    """Compile what a scan meets after its rectangles are fitted, and leave it in the cache.

    Meant for a second process while the first one compiles the fit. Each loop is called once with arrays of
    the types the pipeline uses; what they hold does not matter. Raises InputError for an unknown observer.
    """
    settings = Settings(observer=Observer(name=observer))
    ready = tracker.engine(settings)
    one, rows, beams = np.zeros(1, np.int64), np.zeros((1, 2), np.int64), np.arange(2)
    p, o, pose, yes = np.zeros((2, 2)), np.zeros((2, 3)), np.zeros((1, 3)), np.ones(2, np.bool_)
    segments = (beams, one, one)
    associate.widen(p, p[:, 0].copy(), segments, yes[:1], one, rows, np.zeros(1), pose, p[:1], p[:1], 0.5)
    _compile_threat(settings, ready)
    body.measure(p, o, beams, rows, np.zeros((1, 2), np.bool_), p[:1], pose, p[:1], 0.1)
    box = np.zeros(5)
    change.ask(p, np.zeros(2), yes, o, 0.0, 0.1, box, box, np.zeros(2), np.zeros(4))


def _compile_threat(settings: Settings, ready: tracker.Engine) -> None:
    """The observer's loops and the search for contact, on one track that is about to hit the rider."""
    book = empty(1, ready.n_states)
    book.z[:], book.size[:] = 1.0, 1.0
    book.x[0, :3] = 5.0, 0.0, -4.0
    book.state[:] = TrackState.CONFIRMED
    dt, one = np.full(1, 0.1), np.zeros(1, np.int64)
    ready.loops.start_all(book.z, book.z, dt, ready.gains, one, book.obs)
    ready.loops.step_all(book.obs, book.z, book.z, dt, ready.gains, one, book.obs)
    book.observed[:] = True
    standing = Ego(0.0, np.zeros(3), np.zeros(2), 0.0, False)
    assess(tracker.estimate(book, 0.1, settings, ready), standing, settings.rider, settings.threat)
