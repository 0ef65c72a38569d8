"""The page of the reproduction: parts collected, written as Markdown, HTML and JSON, with the pictures."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from textwrap import fill
from typing import Any

import msgspec

from outrider import __version__
from outrider.errors import InputError
from outrider.extension import nearest
from outrider.io._folder import writing
from outrider.reproduce.html import document
from outrider.reproduce.section import Claim, Section, Table

PARTS = (
    "model",
    "gains",
    "cases",
    "behaviour",
    "convergence",
    "noise",
    "experiments",
)  # files, in the page's order
FILES = ("reproduce.md", "reproduce.html", "reproduce.json")
TITLE = "The papers' results beside ours"
INTRODUCTION = """
**[MS]** is H. Alai, R. Rajamani, *Multi-Stage Estimation Algorithm for Target Vehicle Trajectory Tracking
with Applications to E-Scooter Protection*, IEEE Transactions on Intelligent Vehicles, 2023. **[HG]** is H.
Alai, A. Zemouche, R. Rajamani, *Vehicle Trajectory Estimation Using a High-Gain Multi-Output Nonlinear
Observer*.
Printed numbers are theirs; all others are computed when this page is made, by `outrider reproduce`, version
{version}. A second run gives the same digits.
"""
CLAIMS = """
What the papers claim, in our words, and what became of it here. The verdicts are computed: each compares the
figure beside it with a limit in the code. {counts}.
"""


def chosen(only: str | None) -> tuple[str, ...]:
    """Names of parts from a list with commas, in the page's order; InputError for one that is not known."""
    names = [name.strip().lower() for name in only.split(",")] if only is not None else list(PARTS)
    for name in names:
        if name not in PARTS:
            raise InputError(f"part {name!r} is not known{nearest(name, PARTS)}")
    return tuple(name for name in PARTS if name in names)


def make(names: Iterable[str], watch: Callable[[str], None] | None = None) -> list[Section]:
    """The parts by name, computed one after the other; watch is called with the name of each that is done."""
    sections = []
    for name in names:
        sections.append(import_module(f"outrider.reproduce.{name}").section())
        if watch:
            watch(name)
    return sections


def claims(sections: Sequence[Section]) -> list[Claim]:
    """Claims of all parts, in the order of the page."""
    return [claim for section in sections for claim in section.claims]


def counts(found: Sequence[Claim]) -> dict[str, int]:
    """How many claims have each verdict."""
    counted = Counter(claim.verdict for claim in found)
    return {verdict: counted[verdict] for verdict in ("holds", "holds in part", "does not hold")}


def told(found: Sequence[Claim]) -> str:
    """The same as words."""
    hold, part, not_at_all = counts(found).values()
    return f"{hold} hold, {part} hold in part, {not_at_all} do not hold"


def claims_table(found: Sequence[Claim]) -> Table:
    """All claims as one table."""
    rows = tuple((c.source, c.text, c.verdict, c.figure) for c in found)
    return Table("Claims", ("where", "claim", "verdict", "our figure"), rows)


# ------------------------------------------------------------------ written


def save(sections: Sequence[Section], folder: Path) -> list[Path]:
    """Write page and pictures into a folder, and say which files; OutputError where it cannot."""
    from outrider.plots import write

    pictures = [picture for section in sections for picture in section.pictures]
    paths = [folder / f"{picture.name}.png" for picture in pictures]
    for picture, path in zip(pictures, paths, strict=True):
        write(picture.draw(), path)
    json = msgspec.json.format(msgspec.json.encode(to_dict(sections))) + b"\n"
    contents = (markdown(sections).encode(), document(TITLE, _parts(sections), folder).encode(), json)
    for name, content in zip(FILES, contents, strict=True):
        with writing(folder / name):
            (folder / name).write_bytes(content)
    return [*(folder / name for name in FILES), *paths]


def to_dict(sections: Sequence[Section]) -> dict[str, Any]:
    """Plain values by name; pictures by file name and caption."""
    return {
        "version": __version__,
        "verdicts": counts(claims(sections)),
        "sections": [
            {
                "name": s.name,
                "title": s.title,
                "text": s.text.strip(),
                "tables": [asdict(table) for table in s.tables],
                "pictures": [{"file": f"{p.name}.png", "caption": p.caption} for p in s.pictures],
                "claims": [asdict(claim) for claim in s.claims],
            }
            for s in sections
        ],
    }


def _parts(sections: Sequence[Section]) -> list[Section]:
    """Introduction, all parts, and the table of claims as a last one."""
    found = claims(sections)
    first = Section("introduction", "", INTRODUCTION.format(version=__version__))
    return [
        first,
        *sections,
        Section("claims", "Claims", CLAIMS.format(counts=told(found)), (claims_table(found),)),
    ]


def markdown(sections: Sequence[Section]) -> str:
    """The whole page; pictures as files beside it."""
    lines = [f"# {TITLE}", ""]
    for s in _parts(sections):
        lines += [f"## {s.title}", ""] if s.title else []
        lines += [_wrapped(s.text.strip()), ""]
        for table in s.tables:
            lines += [f"**{table.title}**", "", *_grid(table), ""]
        for picture in s.pictures:
            lines += [f"![{picture.caption}]({picture.name}.png)", "", f"*{picture.caption}*", ""]
    return "\n".join(lines).rstrip() + "\n"


def _wrapped(text: str) -> str:
    """Paragraphs in lines of like length; lists as they are."""
    blocks = re.split(r"\n\s*\n", text)
    return "\n\n".join(b if b.startswith("- ") else fill(" ".join(b.split()), 110) for b in blocks)


def _grid(table: Table) -> list[str]:
    rows = [table.head, ("---",) * len(table.head), *table.rows]
    return ["| " + " | ".join(cell.replace("|", "&#124;") for cell in row) + " |" for row in rows]
