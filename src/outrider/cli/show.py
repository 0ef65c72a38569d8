"""How results are shown: JSON or plain tables on stdout, progress on stderr where that is a terminal."""

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any

from cyclopts import Parameter

WIDE = 140  # columns where stdout is no terminal

Json = Annotated[bool, Parameter("--json", negative=(), help="Print JSON, for scripts.")]
Force = Annotated[bool, Parameter("--force", negative=(), help="Replace what is there.")]


def json(value: Any) -> None:
    """A value as JSON on stdout; not a number and infinite are null."""
    import msgspec

    text = msgspec.json.encode(value, enc_hook=lambda v: v.tolist() if hasattr(v, "tolist") else str(v))
    print(msgspec.json.format(text).decode())


def table(
    rows: Sequence[Sequence[object]], head: Sequence[str] = (), title: str = "", named: bool = False
) -> None:
    """Rows in columns; None is shown as a dash. named: the first column is a name, never broken."""
    from rich.console import Console
    from rich.table import Table

    grid = Table(title=title or None, title_justify="left", box=None, show_header=bool(head), pad_edge=False)
    for i, name in enumerate(head or [""] * max(map(len, rows), default=0)):
        grid.add_column(name, overflow="fold", no_wrap=named and i == 0)
    for row in rows:
        grid.add_row(*("-" if cell is None else str(cell) for cell in row))
    wide = None if sys.stdout.isatty() or "COLUMNS" in os.environ else WIDE
    console = Console(width=wide, highlight=False, markup=False)
    with console.capture() as shown:
        console.print(grid)
    for line in shown.get().splitlines():
        print(line.rstrip())


@contextmanager
def progress(total: int | None, what: str, unit: str = "scans") -> Iterator[Callable[[Any], None]]:
    """A function to call with every frame; rate and remaining time on stderr where that is a terminal."""
    if not sys.stderr.isatty():
        yield lambda done: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total, rate="")

        def advance(done: Any) -> None:
            speed = bar.tasks[task].speed
            bar.update(task, advance=1, rate=f"{speed:.1f} {unit}/s" if speed else "")

        yield advance


def listed(counts: dict[str, Any]) -> str:
    """Counts by name as words: "3 caution, 1 danger"; "none" where all are zero."""
    return ", ".join(f"{n} {name}" for name, n in counts.items() if n) or "none"
