"""The run folder: everything that one run gave, written so that a killed process leaves it readable.

Tables grow as Arrow streams, of which every finished chunk can be read, and become Parquet at the end.
All lengths in a folder are those of the recording; the files and columns are described in docs/results.md.
"""

from __future__ import annotations

import os
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec
import numpy as np

from outrider import __version__
from outrider.errors import InputError, OutputError
from outrider.io._folder import prepare, writing
from outrider.io._run_background import Background, load_background
from outrider.io._run_rows import alert_row, in_recording_lengths, scan_columns, track_columns, tracks_columns
from outrider.records import Array, Frame, Level, TrackState
from outrider.settings import Settings, dump, load

FORMATS = ()  # a run folder is no recording
OURS = (
    *("settings.toml", "summary.json", "alerts.jsonl", "run.mcap", "background.npz", "scene.png"),
    *("tracks.png", "tracks.arrows", "tracks.parquet", "scans.arrows", "scans.parquet"),
    *("lagged.arrows", "lagged.parquet"),
)
CHUNK_S, CHUNK_SCANS = 1.0, 16  # what a killed process may lose
BACKGROUND_S = 10.0  # between two saves of the background


def _tables(settings: Settings) -> tuple[str, ...]:
    """Names of the tables that a run under these settings keeps."""
    return ("tracks", "scans", "lagged") if "+lag" in settings.observer.name else ("tracks", "scans")


# ------------------------------------------------------------------ writer


class RunWriter:
    """Writes one run folder, frame by frame; use as a context manager.

    folder is made, or must be empty; `force` replaces the files of an earlier run and nothing else.
    scale (full-size length / recorded length) overrides `settings.recording.scale`; every length is
    divided by it on the way out. about: what summary.json says from the start, such as {"recording": name}.

    An exception inside the `with` block, Ctrl-C among them, still closes the folder as a valid, interrupted
    run. Raises InputError for a folder that may not be used, OutputError where the file system refuses.
    """

    def __init__(
        self,
        folder: Path | str,
        settings: Settings,
        scale: float | None = None,
        force: bool = False,
        about: dict[str, Any] | None = None,
    ) -> None:
        self.folder = Path(folder)
        self._scale = settings.recording.scale if scale is None else scale
        self._about = {"version": __version__, "finished": False, "interrupted": False, **(about or {})}
        recording = msgspec.structs.replace(settings.recording, scale=self._scale)
        settings = msgspec.structs.replace(settings, recording=recording)
        self._prepare(force)
        self._open(settings)
        self._background = Background(0.1 / self._scale)
        self._ids: dict[str, set[int]] = {"all": set(), "moving": set()}
        self._masked, self._faults, self._alerts = Counter[str](), Counter[str](), Counter[str]()
        self._times = [np.nan, np.nan]
        self._scans = self._degraded = self._pending = 0
        self._flushed = self._saved = -np.inf
        self._said: tuple[Level, int, tuple[str, ...]] = (Level.NONE, -1, ())
        self._closed = False

    def _prepare(self, force: bool) -> None:
        prepare(self.folder, force)
        with writing(self.folder):
            for name in OURS:
                (self.folder / name).unlink(missing_ok=True)

    def _open(self, settings: Settings) -> None:
        from outrider.io._run_mcap import McapSink
        from outrider.io._run_tables import ChunkedTable

        folder = self.folder
        with writing(folder), ExitStack() as stack:
            (folder / "settings.toml").write_text(dump(settings))
            self._summarise({})
            self._tables = {name: ChunkedTable(folder, name) for name in _tables(settings)}
            for table in self._tables.values():
                stack.callback(table.close)
            self._alert_file = stack.enter_context((folder / "alerts.jsonl").open("wb"))
            self._mcap_file = stack.enter_context((folder / "run.mcap").open("wb"))
            about = {k: str(v) for k, v in self._about.items() if k not in ("finished", "interrupted")}
            self._mcap = McapSink(self._mcap_file, settings, self._scale, about)
            self._files = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        if isinstance(error, OutputError):
            self._release()
        elif error is not None:
            with suppress(OutputError):
                self.close({"error": f"{type(error).__name__}: {error}"}, interrupted=True)
        else:
            self.close({})

    def write(self, frame: Frame) -> None:
        """Adds one frame, lengths of the full-size world; OutputError where it cannot be written."""
        frame = in_recording_lengths(frame, self._scale)
        with writing(self.folder):
            self._tables["tracks"].add(tracks_columns(frame))
            self._tables["scans"].add(scan_columns(frame))
            if frame.lagged is not None and "lagged" in self._tables:
                self._tables["lagged"].add(track_columns(frame.lagged))
            self._count(frame)
            self._tell(frame)
            self._mcap.write(frame)
            self._background.add(frame)
            if self._pending >= CHUNK_SCANS or abs(frame.t - self._flushed) >= CHUNK_S:
                self._flush(frame.t)
            if abs(frame.t - self._saved) >= BACKGROUND_S:
                self._background.save(self.folder / "background.npz")
                self._saved = frame.t

    def _count(self, frame: Frame) -> None:
        ids, state = frame.tracks.id, frame.tracks.state
        self._ids["all"].update(ids.tolist())
        self._ids["moving"].update(ids[state == TrackState.CONFIRMED].tolist())
        self._masked.update(frame.scan.masked)
        self._faults.update(f for f in frame.scan.faults if f in self._faults or len(self._faults) < 100)
        self._degraded += bool(frame.alert.degraded)
        self._times = [self._times[0] if self._scans else frame.t, frame.t]
        self._scans += 1
        self._pending += 1

    def _tell(self, frame: Frame) -> None:
        """A line in alerts.jsonl where the level, its track or the trust in it changed."""
        alert = frame.alert
        said = (alert.level, alert.track, alert.degraded)
        if said == self._said:
            return
        if alert.level != self._said[0]:
            self._alerts[alert.level.name.lower()] += 1
        self._said = said
        self._alert_file.write(msgspec.json.encode(alert_row(alert)) + b"\n")
        self._alert_file.flush()

    def _flush(self, t: float) -> None:
        for table in self._tables.values():
            table.flush()
        self._flushed, self._pending = t, 0

    def close(self, summary: dict[str, Any] | None = None, interrupted: bool = False) -> None:
        """Ends the run: tables as Parquet, index of run.mcap, summary.json; a second call does nothing."""
        from outrider.io._run_tables import seal

        if self._closed:
            return
        with writing(self.folder):
            try:
                self._flush(self._times[1])
                self._mcap.close()
                self._background.save(self.folder / "background.npz")
            finally:
                self._release()
            for name in self._tables:
                seal(self.folder, name)
            self._summarise({**(summary or {}), "finished": True, "interrupted": interrupted})

    def _release(self) -> None:
        """Closes the files; what they hold already stays."""
        self._closed = True
        with suppress(OSError):
            self._files.close()

    def _summarise(self, more: dict[str, Any]) -> None:
        counts: dict[str, Any] = {}
        if more:
            counts = {
                "scans": self._scans,
                "t_first": self._times[0] if self._scans else None,
                "t_last": self._times[1] if self._scans else None,
                "tracks": len(self._ids["all"]),
                "moving_tracks": len(self._ids["moving"]),
                "alerts": {level.name.lower(): self._alerts[level.name.lower()] for level in Level if level},
                "degraded_scans": self._degraded,
                "masked_beams": dict(self._masked),
                "faults": dict(self._faults),
            }
        _write_summary(self.folder, {**self._about, **counts, **more})


def _write_summary(folder: Path, summary: dict[str, Any]) -> None:
    part = folder / "summary.json.part"
    text = msgspec.json.encode(
        summary, enc_hook=lambda value: value.item() if hasattr(value, "item") else str(value)
    )
    part.write_bytes(msgspec.json.format(text) + b"\n")
    os.replace(part, folder / "summary.json")


# ------------------------------------------------------------------ reader


@dataclass(frozen=True, slots=True)
class Run:
    """A run folder that was read; lengths are those of the recording."""

    folder: Path
    settings: Settings
    summary: dict[str, Any]
    tracks: Any  # pyarrow.Table, one row per track and scan
    scans: Any  # pyarrow.Table, one row per scan
    alerts: list[dict[str, Any]]  # one per change, in order of time
    lagged: Any = None  # like tracks, without `ttc`, as known some scans later; None: none kept

    def to_pandas(self) -> Any:
        """The tracks as a pandas DataFrame; needs pandas, `pip install outrider[pandas]`."""
        return self.tracks.to_pandas()

    @property
    def background(self) -> Array:
        """(n, 2) points of the standing world [m], fixed frame; empty where none was kept."""
        return load_background(self.folder / "background.npz")


def _alert_lines(path: Path) -> list[dict[str, Any]]:
    lines: list[dict[str, Any]] = []
    with suppress(OSError, msgspec.DecodeError):  # the last line may be cut
        for line in path.read_bytes().splitlines():
            lines.append(msgspec.json.decode(line))
    return lines


def open_run(folder: Path | str) -> Run:
    """Reads a run folder, finished or killed; raises InputError where it is not one."""
    from outrider.io._run_tables import read_table

    folder = Path(folder)
    if not (folder / "settings.toml").is_file():
        raise InputError(
            f"{folder}: not a run folder (no settings.toml in it); want what `outrider track -o` wrote"
        )
    summary: dict[str, Any] = {}
    with suppress(OSError, msgspec.DecodeError):
        summary = msgspec.json.decode((folder / "summary.json").read_bytes())
    settings = load(folder / "settings.toml")
    return Run(
        folder=folder,
        settings=settings,
        summary=summary,
        tracks=read_table(folder, "tracks"),
        scans=read_table(folder, "scans"),
        alerts=_alert_lines(folder / "alerts.jsonl"),
        lagged=read_table(folder, "lagged") if "lagged" in _tables(settings) else None,
    )


def finish(folder: Path | str) -> Run:
    """Brings a killed run into the form of a finished one, as far as it was written; marked `interrupted`.

    Raises InputError where it is no run folder, OutputError where it cannot be written.
    """
    from outrider.io._run_mcap import recover
    from outrider.io._run_tables import seal

    run = open_run(folder)
    if run.summary.get("finished"):
        return run
    with writing(run.folder):
        for name in _tables(run.settings):
            if (run.folder / f"{name}.arrows").exists():
                seal(run.folder, name)
        if (run.folder / "run.mcap").exists():
            recover(run.folder / "run.mcap")
        t = run.scans["t"].to_numpy()
        counts = {"scans": len(t), "t_first": t[0] if len(t) else None, "t_last": t[-1] if len(t) else None}
        ended = {"version": __version__, **run.summary, **counts, "finished": True, "interrupted": True}
        _write_summary(run.folder, ended)
    return open_run(run.folder)
