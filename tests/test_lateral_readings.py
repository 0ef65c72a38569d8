"""The ultra-local part as printed, in the three ways it can be read, changes little with the printed gain."""

import numpy as np
import pytest

from outrider import cars, lateral
from outrider.lateral import course, plant, tune
from outrider.lateral.log import Log

pytestmark = pytest.mark.once

B, D = cars.load("b_class"), cars.load("d_class")
DRIVES = ((B, 1.0), (B, 0.5), (D, 1.0))


def rmse(estimator: str, log: Log, gains: dict[str, float] | None = None) -> float:
    """Of vy, the estimator told the B class [m/s]."""
    chosen = lateral.get(estimator)
    made = lateral.estimate(chosen, log.samples(B), B, lateral.gains_from(chosen, gains or {}))
    return float(np.sqrt(np.mean((made.estimate[:, 0] - log.vy)[~made.held] ** 2)))


def test_no_reading_changes_the_published_observer_much() -> None:
    """Without noise, tuned on one course, judged on another: the car, a slippery road, another car."""
    tuned_on = [plant.simulate(course.winding(1, length=1500.0), B, 1.0, "none", 1)]
    logs = [plant.simulate(course.winding(3, length=1500.0), car, mu, "none", 7) for car, mu in DRIVES]
    fixed = [rmse("lq", log) for log in logs]
    for reading in (1.0, 2.0, 3.0):
        made = tune.tune(tuned_on, B, "ultra_local_published", "speed", "grid", {"reading": reading})
        with_it = [rmse("ultra_local_published", log, dict(made.gains)) for log in logs]
        assert with_it == pytest.approx(fixed, rel=0.08), reading
    freed = tune.tune(tuned_on, B, "ultra_local", "speed", "grid", {"base": 0.0})
    combined = rmse("ultra_local", logs[0], dict(freed.gains))
    assert combined < 0.6 * fixed[0]  # without the gain on vy it does
