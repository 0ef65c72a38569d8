"""Ask a run folder questions with pandas: how fast was each vehicle, and how near did it come?

python examples/results_in_pandas.py run/
"""

import sys
from pathlib import Path

import pandas as pd


def main(folder: str) -> None:
    """One line for each track that moved: how long it was seen, its speed, its size."""
    tracks = pd.read_parquet(Path(folder) / "tracks.parquet")
    moving = tracks[tracks["state"] == "confirmed"]
    table = moving.groupby("track_id").agg(
        seen_s=("t", lambda t: t.max() - t.min()),
        mean_speed=("speed", "mean"),
        top_speed=("speed", "max"),
        length=("length", "last"),
        width=("width", "last"),
    )
    print(table.round(2).to_string())


if __name__ == "__main__":
    main(*sys.argv[1:])
