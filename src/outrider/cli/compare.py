"""`outrider compare`: observers side by side on recordings with truth."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from outrider.cli import show


def compare(
    recordings: Annotated[list[str], Parameter(negative=())],
    /,
    *,
    observers: str = "all",
    settings: Path | None = None,
    set_: Annotated[list[str] | None, Parameter("--set", negative=())] = None,
    truth: str | None = None,
    skip: float = 1.0,
    output: Annotated[Path | None, Parameter(["--output", "-o"])] = None,
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Give the same measurements to several observers and compare them with the truth.

    Parameters
    ----------
    recordings
        Paths of recordings, or dataset:NAME (see `outrider ls datasets`).
    observers
        NAME, NAME:GAINS or NAME+lagN, separated by commas; all: every one there is.
    settings
        TOML file with settings; what it does not state keeps its default.
    set_
        One setting as section.key=value, over the file; may be repeated.
    truth
        Recording with the true poses; else each recording itself.
    skip
        Seconds after the beginning of each body's series that do not count.
    output
        Folder for tables and pictures; must be new or empty, or use --force.
    """
    from outrider import comparison, measured, offline
    from outrider import observers as known
    from outrider.io._folder import prepare

    known.variants(observers)  # its message before the work, where something is wrong
    if output:
        prepare(output, force)
    found = []
    for name in recordings:
        opened = offline.open_source(name, settings, set_ or [])
        counts = {topic.name: topic.count for topic in opened.recording.topics}
        with show.progress(counts.get(opened.chosen.scan), f"tracking {Path(name).name}") as watch:
            found.append(measured.collect(opened, truth, watch=watch))
    labels = comparison.labels_of(found, observers)
    with show.progress(len(labels), "comparing", "observers") as watch:
        result = comparison.compare(found, observers, skip, watch)
    if output:
        from outrider import plots_compare

        comparison.save(result, output)
        plots_compare.save(result, output)
    if json:
        show.json(result.to_dict())
        return
    head = [name.replace(" [", "\n[") for name in comparison.head()]
    for name, rows in result.tables():
        show.table(comparison.cells(rows), head, name, named=True)
        print()
    for m in found:
        if m.left_out:
            bodies = ", ".join(m.left_out)
            print(f"left out of {comparison.name_of(m)}, never seen in two scans in a row: {bodies}")
    print(f"{comparison.MARK} best of its column; rows with a lag among themselves")
    if output:
        print(f"written to {output}/")
