"""Give the same measurements to several observers and see which one is best at what.

python examples/compare_observers.py turning multi_stage,constant_velocity
"""

import sys

from outrider import comparison, measured, simulate
from outrider.records import Pose


def main(scenario: str, observers: str = "all") -> None:
    """The table of a simulated scenario, and the best observer by J: velocity, and five times yaw."""
    messages = list(simulate.record(simulate.load(scenario)))
    truth = [m for m in messages if isinstance(m, Pose) and m.topic.startswith("/truth/")]
    seen = measured.measure(messages, truth=truth)
    result = comparison.compare([seen], observers)
    print(comparison.markdown(result))
    best = min(result.pooled, key=lambda row: row.figures.J)
    print(f"best by J: {best.label}, {best.figures.velocity_mps:.2f} m/s")


if __name__ == "__main__":
    main(*sys.argv[1:])
