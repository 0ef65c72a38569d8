"""A car from logs: what was driven is found again, from lateral velocity or without it."""

from dataclasses import replace

import numpy as np
import pytest

from outrider.cars import Car, load, save
from outrider.errors import InputError
from outrider.lateral import identify as module
from outrider.lateral.course import winding
from outrider.lateral.identify import PRIOR, identify
from outrider.lateral.log import Log
from outrider.lateral.plant import NOISES, simulate

TRUE = load("b_class")._replace(steering_gain=0.06, steering_offset=0.01)
BEGIN = TRUE._replace(front_stiffness=70e3, rear_stiffness=180e3, steering_gain=1.0, steering_offset=0.0)


@pytest.fixture(scope="module")
def clean() -> Log:
    return simulate(winding(3, 2500.0), TRUE, 1.0, "none", seed=1)


@pytest.fixture(scope="module")
def noisy() -> Log:
    noise = NOISES["mems"]._replace(steering_bias=0.0)
    return simulate(winding(3, 2500.0), TRUE, 1.0, noise, seed=1)


def far(found: Car, name: str) -> float:
    """How far a value is from the true one, as a share of that."""
    return abs(getattr(found, name) / getattr(TRUE, name) - 1.0)


@pytest.mark.parametrize(("use_vy", "share"), [(True, 0.12), (False, 0.2)])
@pytest.mark.parametrize("sensors", ["clean", "noisy"])
def test_the_car_is_found_again(sensors, use_vy, share, request):
    """Not to the last digit: its tyres are the magic formula, with load transfer, not what is fitted."""
    log: Log = request.getfixturevalue(sensors)
    found = identify([log], BEGIN, use_vy=use_vy)
    for name in ("front_stiffness", "rear_stiffness"):
        assert far(found.car, name) < share, name
    for name in ("front_grip", "rear_grip"):
        assert far(found.car, name) < 0.15, name
    assert far(found.car, "steering_gain") < 0.05
    assert found.car.steering_offset == pytest.approx(TRUE.steering_offset, abs=1e-3)
    assert found.car[:4] == BEGIN[:4]
    assert found.misfit < 0.3
    assert found.seconds > 60.0
    assert 5.0 < found.most < 10.0


def test_without_vy_a_measured_one_makes_no_difference(noisy):
    wrong = replace(noisy, vy=noisy.vy + 3.0)
    assert identify([noisy], BEGIN, use_vy=False) == identify([wrong], BEGIN, use_vy=False)
    assert identify([replace(noisy, vy=None)], BEGIN) == identify([noisy], BEGIN, use_vy=False)


def test_vy_makes_the_car_better_known(noisy):
    seen, unseen = identify([noisy], BEGIN).spread, identify([noisy], BEGIN, use_vy=False).spread
    assert set(seen) == set(PRIOR)
    assert all(value > 0.0 for value in seen.values())
    assert seen["rear_stiffness"] < unseen["rear_stiffness"]


def test_the_beginning_hardly_matters(noisy):
    other = BEGIN._replace(front_stiffness=200e3, rear_stiffness=60e3, front_grip=0.7, rear_grip=1.3)
    one, two = (identify([noisy], car, use_vy=False).car for car in (BEGIN, other))
    for name in ("front_stiffness", "rear_stiffness", "steering_gain"):
        assert getattr(one, name) == pytest.approx(getattr(two, name), rel=0.04)


def test_twice_the_mass_is_twice_the_stiffness(noisy):
    """Lateral motion tells stiffness over mass and no more."""
    heavy = BEGIN._replace(
        mass=2 * BEGIN.mass,
        inertia=2 * BEGIN.inertia,
        front_stiffness=2 * BEGIN.front_stiffness,
        rear_stiffness=2 * BEGIN.rear_stiffness,
    )
    light, found = identify([noisy], BEGIN).car, identify([noisy], heavy).car
    assert found.front_stiffness == pytest.approx(2 * light.front_stiffness, rel=1e-6)
    assert found.rear_grip == pytest.approx(light.rear_grip, rel=1e-6)


def test_the_true_inertia_fits_best(clean):
    """It is not searched for, but r' would show a wrong one."""
    shares = (0.5, 1.0, 2.0)
    misfits = [identify([clean], BEGIN._replace(inertia=k * TRUE.inertia)).misfit for k in shares]
    assert misfits[1] < 0.98 * min(misfits[0], misfits[2])


def test_two_logs_with_holes_are_as_good_as_one(noisy):
    """Missing values, a gap and a doubled time are left out, and the rest is used."""
    middle = float(noisy.t[len(noisy.t) // 2])
    a, b = noisy.part(0.0, middle), noisy.part(middle + 2.0, np.inf)
    ay = a.ay.copy()
    ay[1000:1200] = np.nan
    t = b.t.copy()
    t[500] = t[499]
    whole = identify([noisy], BEGIN)
    parts = identify([replace(a, ay=ay), replace(b, t=t)], BEGIN)
    assert whole.seconds - 12.0 < parts.seconds < whole.seconds - 3.0
    for name in PRIOR:
        assert getattr(parts.car, name) == pytest.approx(getattr(whole.car, name), rel=0.08)


def test_a_rate_that_wavers_does_no_harm(noisy):
    keep = np.sort(np.random.default_rng(0).choice(len(noisy.t), len(noisy.t) // 2, replace=False))
    thin = Log(**{n: getattr(noisy, n)[keep] for n in ("t", "vx", "yaw_rate", "ay", "steering", "vy")})
    one, two = identify([noisy], BEGIN).car, identify([thin], BEGIN).car
    for name in ("front_stiffness", "rear_stiffness", "steering_gain"):
        assert getattr(one, name) == pytest.approx(getattr(two, name), rel=0.08)


def test_roll_is_found_on_request():
    rolling = TRUE._replace(roll_gain=0.016)
    log = simulate(winding(3, 2500.0), rolling, 1.0, "none", seed=1)
    for use_vy in (True, False):
        found = identify([log], BEGIN, use_vy=use_vy, roll=True).car
        assert found.roll_gain == pytest.approx(0.016, rel=0.1)
    assert identify([log], BEGIN).car.roll_gain == 0.0


def test_the_array_tyre_is_the_compiled_one():
    from outrider.lateral.estimators._tyre import axle

    slip = np.linspace(-0.3, 0.3, 13)
    np.testing.assert_allclose(module._axle(slip, 1e5, 4e3), [axle(s, 1e5, 4e3)[0] for s in slip], rtol=1e-13)


def test_what_was_found_is_a_car_file(noisy, tmp_path):
    found = identify([noisy], BEGIN).car
    save(found, tmp_path / "car.toml")
    assert load(tmp_path / "car.toml") == found


def test_too_little_driving_is_refused(noisy):
    with pytest.raises(InputError, match=r"driving above 5 m/s.*want 30 s"):
        identify([noisy.part(0.0, 20.0)], BEGIN)
    with pytest.raises(InputError, match="0 s of driving"):
        identify([replace(noisy, ay=np.full(len(noisy.t), np.nan))], BEGIN)
    straight = replace(noisy, ay=0.01 * noisy.ay, yaw_rate=0.01 * noisy.yaw_rate)
    with pytest.raises(InputError, match="corners"):
        identify([straight], BEGIN)
    with pytest.raises(InputError, match="0 s of driving"):
        identify([], BEGIN)


def test_steering_to_the_wrong_side_is_refused(noisy):
    with pytest.raises(InputError, match="positive to the left"):
        identify([replace(noisy, steering=-noisy.steering)], BEGIN)
