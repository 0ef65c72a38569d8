"""Which motion finds a robot soonest? Each from anywhere in a room, with cheap sensors and poor odometry.

python examples/relocalise.py asymmetric 5
"""

import sys

import numpy as np

from outrider.relocalise import motions, run, simulate
from outrider.relocalise import room as rooms


def main(name: str, seed: str) -> None:
    """Time until one pose is left (or its twins), error after that, and how well the pose was seen."""
    room = rooms.load(name)._replace(sigma=0.03)
    print(f"{'motion':18} {'found after':>11} {'error':>9} {'observability':>14}")
    for motion in motions.MOTIONS:
        log = simulate.simulate(room, motions.get(motion, int(seed)), seconds=12.0, seed=int(seed))
        made = run.run(log, room)
        told = made.summary()
        found, seen = told["first_known_s"], told["observability"]["median"]
        error = "-" if found is None else f"{median(made.errors()[log.t > found + 5.0, 0]):.3f} m"
        print(f"{motion:18} {'never' if found is None else f'{found:.1f} s':>11} {error:>9} {seen:14.2f}")


def median(errors: np.ndarray) -> float:
    """Of the errors that are known; not a number if none is."""
    known = errors[np.isfinite(errors)]
    return float(np.median(known)) if len(known) else float("nan")


if __name__ == "__main__":
    main(*sys.argv[1:])
