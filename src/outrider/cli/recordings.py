"""`outrider info`, `convert` and `simulate`: recordings looked at, changed in format, made."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from outrider.cli import show

if TYPE_CHECKING:
    from outrider.io import Info, Recording, ScanInfo


def info(recording: str, /, *, json: show.Json = False) -> None:
    """Show what a recording holds, what would be used, and what would be repaired.

    Parameters
    ----------
    recording
        Path of a recording, or dataset:NAME.
    """
    from outrider.datasets import open_any
    from outrider.io import describe

    opened = open_any(recording)[0]
    found = describe(opened)
    repairs = _repairs(recording, opened)
    if json:
        import msgspec

        show.json({**msgspec.to_builtins(found), "repairs": repairs})
        return
    _show(found, repairs)


def _repairs(name: str, recording: "Recording") -> list[str]:
    """What the first scan's header gets wrong, in words."""
    from outrider.errors import InputError
    from outrider.offline import open_source

    try:
        opened = open_source(name)
        next(iter(opened.stream), None)
    except InputError:  # what is wrong with the recording is told already
        return []
    return opened.stream.report.repairs


def _show(found: "Info", repairs: list[str]) -> None:
    cut = ", cut off" if found.truncated else ""
    print(f"{found.path}: {found.format}, {found.duration_s:.1f} s{cut}")
    if found.problem:
        print(f"problem: {found.problem}")
    rows = [
        (t.name, t.role, t.count, _number(t.rate_hz, ".2f", " Hz"), _number(t.delay_s, ".3f", " s"), t.type)
        for t in found.topics
    ]
    show.table(rows, ("topic", "used as", "messages", "rate", "delay", "type"))
    for topic in found.topics:
        if topic.scan:
            print()
            show.table(_scan_rows(topic.scan), title=topic.name)
    for text in repairs:
        print(f"would be repaired: {text}")


def _scan_rows(scan: "ScanInfo") -> list[tuple[str, str | None]]:
    invalid = {f"% {reason}": round(100.0 * share, 2) for reason, share in scan.invalid.items()}
    return [
        ("beams", _pair(scan.beams, "d", "")),
        ("angles", f"{_pair(scan.angle_min_rad)} to {_pair(scan.angle_max_rad, unit=' rad')}"),
        ("angle_increment", _pair(scan.angle_increment_rad, ".5g", " rad")),
        ("range limits", f"{_pair(scan.range_min_m)} to {_pair(scan.range_max_m, unit=' m')}"),
        ("header time_increment", _pair(scan.header_time_increment_s, ".4g", " s")),
        ("header scan_time", _pair(scan.header_scan_time_s, ".4g", " s")),
        ("measured period", _number(scan.period_s, ".4f", " s")),
        ("longest gap", _number(scan.longest_gap_s, ".3f", " s")),
        ("stamps not rising", str(scan.backward_stamps)),
        ("intensities", "yes" if scan.has_intensities else "no"),
        ("invalid beams", show.listed(invalid)),
    ]


def _pair(pair: tuple[Any, Any], form: str = ".4g", unit: str = "") -> str:
    low, high = (format(value, form) for value in pair)
    return f"{low}{unit}" if low == high else f"{low}...{high}{unit}"


def _number(value: float | None, form: str, unit: str) -> str | None:
    return None if value is None else f"{value:{form}}{unit}"


def convert(
    source: str,
    target: Path,
    /,
    *,
    format: str = "",
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Copy a recording into another format; the suffix of the target picks it.

    Parameters
    ----------
    source
        Path of a recording, or dataset:NAME.
    target
        Path of the copy.
    format
        Name of the format where the suffix does not tell (see `outrider ls formats`).
    """
    from outrider import io
    from outrider.datasets import open_any

    count = io.convert(open_any(source)[0], target, force, format=format)
    _made(target, count, json)


def simulate(
    scenario: str,
    /,
    *,
    output: Annotated[Path, Parameter(["--output", "-o"])],
    seed: int | None = None,
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Make a recording of a scenario, with the truth in it.

    Parameters
    ----------
    scenario
        Name (see `outrider ls scenarios`) or path of a TOML file.
    output
        Path of the recording; the suffix picks the format.
    seed
        Of the sensor's noise; the same seed gives the same bytes.
    """
    from outrider import io
    from outrider import simulate as sim

    count = io.write_recording(output, sim.record(sim.load(scenario), seed), force)
    _made(output, count, json)


def _made(target: Path, count: int, json: bool) -> None:
    if json:
        show.json({"path": target, "messages": count})
    else:
        print(f"{target}: {count} messages")
