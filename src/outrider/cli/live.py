"""`outrider live`: from the beams of a lidar, or a recording in its place, to horn, page and file."""

import gc
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from outrider.cli import show

if TYPE_CHECKING:
    from outrider.live import Sink, Source
    from outrider.live.clock import Pace
    from outrider.settings import Settings

SWITCH_S = 5e-4  # how long one thread may keep another waiting; Python's 5 ms would be heard


def live(
    *,
    port: str = "auto",
    mode: str | None = None,
    observer: str | None = None,
    settings: Path | None = None,
    set_: Annotated[list[str] | None, Parameter("--set", negative=())] = None,
    record: Path | None = None,
    record_size_mb: float = 1000.0,
    record_minutes: float = 60.0,
    record_floor_mb: float = 500.0,
    page: Annotated[bool | str, Parameter(negative=())] = False,
    page_token: str = "",
    horn: str = "none",
    lines: str | None = None,
    replay: str | None = None,
    speed: float = 1.0,
    seconds: float | None = None,
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Track what a lidar sees now, and warn; ends with Ctrl-C.

    Parameters
    ----------
    port
        Serial port of the lidar; auto: the first one that answers.
    mode
        Measuring mode of the lidar, by its name; without it, its best one.
    observer
        Name of the observer (observer.name; see `outrider ls observers`).
    settings
        TOML file with settings; what it does not state keeps its default.
    set_
        One setting as section.key=value, over the file; may be repeated.
    record
        Keep everything in this MCAP file, also what the lidar said byte by byte.
    record_size_mb
        A file that is larger is followed by the next one.
    record_minutes
        So is one that is older.
    record_floor_mb
        With less room left on the disk nothing is recorded.
    page
        Show it in a browser: at 127.0.0.1:8642, or at HOST:PORT where that is given.
    page_token
        Word that the page asks for; without it, one is made up where one is needed.
    horn
        none, wav:FILE, device, device:NAME or command:PROGRAM.
    lines
        Tell other programs: tcp://HOST:PORT or unix://PATH.
    replay
        A recording, or dataset:NAME, in place of a lidar.
    speed
        Of the replay, against its own.
    seconds
        End after so long.
    """
    from outrider.cli.live_status import Status, rows
    from outrider.cli.warm import compiling_beside
    from outrider.errors import OutriderError
    from outrider.live.engine import Live

    changes = [*(set_ or []), *([f'observer.name="{observer}"'] if observer else [])]
    source, used, pace = _source(port, mode, settings, changes, replay, speed)
    bounds = {"size_mb": record_size_mb, "minutes": record_minutes, "floor_mb": record_floor_mb}
    wanted = _sinks(used, source, page, page_token, horn, lines, record, {**bounds, "force": force})
    with ExitStack() as made, _asked_to_stop() as stop:
        sinks: list[Sink] = []
        for sink in wanted:
            made.callback(sink.close)
            sinks.append(sink)
        status = Status(source, tuple(sinks))
        run = Live(source, [*sinks, status], used, pace)
        status.say("getting ready (the first time, inner loops are compiled, which takes a minute)")
        with compiling_beside(used.observer.name):
            run.warm(stop)
        status.say("ready; Ctrl-C ends it")
        with _prompt():
            figures = run.run(stop, float("inf") if seconds is None else seconds)
    if json:
        show.json(figures)
    else:
        show.table(rows(figures))
    if replay is None and figures["ended"] == "source":
        raise OutriderError(
            "the reader of the lidar has ended, which it should not; start again and report it"
        )


def _source(
    port: str,
    mode: str | None,
    settings: Path | None,
    changes: list[str],
    replay: str | None,
    speed: float,
) -> "tuple[Source, Settings, Pace | None]":
    """Where scans come from, under which settings, and how its clock runs beside that of the host."""
    from outrider import offline
    from outrider.errors import InputError
    from outrider.live import clock
    from outrider.live.replay import open_replay

    if replay is None:
        if speed != 1.0:
            raise InputError(f"--speed {speed:g}: a lidar has its own; want --replay RECORDING as well")
        from outrider.rplidar.device import Device

        return Device(port, mode, clock=clock.now), offline.settle({}, settings, changes), None
    if port != "auto" or mode:
        raise InputError("--port and --mode are of a lidar, --replay is in its place; leave one out")
    played, used = open_replay(replay, settings, changes, speed)
    return played, used, played.pace


def _sinks(
    used: "Settings",
    source: "Source",
    page: bool | str,
    page_token: str,
    horn: str,
    lines: str | None,
    record: Path | None,
    recording: dict[str, Any],
) -> "Iterator[Sink]":
    """Whoever was asked for, the most urgent first; those made stay open where a later one cannot be."""
    from outrider.live.sounders import sounder

    noise = sounder(horn)
    if noise is not None:
        from outrider.live.horn import Horn

        yield Horn(noise)
    if lines is not None:
        from outrider.live.lines import Lines

        yield Lines(lines)
    if page:
        from outrider.live.page.server import PageSink, address

        host, number = address("" if page is True else str(page))
        yield PageSink(used, host, number, page_token, source.about)
    if record is not None:
        from outrider.live.record import Recorder

        yield Recorder(record, used, lambda: source.about, **recording)


@contextmanager
def _prompt() -> Iterator[None]:
    """Threads take turns quickly, and what is there already is not searched for garbage any more."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)


@contextmanager
def _asked_to_stop() -> Iterator[threading.Event]:
    """Set by Ctrl-C or SIGTERM; a second Ctrl-C ends the program at once."""
    stop = threading.Event()

    def take(number: int, frame: Any) -> None:
        if stop.is_set() and number == signal.SIGINT:
            raise KeyboardInterrupt
        stop.set()

    before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
