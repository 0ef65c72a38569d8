"""A recording from its first message to its last alert, and the run folder that keeps what came out.

Frames carry lengths of the full-size world (the recording's times `recording.scale`); a run folder has them
divided by the scale again. Times are the recording's own clock [s].
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from outrider import pipeline
from outrider import settings as st
from outrider.datasets import open_any
from outrider.errors import InputError
from outrider.interrupt import Interrupts
from outrider.io import Chosen, Message, Recording, choose_topics
from outrider.io._recording import POSE_TYPE, SCAN_TYPE, Topic
from outrider.records import Frame, LaserScan, Pose
from outrider.scan import ScanStream
from outrider.tally import Tally
from outrider.timing import HEAD, TimingEstimate, survey

if TYPE_CHECKING:
    from outrider.io.run import Run

Source = Path | str | Recording | Iterable[Message]
Given = st.Settings | Path | str | None

# ------------------------------------------------------------------ settings


def settle(
    recommended: Mapping[str, Mapping[str, Any]], given: Given, changes: Sequence[str] = ()
) -> st.Settings:
    """Settings in layers, the later ones winning: defaults, recommended, given, changes `section.key=value`.

    given: a TOML file, of which what it states counts, or Settings, of which what differs from the defaults
    counts. Raises InputError as `settings.load` and `settings.override` do.
    """
    tree: dict[str, Any] = msgspec.to_builtins(st.Settings())
    for layer in (recommended, _stated(given)):
        for section, values in layer.items():
            gains = {**tree["observer"]["gains"], **values.get("gains", {})}
            tree[section] = {**tree[section], **values}
            tree["observer"]["gains"] = gains  # a layer replaces those of the observers it names
    return st.override(msgspec.convert(tree, st.Settings), list(changes))


def _stated(given: Given) -> dict[str, dict[str, Any]]:
    if given is None:
        return {}
    if isinstance(given, st.Settings):
        usual, tree = msgspec.to_builtins(st.Settings()), msgspec.to_builtins(given)
        return {s: {k: v for k, v in values.items() if v != usual[s][k]} for s, values in tree.items()}
    st.load(given)  # its message, where something is wrong
    stated: dict[str, dict[str, Any]] = msgspec.toml.decode(Path(given).read_bytes())
    return stated


# ------------------------------------------------------------------ source


class _Peeked:
    """Messages that can be looked at before they are taken; what was looked at is kept until then."""

    def __init__(self, messages: Iterable[Message]) -> None:
        self._rest, self._kept = iter(messages), list[Message]()

    def peek(self) -> Generator[Message, None, None]:
        """From the first one on."""
        yield from self._kept
        for message in self._rest:
            self._kept.append(message)
            yield message

    def take(self, topics: frozenset[str]) -> Iterator[Message]:
        """From the first one on, for the last time."""
        kept, self._kept = self._kept, []
        for part in (kept, self._rest):
            for message in part:
                if message.topic in topics:
                    yield message

    def recording(self) -> Recording:
        """The same as a recording; its topics are those before scan number HEAD."""
        counts: dict[tuple[str, str], int] = {}
        scans = 0
        for message in self.peek():
            is_scan = isinstance(message, LaserScan)
            key = (message.topic, "scan" if is_scan else "pose")
            counts[key] = counts.get(key, 0) + 1
            scans += is_scan
            if scans == HEAD:
                break
        types = {"scan": SCAN_TYPE, "pose": POSE_TYPE}
        topics = tuple(Topic(name, kind, types[kind], n) for (name, kind), n in sorted(counts.items()))
        return Recording(Path("messages"), "messages", topics, (), False, self.take)


@dataclass(frozen=True, slots=True)
class Opened:
    """A source made ready: what will be read, under which settings, and how its beams are timed."""

    name: str  # for summary.json: path, name of the data set, or "messages"
    recording: Recording
    settings: st.Settings
    chosen: Chosen
    estimate: TimingEstimate | None  # what the ego motion says where the header's times are wrong
    stream: ScanStream  # iterate once; its report counts what was repaired

    def frames(self) -> Iterator[Frame]:
        """All scans, one by one, as far as the alert."""
        return _frames(self.stream, self.settings)


def open_source(source: Source, settings: Given = None, changes: Sequence[str] = ()) -> Opened:
    """A recording by path, `dataset:` name, Recording or messages in receive order, ready to be tracked.

    Where the header's beam times need repair, the user has not set them and there are ego poses, the head of
    the recording is read beforehand to find the order of the beams (docs/scans.md). What is recommended for a
    data set lies under the settings that are given. Raises InputError.
    """
    entry = peeked = None
    if isinstance(source, Path | str):
        recording, entry = open_any(source)
    elif isinstance(source, Recording):
        recording = source
    else:
        peeked = _Peeked(source)
        recording = peeked.recording()
    settled = settle(entry.settings if entry else {}, settings, changes)
    chosen = choose_topics(recording, settled.recording)
    topics = [chosen.scan] + ([chosen.ego] if chosen.ego else [])
    estimate = None
    with suppress(InputError), closing(peeked.peek() if peeked else _head(recording, topics)) as head:
        estimate = survey(head, chosen.scan, chosen.ego, settled)
    stream = ScanStream(recording.messages(topics), chosen.scan, chosen.ego, settled, estimate)
    if peeked:
        name = "messages"
    else:
        name = str(source) if entry else str(recording.path.resolve())
    return Opened(name, recording, settled, chosen, estimate, stream)


def _head(recording: Recording, topics: list[str]) -> Generator[Message, None, None]:
    """Messages of a first reading; damage met here is told when it is met again."""
    yield from recording.messages(topics)


def _frames(scans: Iterable[Any], settings: st.Settings) -> Iterator[Frame]:
    engine, memory = pipeline.engine(settings), pipeline.start(settings)
    for scan in scans:
        memory, frame = pipeline.step(memory, scan, settings, engine)
        yield frame


# ------------------------------------------------------------------ public


def read(path: Path | str) -> Recording:
    """The recording at a path or of a `dataset:` name; `.messages()` gives its scans and poses one by one."""
    return open_any(path)[0]


def track(source: Source, settings: Given = None, changes: Sequence[str] = ()) -> Iterator[Frame]:
    """Frames of a recording, one a scan: detections, tracks, threats and alert.

    source: a path, `dataset:NAME`, a Recording, or messages in receive order. settings: Settings or a TOML
    file, over what is recommended for a data set; changes: `section.key=value`, over both. Lengths in frames
    are those of the full-size world. Raises InputError for a source or setting that cannot be used; bad
    sensor data is masked, counted and told in `frame.scan.faults` and `frame.alert.degraded`.
    """
    return open_source(source, settings, changes).frames()


def run(
    source: Source,
    folder: Path | str,
    settings: Given = None,
    changes: Sequence[str] = (),
    *,
    force: bool = False,
    pictures: bool = True,
    watch: Callable[[Frame], None] | None = None,
) -> Run:
    """Track a recording into a run folder and read that folder back; arguments as for `track`.

    force replaces the results in a folder that is not empty; pictures: scene.png and tracks.png; watch is
    called with every frame after it was written. Ctrl-C and a recording that turns out to be damaged leave a
    valid, `interrupted` folder before they are raised. Raises InputError and OutputError.
    """
    return write(open_source(source, settings, changes), folder, force=force, pictures=pictures, watch=watch)


def write(
    opened: Opened,
    folder: Path | str,
    *,
    force: bool = False,
    pictures: bool = True,
    watch: Callable[[Frame], None] | None = None,
) -> Run:
    """The run folder of a source that was opened; see `run`."""
    from outrider.io.run import RunWriter, open_run

    settings, tally = opened.settings, Tally()
    engine, memory = pipeline.engine(settings), pipeline.start(settings)
    with Interrupts() as ctrl_c, RunWriter(folder, settings, force=force, about=_about(opened)) as writer:
        try:
            for scan in opened.stream:
                with ctrl_c.held():  # a compiler at work in the first steps does not bear an exception
                    begin = time.perf_counter()
                    memory, frame = pipeline.step(memory, scan, settings, engine)
                    tally.add(frame, time.perf_counter() - begin)
                    writer.write(frame)
                if watch:
                    watch(frame)
            with ctrl_c.held():
                writer.close(_summary(opened, tally))
        except (KeyboardInterrupt, InputError) as error:
            told = str(error) or "stopped by Ctrl-C"
            with suppress(KeyboardInterrupt), ctrl_c.held():  # asked for again, it ends all the same
                writer.close({**_summary(opened, tally), "error": told}, interrupted=True)
            raise
    finished = open_run(folder)
    if pictures:
        draw(finished)
    return finished


def draw(finished: Run, truth: Iterable[Pose] | None = None) -> None:
    """scene.png and tracks.png in the folder of a run, with the true poses given, else its recording's."""
    from outrider import plots
    from outrider.evaluate import evaluate

    bodies = None
    with suppress(InputError):
        bodies = evaluate(finished, truth).truth
    plots.save(finished, finished.folder, bodies)


def _about(opened: Opened) -> dict[str, Any]:
    """What summary.json says from the first moment on."""
    chosen = opened.chosen
    return {
        "recording": opened.name,
        "settings_sha256": st.fingerprint(opened.settings),
        "topics": {"scan": chosen.scan, "ego": chosen.ego, "truth": list(chosen.truth)},
        "observer": opened.settings.observer.name,
        "truncated": opened.recording.truncated,
    }


def _summary(opened: Opened, tally: Tally) -> dict[str, Any]:
    estimate = opened.estimate
    return {
        **tally.as_dict(),
        "repairs": opened.stream.report.as_dict(),
        "timing": None if estimate is None else {"confident": estimate.confident, "words": estimate.words},
    }
