"""`outrider emulate`: a lidar that is not there, at a pseudo-terminal, for trying out what reads one."""

import signal
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from outrider.cli import show

if TYPE_CHECKING:
    from outrider.records import LaserScan
    from outrider.rplidar.models import Mode, Model

RATE_HZ = 10.0  # turns a second at the usual speed of the motor


def emulate(
    source: str,
    /,
    *,
    model: str = "A1",
    mode: str | None = None,
    link: Path | None = None,
    speed: float = 1.0,
    seconds: float | None = None,
    orders: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Be a lidar that sees a scenario or a recording, at a pseudo-terminal; ends with Ctrl-C.

    Its path is printed. After its end, the scenario or recording begins again.

    Parameters
    ----------
    source
        Name of a scenario (see `outrider ls scenarios`) or path of one, path of a recording, or dataset:NAME.
    model
        A1, A3, C1, S2 or S3.
    mode
        Measuring mode it recommends, by its name; without it, its fastest one.
    link
        Symbolic link that is kept pointing to the pseudo-terminal.
    speed
        Of its clock, against the true one.
    seconds
        End after so long.
    orders
        Read faults from the standard input, a line each, such as: unplug 2. An empty line lists them.
    """
    from outrider.rplidar.emulator import Emulator
    from outrider.rplidar.models import choose
    from outrider.rplidar.scene import Scene
    from outrider.rplidar.sensor import Sensor

    known = _model(model)
    scene = Scene(_scans(source, known, choose(known.modes, mode)))
    emulator = Emulator(Sensor(known, scene, mode), link, speed)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)  # the link is taken away then too
    try:
        print(emulator.port, flush=True)
        until = float("inf") if seconds is None else seconds
        emulator.serve(until, sys.stdin.fileno() if orders else None, _say)
    finally:
        emulator.close()
        signal.signal(signal.SIGTERM, before)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _model(name: str) -> "Model":
    from outrider.errors import InputError
    from outrider.rplidar.models import MODELS

    if name.upper() not in MODELS:
        raise InputError(f"no model {name!r}: want {', '.join(MODELS)}")
    return MODELS[name.upper()]


def _scans(source: str, model: "Model", mode: "Mode") -> "Callable[[], Iterable[LaserScan]]":
    """Scans of a scenario as this very lidar sees it, or those of a recording."""
    from outrider import simulate
    from outrider.datasets import open_any
    from outrider.io import choose_topics

    if source in simulate.names() or source.endswith(".toml"):
        made = _simulated(simulate.load(source), model, mode)
        return lambda: made
    recording = open_any(source)[0]
    topic = choose_topics(recording).scan
    return lambda: _only_scans(recording.messages([topic]))


def _simulated(world: Any, model: "Model", mode: "Mode") -> "list[LaserScan]":
    import msgspec

    from outrider import simulate

    samples = round(1e6 / mode.sample_us / RATE_HZ)
    sensor = msgspec.structs.replace(
        world.sensor,
        rate_hz=RATE_HZ,
        step_deg=360.0 / samples,
        range_min_m=model.range_min,
        range_max_m=mode.range_max,
        clockwise=True,
    )
    messages = simulate.record(msgspec.structs.replace(world, sensor=sensor))
    made = []
    with show.progress(round(world.duration_s * RATE_HZ), "simulating") as watch:
        for scan in _only_scans(messages):
            made.append(scan)
            watch(scan)
    return made


def _only_scans(messages: Iterable[Any]) -> "Iterable[LaserScan]":
    from outrider.records import LaserScan

    return (message for message in messages if isinstance(message, LaserScan))
