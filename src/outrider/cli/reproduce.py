"""`outrider reproduce`: the papers' results beside ours."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from outrider.cli import show


def reproduce(
    *,
    output: Annotated[Path, Parameter(["--output", "-o"])] = Path("reproduced"),
    only: str | None = None,
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Compute the papers' tables and figures anew and write them, beside the printed ones, as a page.

    Parameters
    ----------
    output
        Folder for the page and its pictures; must be new or empty, or use --force.
    only
        Parts, separated by commas: model, gains, cases, behaviour, convergence, noise, experiments.
    """
    from outrider.io._folder import prepare
    from outrider.reproduce import page

    names = page.chosen(only)
    prepare(output, force)
    with show.progress(len(names), "computing", "parts") as watch:
        sections = page.make(names, watch)
    page.save(sections, output)
    found = page.claims(sections)
    if json:
        show.json(page.to_dict(sections))
        return
    rows = [[c.source, c.text, c.verdict] for c in found]
    show.table(rows, ["where", "claim", "verdict"])
    print(f"\n{page.told(found)}; {output / page.FILES[0]} has the figures")
