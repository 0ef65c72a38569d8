"""What a part of the reproduction hands to the page: text, tables, pictures and claims with their verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Verdict = Literal["holds", "holds in part", "does not hold"]


@dataclass(frozen=True)
class Claim:
    """One statement of a paper and what became of it here."""

    source: str  # where the paper says it: "[MS] V.A"
    text: str  # what it says, in our own words
    verdict: Verdict
    figure: str  # our number, with its unit, and where it comes from


@dataclass(frozen=True)
class Table:
    """Cells as they are printed, in Markdown."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Picture:
    """A figure that is drawn only when the page is written."""

    name: str  # file stem: "cases-1"
    caption: str
    draw: Callable[[], Figure]


@dataclass(frozen=True)
class Section:
    """One part of the page."""

    name: str  # as on the command line: "gains"
    title: str
    text: str  # Markdown
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()
    claims: tuple[Claim, ...] = ()


def verdict(full: bool, part: bool = False) -> Verdict:
    """Word for a claim that holds in full, else in part, else not."""
    return "holds" if full else "holds in part" if part else "does not hold"
