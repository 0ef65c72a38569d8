"""`outrider evaluate`: a run folder against the truth."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from outrider.cli import show
from outrider.errors import InputError


def evaluate(
    run: Path,
    /,
    *,
    truth: str | None = None,
    offset: str | None = None,
    gate: float | None = None,
    skip: float = 1.0,
    until: float | None = None,
    lagged: Annotated[bool, Parameter(negative=())] = False,
    json: show.Json = False,
) -> None:
    """Score a run against true poses: errors, breaks, switches, GOSPA, warning lead.

    Parameters
    ----------
    run
        Folder that `outrider track -o` wrote.
    truth
        Recording with the true poses; else the one the run was made from.
    offset
        x,y of the body's centre in the frame whose pose was measured, in metres.
    gate
        How near a track must be to count as the body's, in metres.
    skip
        Seconds after the first scan that do not count.
    until
        Seconds after the first scan from which nothing counts.
    lagged
        Score what was known some scans later instead, where the observer looked back (NAME+lagN).
    """
    from outrider.evaluate import evaluate as score

    result = score(run, truth, _pair(offset), gate, skip, until, lagged)
    if json:
        show.json(result.to_dict())
    else:
        print(result.table())


def _pair(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"--offset {text!r}: want two numbers x,y in metres, such as 0.05,-0.02") from error
    return x, y
