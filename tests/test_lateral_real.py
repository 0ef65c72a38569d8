"""A race car with measured lateral velocity: identified on half of a drive, judged on the other half."""

import numpy as np
import pytest

from outrider import lateral
from outrider.cars import Car, load
from outrider.lateral.identify import identify
from outrider.lateral.log import Log, read

# Mass, lengths and inertia as published with the data; stiffness as a place to begin.
CAR = Car(
    mass=982.0, inertia=1605.0, front=1.33, rear=1.07, front_stiffness=7e4, rear_stiffness=12e4, roll_gain=0.0
)


@pytest.fixture(scope="module")
def halves(data) -> tuple[Log, Log]:
    path = data / "revs_250lm" / "20140222_01_01_03_250lm_dev.parquet"
    if not path.exists():
        pytest.skip(f"{path.name} is not among the recordings")
    return read(path).halves()


def rmse(log: Log, car: Car, name: str) -> float:
    track = lateral.estimate(lateral.get(name), log.samples(car), car)
    assert not track.held.any()
    assert log.vy is not None
    return float(np.sqrt(np.mean((track.estimate[:, 0] - log.vy) ** 2)))


@pytest.mark.parametrize(("use_vy", "most"), [(True, 0.20), (False, 0.20)])
@pytest.mark.parametrize("begin", [CAR, load("b_class")], ids=["its lengths", "another car's lengths"])
def test_lateral_velocity_on_the_half_not_seen(halves, use_vy, most, begin):
    """vy itself is 0.74 m/s rms there; whatever the search begins with."""
    first, second = halves
    found = identify([first], begin, use_vy=use_vy)
    assert rmse(second, found.car, "tyre") < most
    assert rmse(first, found.car, "tyre") < most
    assert found.misfit < 0.3


def test_here_a_tyre_that_saturates_counts(halves):
    """Up to 1.1 g: half of what the linear filters leave is gone."""
    first, second = halves
    car = identify([first], CAR, use_vy=False).car
    assert rmse(second, car, "tyre") < 0.5 * rmse(second, car, "scheduled")
    assert rmse(second, car, "friction_bank") < 0.6 * rmse(second, car, "scheduled")


def test_both_ways_agree_on_the_car(halves):
    first, _ = halves
    seen, unseen = (identify([first], CAR, use_vy=use_vy).car for use_vy in (True, False))
    for name in ("front_stiffness", "rear_stiffness", "steering_gain", "front_grip", "rear_grip"):
        assert getattr(seen, name) == pytest.approx(getattr(unseen, name), rel=0.1), name
