"""Make a recording with known truth, track it, and see how far off the tracks are.

python examples/simulate_and_evaluate.py overtaking out/
"""

import sys
from pathlib import Path

import outrider
from outrider import io, simulate
from outrider.evaluate import evaluate


def main(scenario: str, folder: str) -> None:
    """The recording, the run folder and the table of errors of one scenario."""
    recording = Path(folder) / f"{scenario}.mcap"
    recording.parent.mkdir(parents=True, exist_ok=True)
    io.write_recording(recording, simulate.record(simulate.load(scenario)), force=True)
    outrider.run(recording, Path(folder) / scenario)
    print(evaluate(Path(folder) / scenario).table())


if __name__ == "__main__":
    main(*sys.argv[1:])
