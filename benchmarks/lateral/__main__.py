"""python -m benchmarks.lateral: judge, and write the tables and pictures of docs/lateral-validation.md."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks import markdown
from benchmarks.lateral import pictures, report, table

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "benchmarks" / "results" / "lateral.json"


def main() -> None:
    """Parse, run, write. OUTRIDER_DATA names the folder of the recordings, for the Hungaroring."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lateral", description=__doc__)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--write", action="store_true", help="only the tables, from what was kept")
    given = parser.parse_args()
    if not given.write:
        table.run(given.results)
    if given.results == RESULTS:
        page = ROOT / "docs" / "lateral-validation.md"
        markdown.write(page, table.read(given.results), report.BLOCKS)
        if not given.write:
            pictures.save(ROOT / "docs" / "figures")


if __name__ == "__main__":
    main()
