"""Estimators with a saturating tyre: the tyre, the step along its tangent, and what they know of the road."""

from math import inf, nan

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from outrider import lateral
from outrider.cars import Car, load
from outrider.errors import InputError
from outrider.lateral import Sample
from outrider.lateral.course import winding
from outrider.lateral.estimators import _tyre, friction_bank, tyre
from outrider.lateral.plant import simulate

pytestmark = pytest.mark.once

CAR = load("b_class")
VX = 18.0


def driven(car: Car, friction: float, seconds: float = 20.0, size: float = 0.06, vx: float = VX):
    """Samples (n, 5) and true vy (n,) of the filters' own model on a weave, by scipy."""
    most = _tyre.limits(car, friction)

    def steer(t):
        return size * np.sin(0.9 * t) * np.minimum(t, 1.0)

    def rates(t, x):
        f = _tyre.forces(x[0], x[1], float(steer(t)), vx, car, most)
        return [
            (f.front + f.rear) / car.mass - vx * x[1],
            (car.front * f.front - car.rear * f.rear) / car.inertia,
        ]

    t = np.arange(0.0, seconds, 0.01)
    vy, r = solve_ivp(rates, (0.0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-10, max_step=0.02).y
    both = [_tyre.forces(a, b, float(steer(s)), vx, car, most) for a, b, s in zip(vy, r, t, strict=True)]
    ay = np.array([(f.front + f.rear) / car.mass for f in both])
    return np.column_stack([np.full(len(t), 0.01), np.full(len(t), vx), r, ay, steer(t)]), vy


def rmse(name: str, samples, vy, car: Car = CAR, **gains: float) -> float:
    estimator = lateral.get(name)
    track = lateral.estimate(estimator, samples, car, lateral.gains_from(estimator, gains))
    return float(np.sqrt(np.mean((track.estimate[:, 0] - vy) ** 2)))


def test_the_tyre_starts_with_its_stiffness_and_ends_near_its_limit():
    force, slope = _tyre.axle(0.0, 1e5, 5e3)
    assert force == 0.0
    assert slope == pytest.approx(1e5)
    sliding, rest = _tyre.axle(0.5, 1e5, 5e3)
    assert sliding == pytest.approx(5e3 + _tyre.RESIDUAL * 1e5 * 0.5)
    assert rest == pytest.approx(_tyre.RESIDUAL * 1e5, rel=1e-3)
    for slip in np.linspace(-0.2, 0.2, 21):
        ahead, behind = _tyre.axle(slip + 1e-6, 1e5, 5e3)[0], _tyre.axle(slip - 1e-6, 1e5, 5e3)[0]
        assert (ahead - behind) / 2e-6 == pytest.approx(_tyre.axle(slip, 1e5, 5e3)[1], rel=1e-5)
        assert _tyre.axle(-slip, 1e5, 5e3)[0] == pytest.approx(-_tyre.axle(slip, 1e5, 5e3)[0])


def test_limits_share_the_weight_of_the_car():
    most = _tyre.limits(CAR, 0.5)
    assert most.front + most.rear == pytest.approx(0.5 * CAR.mass * _tyre.G)
    assert most.front / most.rear == pytest.approx(CAR.rear / CAR.front)
    assert _tyre.limits(CAR._replace(rear_grip=1.2), 0.5).rear == pytest.approx(1.2 * most.rear)


def test_a_step_along_the_tangent_is_of_second_order():
    """Halving the step cuts the error of a saturating slide to a quarter."""
    most = _tyre.limits(CAR, 0.5)

    def slid(steps: int) -> float:
        x = [0.6, 0.3]
        for _ in range(steps):
            f = _tyre.forces(x[0], x[1], 0.08, VX, CAR, most)
            n = _tyre.carried(
                _tyre.tangent(f, VX, CAR),
                (f.front + f.rear) / CAR.mass - VX * x[1],
                (CAR.front * f.front - CAR.rear * f.rear) / CAR.inertia,
                0.4 / steps,
            )
            x = [x[0] + n.b1, x[1] + n.b2]
        return x[0]

    exact = slid(4096)
    coarse, fine = abs(slid(16) - exact), abs(slid(32) - exact)
    assert 3.0 < coarse / fine < 5.5


@pytest.mark.parametrize(("name", "share"), [("tyre", 0.03), ("friction_bank", 0.12)])
def test_its_own_model_without_noise_is_followed(name, share):
    """A weave of 8 m/s2, well into saturation; the bank has to find its road first, time and again."""
    samples, vy = driven(CAR, 1.0)
    assert np.abs(samples[:, 3]).max() > 7.0
    assert rmse(name, samples, vy) < share * np.sqrt(np.mean(vy**2))


def test_a_wrong_start_is_forgotten():
    samples, vy = driven(CAR, 1.0)
    design = tyre.prepare(CAR, tyre.Gains(), 0.01)
    state = tyre.start(Sample(*samples[0]), CAR, design)._replace(vy=1.5)
    for row in samples[1:200]:
        state = tyre.step(state, Sample(*row), CAR, design)
    assert abs(state.vy - vy[199]) < 0.05


def test_on_ice_the_right_friction_is_far_better_and_the_bank_finds_it():
    samples, vy = driven(CAR, 0.4, size=0.05)
    size = np.sqrt(np.mean(vy**2))
    right, wrong = rmse("tyre", samples, vy, friction=0.4), rmse("tyre", samples, vy)
    assert right < 0.1 * wrong
    assert rmse("friction_bank", samples, vy) < 0.2 * size
    design = friction_bank.prepare(CAR, friction_bank.Gains(), 0.01)
    state = friction_bank.start(Sample(*samples[0]), CAR, design)
    for row in samples[1:]:
        state = friction_bank.step(state, Sample(*row), CAR, design)
    weights = [getattr(state, f"log_weight_{i}") for i in range(len(friction_bank.FRICTIONS))]
    assert friction_bank.FRICTIONS[int(np.argmax(weights))] == 0.4


def test_straight_on_all_roads_are_alike():
    """Without slip nothing tells the friction: the weights stay equal and finite."""
    design = friction_bank.prepare(CAR, friction_bank.Gains(), 0.01)
    sample = Sample(0.01, VX, 0.0, 0.0, 0.0)
    state = friction_bank.start(sample, CAR, design)
    for _ in range(3000):
        state = friction_bank.step(state, sample, CAR, design)
    weights = [getattr(state, f"log_weight_{i}") for i in range(len(friction_bank.FRICTIONS))]
    assert max(weights) - min(weights) < 1e-9
    assert friction_bank.output(state, sample, CAR, design).vy == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("name", ["tyre", "friction_bank"])
def test_a_ramp_of_steering_gives_no_bias(name):
    """Inputs are the mean of both ends of a step: ten times coarser samples say the same."""
    samples, vy = driven(CAR, 1.0, size=0.03)
    coarse = samples[::10].copy()
    coarse[:, 0] = 0.1
    estimator = lateral.get(name)
    track = lateral.estimate(estimator, coarse, CAR)
    assert abs(np.mean(track.estimate[:, 0] - vy[::10])) < 0.01
    assert np.abs(track.estimate[:, 0] - vy[::10]).max() < 0.12


@pytest.mark.parametrize("name", ["tyre", "friction_bank"])
def test_a_spoilt_sensor_never_ends_it(name):
    """Absurd but finite readings, then sound ones: finite at all times, and right again at the end."""
    samples, vy = driven(CAR, 1.0)
    samples[300:400, 3] = 1e6
    samples[400:450, 2] = -1e6
    samples[450:470, 4] = 1e6
    samples[600:900, 3] = nan
    estimator = lateral.get(name)
    track = lateral.estimate(estimator, samples, CAR)
    assert np.isfinite(track.estimate).all()
    assert np.abs(track.estimate[-500:, 0] - vy[-500:]).max() < 0.1


def test_on_a_plant_of_other_tyres_each_beats_no_estimate():
    """The magic formula with load transfer, sensors as they are; friction 1, and an unknown 0.5."""
    for friction, share in ((1.0, 0.4), (0.5, 0.6)):
        log = simulate(winding(8, 1500.0), CAR, friction, "mems", seed=3)
        size = float(np.sqrt(np.mean(log.vy**2)))
        for name in ("tyre", "friction_bank"):
            assert rmse(name, log.samples(CAR), log.vy) < share * size, (name, friction)


def test_more_friction_than_any_road_is_the_linear_car():
    """Then stiffness is all that counts, and grip nothing."""
    samples, _ = driven(CAR, 1.0, size=0.02)
    one = lateral.estimate(tyre, samples, CAR, tyre.Gains(friction=1e6)).estimate
    other = lateral.estimate(tyre, samples, CAR._replace(front_grip=3.0), tyre.Gains(friction=1e6)).estimate
    np.testing.assert_allclose(one, other, atol=1e-9)


@pytest.mark.parametrize("value", [0.0, -1.0, inf])
def test_gains_that_cannot_be(value):
    with pytest.raises(InputError, match="friction"):
        tyre.prepare(CAR, tyre.Gains(friction=value), 0.01)
    with pytest.raises(InputError, match="memory"):
        friction_bank.prepare(CAR, friction_bank.Gains(memory=value), 0.01)
