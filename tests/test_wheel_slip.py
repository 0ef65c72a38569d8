"""A driven wheel that spins: the speed in the log is too high for a second, in the hardest turn."""

import numpy as np
import pytest

from outrider import cars, lateral
from outrider.lateral import course, plant

B = cars.load("b_class")
SPIN = 0.2  # share by which the wheel is faster than the car [-]


@pytest.fixture(scope="module")
def drive() -> tuple[np.ndarray, slice]:
    """Samples of a drive, and the second of it with the largest lateral acceleration."""
    samples = plant.simulate(course.winding(2), B, 1.0, "mems", 3).samples(B)
    middle = int(np.argmax(np.abs(np.convolve(samples[:-1000, 3], np.ones(100) / 100.0, "same"))))
    return samples, slice(middle - 50, middle + 50)


@pytest.mark.parametrize("name", lateral.names())
def test_the_error_is_that_of_the_kinematics_and_is_forgotten(
    name: str, drive: tuple[np.ndarray, slice]
) -> None:
    """At most the share of vx r that is wrong, gathered over the second; five seconds later none is left."""
    samples, spin = drive
    estimator, wrong = lateral.get(name), samples.copy()
    wrong[spin, 1] *= 1.0 + SPIN
    clean, spun = (lateral.estimate(estimator, s, B).estimate[:, 0] for s in (samples, wrong))
    off = np.abs(spun - clean)
    most = SPIN * np.abs(samples[spin, 1] * samples[spin, 2]).max()  # of vy' [m/s2], for one second
    assert off[: spin.start].max() == 0.0
    assert off.max() < 1.2 * most
    if name != "integration":  # which forgets nothing
        assert off[spin.stop + 500 :].max() < 0.02


@pytest.mark.parametrize("name", lateral.names())
def test_masked_rows_are_coasted_over_and_marked(name: str, drive: tuple[np.ndarray, slice]) -> None:
    samples, spin = drive
    estimator, masked = lateral.get(name), samples.copy()
    gap = slice(spin.start, spin.start + 30)
    masked[gap, 1] = np.nan
    clean, held = lateral.estimate(estimator, samples, B), lateral.estimate(estimator, masked, B)
    assert held.held[gap].all()
    assert held.held.sum() == 30
    assert np.ptp(held.estimate[gap, 0]) == 0.0
    if name != "integration":
        assert np.abs(held.estimate - clean.estimate)[gap.stop + 500 :, 0].max() < 0.02
