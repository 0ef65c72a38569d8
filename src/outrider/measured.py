"""What the tracker measured of the bodies whose truth is known: the same input for every observer.

Front end and tracker run once: which returns belong to which track does not depend on the observer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from outrider import pipeline
from outrider.book import Book
from outrider.compare import Series
from outrider.datasets import PREFIX as DATASET
from outrider.datasets import Entry, entry, open_any
from outrider.errors import InputError
from outrider.evaluate import GATE_M, Body, bodies
from outrider.geometry import wrap
from outrider.io import choose_topics
from outrider.observers import Measurement
from outrider.offline import Given, Opened, Source, open_source
from outrider.records import Array, Bools, Frame, Ints, Pose
from outrider.settings import Settings

HEADING, VARIANCE = Measurement._fields.index("heading"), Measurement._fields.index("heading_variance")

Truths = Iterable[Pose] | Path | str | None


@dataclass(frozen=True, slots=True)
class Measured:
    """The series of one recording."""

    name: str  # of the recording
    series: tuple[Series, ...]
    left_out: tuple[str, ...]  # bodies with truth that were never measured in two scans in a row
    settings: Settings  # under which front end and tracker ran


@dataclass(frozen=True, slots=True)
class _Sight:
    """All tracks after one scan."""

    t: float  # of the scan [s]
    place: Array  # (n, 2) predicted to t [m]
    seen: Bools  # (n,) in this scan
    rows: Array  # (n, 11) time of the last returns [s], whether the front is known, what the observer gets


def measure(
    source: Source,
    settings: Given = None,
    changes: Sequence[str] = (),
    truth: Truths = None,
    offset: Sequence[float] | None = None,
    gate: float = GATE_M,
) -> Measured:
    """Measurements of all bodies with truth in a recording, in lengths of the full-size world.

    source, settings, changes: as for `offline.track`. truth: poses, or the recording that holds them, by path
    or `dataset:` name; None: the recording itself. offset: the body centre in the frame whose pose was
    measured, in the recording's metres; None: as the data set says, else (0, 0). A body's track is in each
    scan the one nearest to the truth, within `gate` [m].

    A series begins when the body is first measured, standing or not; rows in which it was not seen are NaN;
    where that lasts longer than a track may coast, another series begins. An observer starts from two scans
    in a row; without these there is no series. Raises InputError where the recording or a setting cannot be
    used, or there is no truth.
    """
    return collect(open_source(source, settings, changes), truth, offset, gate)


def collect(
    opened: Opened,
    truth: Truths = None,
    offset: Sequence[float] | None = None,
    gate: float = GATE_M,
    watch: Callable[[Frame], None] | None = None,
) -> Measured:
    """What `measure` says, of a source that was opened; watch is called with every frame."""
    poses, known = _poses(opened, truth)
    scale = opened.settings.recording.scale
    true = bodies(poses, known, offset, scale)
    if not true:
        raise InputError(f"{opened.name}: no true pose to compare with; name a recording that holds some")
    until = known.valid_until_s if known and known.valid_until_s is not None else np.inf
    sights = list(_sights(opened, until, watch))
    found: list[Series] = []
    left_out: list[str] = []
    for body in true:
        pieces = list(_pieces(body, sights, gate, opened.settings.track.coast_s))
        found += pieces
        left_out += [] if pieces else [body.name]
    return Measured(opened.name, tuple(found), tuple(left_out), opened.settings)


def _poses(opened: Opened, source: Truths) -> tuple[Iterable[Pose], Entry | None]:
    """The true poses, and what is known about the data set they come from."""
    if source is not None and not isinstance(source, str | Path):
        return source, None
    if source is None:
        recording, topics = opened.recording, opened.chosen.truth
        known = entry(opened.name) if opened.name.startswith(DATASET) else None
    else:
        recording, known = open_any(source)
        topics = choose_topics(recording, opened.settings.recording).truth
    found = recording.messages(topics) if topics else iter(())
    return (message for message in found if isinstance(message, Pose)), known


def _sights(opened: Opened, until: float, watch: Callable[[Frame], None] | None) -> Iterator[_Sight]:
    """The tracks after each scan, up to `until` seconds after the first one."""
    engine, memory = pipeline.engine(opened.settings), pipeline.start(opened.settings)
    begin = np.nan
    for scan in opened.stream:
        memory, frame = pipeline.step(memory, scan, opened.settings, engine)
        if watch:
            watch(frame)
        begin = frame.t if np.isnan(begin) else begin
        if frame.t - begin > until:
            return
        yield _sight(memory.tracks.book, frame)


def _sight(book: Book, frame: Frame) -> _Sight:
    place = book.x[:, :2] + book.ahead(frame.t)[:, None] * book.x[:, 2:4]
    seen = ((book.sightings & 1) > 0) & np.isfinite(book.z).all(axis=1)  # none at birth
    rows = np.column_stack([book.seen, book.directed, book.z])
    return _Sight(frame.t, place, seen, rows)


def _pieces(body: Body, sights: Sequence[_Sight], gate: float, coast_s: float) -> Iterator[Series]:
    """The stretches in which one body was measured and never out of sight for longer than `coast_s`."""
    places = body.truth.at(np.array([sight.t for sight in sights])).W_p
    table = np.array([_row(sight, place, gate) for sight, place in zip(sights, places, strict=True)])
    table = table.reshape(-1, 2 + len(Measurement._fields))
    table = table[np.diff(np.fmax.accumulate(table[:, 0]), prepend=-np.inf) > 0.0]
    seen = np.flatnonzero(np.isfinite(table[:, 2]))
    _doubt(table, seen)
    count = 0
    for piece in np.split(seen, np.flatnonzero(np.diff(table[seen, 0]) > coast_s) + 1):
        if (np.diff(piece) == 1).any():
            count += 1
            t, y = table[piece[0] : piece[-1] + 1, 0], table[piece[0] : piece[-1] + 1, 2:]
            name = body.name if count == 1 else f"{body.name} ({count})"
            yield Series(name, t, y, body.truth.at(t))


def _row(sight: _Sight, place: Array, gate: float) -> Array:
    """Row of the body that truly is at `place` (2,), as in _Sight; NaN but for the time: not seen."""
    unseen = np.array([sight.t, *[np.nan] * (1 + len(Measurement._fields))])
    if not len(sight.place) or not np.isfinite(place).all():
        return unseen
    far = np.hypot(*(sight.place - place).T)
    i = int(far.argmin())
    return sight.rows[i] if far[i] < gate and sight.seen[i] else unseen


def _doubt(table: Array, seen: Ints) -> None:
    """A heading that the tracker turned round, once it knew the front, was not known before."""
    heading, directed = table[seen, 2 + HEADING], table[seen, 1] > 0.0
    turned = np.flatnonzero((np.abs(wrap(np.diff(heading))) > 0.5 * np.pi) & ~directed[:-1])
    if len(turned):
        table[seen[: turned[-1] + 1], 2 + VARIANCE] = np.inf
