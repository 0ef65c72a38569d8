"""Tracks as they were some scans ago, in the light of the scans since: fixed-lag smoothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from outrider import observers
from outrider.book import Book
from outrider.records import Array, Ints, Tracks, TrackState
from outrider.tracker import MOVING, Engine

Steps = tuple[tuple[float, Array], ...]  # time [s] and state (n_states,) of the observer, oldest first


@dataclass(frozen=True, slots=True)
class History:
    """What looking back takes: nothing while the lag is 0."""

    tracks: tuple[Tracks, ...] = ()  # of the last scans, oldest first
    steps: Mapping[int, Steps] = field(default_factory=dict)  # by identity: the observer's last steps


def look_back(history: History, book: Book, tracks: Tracks, eng: Engine) -> tuple[History, Tracks | None]:
    """History one scan on, and the tracks of `eng.lag` scans ago, smoothed; None before there are any.

    A track that has died since, or that no observer ran for then, stays as it was told at the time.
    """
    if not eng.lag:
        return history, None
    steps: dict[int, Steps] = {}
    for i in np.flatnonzero(book.observed):
        known = history.steps.get(int(book.id[i]), ())
        if not known or known[-1][0] < book.seen[i]:
            known = (*known, (float(book.seen[i]), book.obs[i].copy()))
        steps[int(book.id[i])] = known[-eng.lag - 1 :]
    scans = (*history.tracks, tracks)[-eng.lag - 1 :]
    after = History(scans, steps)
    moving = book.id[book.state == TrackState.CONFIRMED]
    return after, _smoothed(scans[0], moving, steps, eng) if len(scans) > eng.lag else None


def _smoothed(then: Tracks, moving: Ints, steps: Mapping[int, Steps], eng: Engine) -> Tracks:
    """The tracks with the motion that later steps give them, where there are any.

    What is known to move now was moving then, though it may have been told as standing.
    """
    state = np.where(np.isin(then.id, moving), TrackState.CONFIRMED, then.state).astype(np.uint8)
    states, seen, rows = np.zeros((len(then.id), eng.n_states)), np.full(len(then.id), then.t), []
    for row in np.flatnonzero(np.isin(state, MOVING)):
        track = int(then.id[row])
        taken = [k for k, (t, _) in enumerate(steps.get(track, ())) if t <= then.t]
        if taken:
            times, past = zip(*steps[track][taken[-1] :], strict=True)
            dt = np.diff(times, prepend=times[0])
            lag = len(times) - 1
            states[row] = observers.lagged(eng.observer, np.array([past]), dt[None], lag, eng.gains)[0, 0]
            seen[row] = times[0]
            rows.append(row)
    return eng.tell(replace(then, state=state), states, then.t - seen, np.array(rows, np.int64))
