"""`outrider track`: a recording into a run folder."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from outrider.cli import show

if TYPE_CHECKING:
    from outrider.io.run import Run


def track(
    recording: str,
    /,
    *,
    output: Annotated[Path, Parameter(["--output", "-o"])],
    settings: Path | None = None,
    set_: Annotated[list[str] | None, Parameter("--set", negative=())] = None,
    scale: float | None = None,
    observer: str | None = None,
    gains: Path | None = None,
    scan_topic: str | None = None,
    ego_topic: str | None = None,
    truth_topic: Annotated[list[str] | None, Parameter(negative=())] = None,
    pictures: bool = True,
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Track a recording and write a run folder: tracks, alerts, pictures, settings.

    Parameters
    ----------
    recording
        Path of a recording, or dataset:NAME (see `outrider ls datasets`).
    output
        Folder for the results; must be new or empty, or use --force.
    settings
        TOML file with settings; what it does not state keeps its default.
    set_
        One setting as section.key=value, over the file; may be repeated.
    scale
        Full-size length / length in the recording (recording.scale).
    observer
        Name of the observer (observer.name; see `outrider ls observers`).
    gains
        File of `outrider design`: its observer with its gains, once their proof is checked.
    scan_topic
        Topic of the laser scans, where there are several.
    ego_topic
        Topic of the rider's pose; "none": the sensor stands.
    truth_topic
        Topic of a true pose, for the pictures; may be repeated; "none": ignore.
    pictures
        Draw scene.png and tracks.png.
    """
    from outrider import offline
    from outrider.cli.warm import compiling_beside

    named = {
        "recording.scale": scale,
        "observer.name": observer,
        "recording.scan_topic": scan_topic,
        "recording.ego_topic": ego_topic,
        "recording.truth_topics": truth_topic,
    }
    designed = _designed(gains, observer) if gains else []
    opened = offline.open_source(recording, settings, [*(set_ or []), *designed, *_assignments(named)])
    counts = {topic.name: topic.count for topic in opened.recording.topics}
    with (
        compiling_beside(opened.settings.observer.name),
        show.progress(counts.get(opened.chosen.scan), "tracking") as watch,
    ):
        run = offline.write(opened, output, force=force, pictures=pictures, watch=watch)
    if json:
        show.json({**run.summary, "folder": run.folder})
    else:
        show.table(_rows(run))


def _designed(path: Path, observer: str | None) -> list[str]:
    """The observer and gains of a file as `section.key=value`; NotCertified where they are not proven."""
    from outrider import proof_file
    from outrider.errors import InputError, NotCertified
    from outrider.observers import certificate_of

    file = proof_file.read(path)
    proof = certificate_of(file)
    if not proof.proven():
        raise NotCertified(f"{path}: {proof.failing()}; make it anew with outrider design")
    if observer not in (None, file.observer):
        raise InputError(f"{path} holds gains of {file.observer}; got --observer {observer}; leave one out")
    made = [f"observer.gains.{file.observer}.{name}={value!r}" for name, value in file.gains.items()]
    return [f'observer.name="{file.observer}"', *made]


def _assignments(named: dict[str, Any]) -> list[str]:
    """The options that were given, as `section.key=value` with a value of TOML."""
    import msgspec

    return [f"{k}={msgspec.json.encode(v).decode()}" for k, v in named.items() if v is not None]


def _rows(run: "Run") -> list[tuple[str, str]]:
    """What came out, in a few lines."""
    s = run.summary
    least, report, speed = s["least_ttc"], s["repairs"], s["speed"]
    at = {level: round(seconds, 1) for level, seconds in s["seconds_at_level"].items()}
    rows = [
        (
            "recording",
            f"{s['scans']} scans, {s['duration_s']:.1f} s" + (", cut off" if s["truncated"] else ""),
        ),
        ("topics", f"scan {s['topics']['scan']}, ego {s['topics']['ego'] or 'none: the sensor stands'}"),
        ("tracks", f"{s['tracks']}, of which {s['moving_tracks']} moved"),
        ("closest", _closest(least, s["t_first"])),
        ("alerts", show.listed(s["alerts"])),
        ("time at level", show.listed({f"s {level}": seconds for level, seconds in at.items()})),
        ("degraded", f"{s['degraded_scans']} scans"),
        *(
            [("bounds", f"did not hold {s['broken_bounds']} times")]
            if run.settings.envelope.position_m
            else []
        ),
        ("beams masked", show.listed(report["masked"])),
        ("scans skipped", show.listed(report["skipped"])),
        ("faults", show.listed(report["faults"])),
        *(("repaired", text) for text in report["repairs"]),
    ]
    if speed["median_ms"] is not None:
        each = f"{speed['median_ms']:.2f} ms a scan (median), {speed['p95_ms']:.2f} ms (95 %)"
        rows.append(("speed", f"{each}, {speed['scans_per_s']:.0f} scans/s in all"))
    return [*rows, ("written to", f"{run.folder}/")]


def _closest(least: dict[str, Any] | None, first: float) -> str:
    if least is None:
        return "no track on a path to the rider"
    when = f"{least['t'] - first:.1f} s after the start"
    return f"{least['ttc_s']:.2f} s to contact, track {least['track_id']}, {when}"
