"""What the tracker remembers between two scans: frozen columns, row i is track i."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from outrider.envelope import LOOKS
from outrider.records import Array, Bools, Bytes, Ints, Scan, TrackState

N_MEASURED = 9  # columns of an observer's measurement
REST_S = 0.3  # what stands is predicted no further: it stays where it was seen, however long ago [s]


@dataclass(frozen=True, slots=True)
class Book:
    """All tracks, in order of birth; fixed frame W, full-size lengths."""

    id: Ints  # (n,)
    state: Bytes  # (n,) TrackState
    born: Array  # (n,) [s]
    seen: Array  # (n,) time of the last returns, which is the time of x and P [s]
    x: Array  # (n, 6) predictor: x, y, vx, vy, heading, yaw rate
    P: Array  # (n, 6, 6)
    size: Array  # (n, 4) length, width, their standard deviations [m]
    sightings: Ints  # (n,) bit k: seen k scans ago
    shifts: Ints  # (n,) bit k: the k-th last look at an earlier scan says the body has moved
    home: Array  # (n, 2) where it was born, drawn slowly to where it stands [m]
    looked: Array  # (n,) time of that last look [s]
    slow_since: Array  # (n,) [s] inf while it moves
    directed: Bools  # (n,) which end is the front is known
    observed: Bools  # (n,) an observer runs
    z: Array  # (n, 9) last measurement, as the observer takes it
    obs: Array  # (n, m) the observer's state, at `seen`
    hits: Ints  # (n,) returns in the last scan
    looks: Array  # (n, LOOKS, 3) time [s] and place [m] of the last measurements, newest first; NaN: none
    broken: Bools  # (n,) what is assumed for the bounds did not hold, as the last scan shows

    def __len__(self) -> int:
        return len(self.id)

    def ahead(self, t: Array | float, rows: Ints | slice = slice(None)) -> Array:
        """How far [s] to predict `rows` for the times t (they broadcast): at most REST_S what stands."""
        dt = t - self.seen[rows]
        return np.where(self.state[rows] == TrackState.STATIC, np.minimum(dt, REST_S), dt)

    def keep(self, mask: Bools) -> Book:
        """The tracks where mask (n,) holds."""
        if mask.all():
            return self
        return replace(self, **{f.name: getattr(self, f.name)[mask] for f in fields(self)})

    def writable(self) -> Book:
        """The same tracks in arrays of its own."""
        return replace(self, **{f.name: getattr(self, f.name).copy() for f in fields(self)})

    def append(self, other: Book) -> Book:
        """These tracks, then those of `other`."""
        if not len(other):
            return self
        return Book(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))


def empty(n: int, n_states: int) -> Book:
    """n blank tracks for an observer of n_states states."""
    return Book(
        id=np.zeros(n, np.int64),
        state=np.zeros(n, np.uint8),
        born=np.zeros(n),
        seen=np.zeros(n),
        x=np.zeros((n, 6)),
        P=np.zeros((n, 6, 6)),
        size=np.zeros((n, 4)),
        sightings=np.ones(n, np.int64),
        shifts=np.zeros(n, np.int64),
        home=np.zeros((n, 2)),
        looked=np.full(n, -np.inf),
        slow_since=np.full(n, np.inf),
        directed=np.zeros(n, np.bool_),
        observed=np.zeros(n, np.bool_),
        z=np.full((n, N_MEASURED), np.nan),
        obs=np.zeros((n, n_states)),
        hits=np.zeros(n, np.int64),
        looks=np.full((n, LOOKS, 3), np.nan),
        broken=np.zeros(n, np.bool_),
    )


@dataclass(frozen=True, slots=True)
class TrackMemory:
    """The book, the next free identity, and some earlier scans to ask whether something has moved."""

    book: Book
    next_id: int
    earlier: tuple[Scan, ...]  # oldest first
