"""python -m benchmarks.relocalise_real: run, keep, write tables and picture of docs/relocalise-real.md."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

from benchmarks.relocalise_real import pictures, report, study

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / "benchmarks" / "results" / "relocalise-real.json"


def main() -> None:
    """Parse, run, write. OUTRIDER_DATA names the folder of the recordings."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.relocalise_real", description=__doc__)
    parser.add_argument("--write", action="store_true", help="only the tables, from what was kept")
    if not parser.parse_args().write:
        data = Path(os.environ["OUTRIDER_DATA"])
        KEPT.write_text(json.dumps(study.everything(data), indent=1) + "\n")
        pictures.save(data, ROOT / "docs" / "figures" / "relocalise-real.png")
    report.write(json.loads(KEPT.read_text()), ROOT / "docs" / "relocalise-real.md")


if __name__ == "__main__":
    main()
