"""python -m benchmarks.relocalise: judge, and write tables and pictures of docs/relocalise-comparison.md."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks import markdown
from benchmarks.relocalise import pictures, report, table

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "benchmarks" / "results" / "relocalise.json"


def main() -> None:
    """Parse, run, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.relocalise", description=__doc__)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--write", action="store_true", help="only the page, from what was kept")
    parser.add_argument("--part", action="append", choices=list(table.PARTS), help="judge only this")
    given = parser.parse_args()
    if not given.write:
        table.run(given.results, given.part or list(table.PARTS))
    if given.results == RESULTS:
        kept = table.read(given.results)
        markdown.write(ROOT / "docs" / "relocalise-comparison.md", kept, report.BLOCKS)
        pictures.save(kept, ROOT / "docs" / "figures")


if __name__ == "__main__":
    main()
