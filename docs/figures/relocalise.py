"""Pictures and figures of docs/relocalise.md: python docs/figures/relocalise.py, some minutes.

Prints when robots that were carried are missed and found again.
"""

import sys
from pathlib import Path

import numpy as np

from outrider import plots_relocalise
from outrider.plots import write
from outrider.relocalise import motions, room, run, simulate

HERE = Path(__file__).parent
CARRIED, DRIVES = 10.0, 12  # when [s], and how many in each room


def pictures() -> None:
    """The drive of the page, and the map of the ellipse."""
    egg = room.load("asymmetric")
    made = run.run(simulate.simulate(egg, seed=3, faults=simulate.Faults(kidnapped=(15.0,))), egg)
    write(plots_relocalise.scene(made), HERE / "relocalise-room.png")
    write(plots_relocalise.over_time(made), HERE / "relocalise-errors.png")
    plots_relocalise.save_map(room.load("ellipse"), 0.0, 0.5, HERE / "relocalise-map.png")


def carried(name: str, noise: float) -> None:
    """One line: how many were missed and found again, when [s] after being carried, and how many wrongly."""
    where, missed, found, wrong = room.load(name)._replace(sigma=noise), [], [], 0
    for seed in range(300, 300 + DRIVES):
        motion = motions.spin if seed % 2 else motions.constant
        faults = simulate.Faults(kidnapped=(CARRIED,))
        made = run.run(simulate.simulate(where, motion, 20.0, seed=seed, faults=faults), where)
        lost = [t for t, what in made.events if "lost" in what]
        wrong += sum(t < CARRIED for t in lost)
        missed += [t - CARRIED for t in lost if t >= CARRIED][:1]
        found += [t - CARRIED for t, what in made.events if t > CARRIED and what == "found"][:1]
    times = ", ".join(
        f"{word} {len(t)} {np.median(t):.1f} {max(t):.1f}"
        for word, t in (("missed", missed), ("found", found))
    )
    sys.stdout.write(f"{name:10} {noise:.2f} m: {times}, wrongly {wrong}\n")


if __name__ == "__main__":
    pictures()
    for name in ("ellipse", "asymmetric", "rectangle"):
        for noise in (0.01, 0.05):
            carried(name, noise)
