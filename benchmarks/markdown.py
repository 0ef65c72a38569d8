"""Tables of a page that are made anew from figures that were kept."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

Blocks = Mapping[str, Callable[[Any], str]]


def filled(page: str, kept: Any, blocks: Blocks) -> str:
    """The page with every block `<!-- table NAME -->` ... `<!-- end -->` made anew."""

    def made(match: re.Match[str]) -> str:
        return f"<!-- table {match[1]} -->\n\n{blocks[match[1]](kept)}\n\n<!-- end -->"

    return re.sub(r"<!-- table (\S+) -->.*?<!-- end -->", made, page, flags=re.DOTALL)


def write(path: Path, kept: Any, blocks: Blocks) -> None:
    """The same in its file."""
    path.write_text(filled(path.read_text(), kept, blocks))


def names(page: str) -> set[str]:
    """Names of the blocks of a page."""
    return set(re.findall(r"<!-- table (\S+) -->", page))


def grid(head: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    every = [head, ["---"] * len(head), *lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in every)
