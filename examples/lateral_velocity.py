"""How fast does a car slide sideways? Every estimator on a simulated drive, on a dry and on a slippery road.

python examples/lateral_velocity.py b_class 5
"""

import sys

import numpy as np

from outrider import cars, lateral
from outrider.lateral import course, plant


def main(name: str, seed: str) -> None:
    """RMS error of the lateral velocity by estimator and road, beside the RMS of what is estimated."""
    car = cars.load(name)
    way = course.winding(int(seed), length=2000.0)
    roads = {"dry": 1.0, "slippery": 0.5}
    drives = [plant.simulate(way, car, friction, "mems", seed=int(seed)) for friction in roads.values()]
    print(f"{'estimator':22}", *(f"{road:>10}" for road in roads))
    for estimator in lateral.names():
        chosen = lateral.get(estimator)
        errors = [rms(lateral.estimate(chosen, d.samples(car), car).estimate[:, 0] - d.vy) for d in drives]
        print(f"{estimator:22}", *(f"{error:10.3f}" for error in errors))
    print(f"{'lateral velocity':22}", *(f"{rms(drive.vy):10.3f}" for drive in drives), " m/s")


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    main(*sys.argv[1:])
