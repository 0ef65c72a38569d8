"""python -m benchmarks.accuracy: tune, judge, and write the tables and pictures of docs/comparison.md."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks import markdown
from benchmarks.accuracy import methods, pictures, report, table, tune

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "benchmarks" / "results" / "accuracy.json"


def main() -> None:
    """Parse, run, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy", description=__doc__)
    parser.add_argument("--only", help="observers and peers, with commas; others stay as they were")
    parser.add_argument("--on", help=f"with commas, of: {', '.join([*table.TASKS, 'fixed'])}")
    parser.add_argument("--evaluations", type=int, default=table.BUDGET, help="of each search")
    parser.add_argument("--seed", type=int, default=tune.SEED)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument(
        "--draw", action="store_true", help="only the tables and pictures, from what was kept"
    )
    given = parser.parse_args()
    names = given.only.split(",") if given.only else methods.names()
    tasks = given.on.split(",") if given.on else [*table.TASKS, "fixed"]
    if not given.draw:
        table.run(names, tasks, given.results, given.workers, given.evaluations, given.seed)
    rows = table.read(given.results)
    if given.results == RESULTS:
        markdown.write(ROOT / "docs" / "comparison.md", rows, report.BLOCKS)
        pictures.save(rows, ROOT / "docs" / "figures")


if __name__ == "__main__":
    main()
