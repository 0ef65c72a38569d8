"""The contract of lateral/estimators/, for every file in it; then what theory says of single ones."""

import inspect
import math
import re
from typing import Any, get_type_hints

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are, solve_discrete_are

from outrider import cars, lateral
from outrider.errors import InputError
from outrider.lateral import Estimate, Sample, course, plant
from outrider.lateral.estimators import (
    _linear,
    _scheduled_proof,
    integration,
    kalman,
    lq,
    scheduled,
)
from outrider.models.single_track import lateral_acceleration, linear, sampled

NAMES = lateral.names()
CAR = cars.load("b_class")
NAN = float("nan")
MODELS = [name for name in NAMES if name != "integration"]  # what a tyre pulls back from a drift
every_estimator = pytest.mark.parametrize("name", NAMES)
every_model = pytest.mark.parametrize("name", MODELS)


def drive(
    n: int = 1500,
    speed: float = 10.0,
    swing: float = 0.0,
    dt: Any = 0.01,
    seed: int = 0,
    angle: float = 0.015,
) -> tuple[np.ndarray, np.ndarray]:
    """Samples (n, 5) without noise of the linear single track, and its vy (n,); 20 exact substeps a sample.

    The speed swings by `swing`; steering sways by `angle` [rad]; dt: one step or (n,) of them.
    """
    rng = np.random.default_rng(seed)
    dt, phase = np.broadcast_to(np.asarray(dt, float), n), rng.uniform(0.0, math.tau, 3)
    vy = r = t = 0.0
    rows, truth = [], []

    def inputs(t: float) -> tuple[float, float]:
        sway = math.sin(0.9 * t + phase[0]) + 0.5 * math.sin(2.3 * t + phase[1])
        return angle * sway, speed + swing * math.sin(0.4 * t + phase[2])

    for h in dt:
        for _ in range(20):
            m = sampled(linear(inputs(t + h / 40.0)[1], CAR), h / 20.0)
            delta = inputs(t + h / 40.0)[0]
            vy, r = m.a11 * vy + m.a12 * r + m.b1 * delta, m.a21 * vy + m.a22 * r + m.b2 * delta
            t += h / 20.0
        delta, vx = inputs(t)
        rows.append([h, vx, r, lateral_acceleration(vy, r, delta, vx, CAR), delta])
        truth.append(vy)
    return np.array(rows), np.array(truth)


def error(name: str, samples: np.ndarray, vy: np.ndarray, gains: Any = None, skip: int = 200) -> float:
    """RMSE of vy over RMS of vy, without the first samples."""
    track = lateral.estimate(lateral.get(name), samples, CAR, gains)
    off = (track.estimate[:, 0] - vy)[skip:]
    return float(np.sqrt(np.mean(off**2) / np.mean(vy[skip:] ** 2)))


def noisy(samples: np.ndarray, seed: int = 1) -> np.ndarray:
    """The samples with the errors of cheap sensors."""
    rng = np.random.default_rng(seed)
    out = samples.copy()
    out[:, 1:] += rng.standard_normal((len(out), 4)) * [0.05, 0.005, 0.1, 0.001]
    return out


# ------------------------------------------------------------------ the contract


@every_estimator
def test_says_what_it_is(name: str) -> None:
    estimator = lateral.get(name)
    assert len(estimator.reference) > 20
    assert set(get_type_hints(estimator.State).values()) == {float}
    gains = estimator.Gains()
    assert all(np.isfinite(value) for value in gains)
    source = inspect.getsource(estimator.Gains)
    for field in gains._fields:
        assert re.search(rf"^ +{field}: .*#.*\[.+\]", source, re.M), f"{field}: unit missing"
    assert lateral.gains_from(estimator, {}) == gains
    with pytest.raises(InputError, match="not known"):
        lateral.gains_from(estimator, {"nonsense": 1.0})


def test_an_unknown_estimator_is_named_with_its_neighbours() -> None:
    with pytest.raises(InputError, match="did you mean kalman"):
        lateral.get("kalmann")


@every_estimator
@pytest.mark.parametrize("seed", [1, 2])
def test_is_finite_whatever_the_sensors_say(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    samples = rng.standard_normal((3000, 5)) * [0.0, 40.0, 3.0, 30.0, 0.8]
    samples[:, 0] = rng.choice([1e-5, 0.01, 0.4, 3.0, NAN, 0.0, -1.0], 3000)
    samples[rng.random((3000, 5)) < 0.05] = NAN
    samples[rng.random((3000, 5)) < 0.002] = np.inf
    track = lateral.estimate(lateral.get(name), samples, CAR, dt=0.01)
    first = int(np.argmin(track.held))
    assert np.isnan(track.estimate[:first]).all()
    assert np.isfinite(track.estimate[first:]).all()


@every_estimator
def test_left_and_right_are_alike(name: str) -> None:
    samples, _ = drive(800, 12.0, 4.0, seed=3, angle=0.05)
    samples = noisy(samples)
    samples[100:150, 3] = NAN
    estimator, mirrored = lateral.get(name), samples * [1.0, 1.0, -1.0, -1.0, -1.0]
    one = lateral.estimate(estimator, samples, CAR).estimate
    other = lateral.estimate(estimator, mirrored, CAR).estimate
    np.testing.assert_allclose(other, -one, rtol=1e-9, atol=1e-12)


@every_estimator
def test_stream_is_the_whole_log_at_once(name: str) -> None:
    estimator, (samples, _) = lateral.get(name), drive(200, 11.0, 3.0, seed=5)
    samples = noisy(samples)
    samples[50:60, 3] = NAN
    design = estimator.prepare(CAR, estimator.Gains(), 0.01)
    rows = [Sample(*map(float, row)) for row in samples]
    state = estimator.start(rows[0], CAR, design)
    out = [estimator.output(state, rows[0], CAR, design)]
    for row in rows[1:]:
        state = estimator.step(state, row, CAR, design)
        out.append(estimator.output(state, row, CAR, design))
    assert all(isinstance(one, Estimate) for one in out)
    track = lateral.estimate(estimator, samples, CAR, dt=0.01)
    np.testing.assert_allclose(np.array(out), track.estimate, rtol=1e-9, atol=1e-12)
    assert not track.held.any()
    part = lateral.estimate(estimator, samples[:120], CAR, dt=0.01)
    np.testing.assert_array_equal(part.estimate, track.estimate[:120])


@every_estimator
@pytest.mark.parametrize("speed", [10.0, -10.0])
def test_finds_vy_of_a_linear_car_forward_and_in_reverse(name: str, speed: float) -> None:
    samples, vy = drive(1500, speed)
    assert error(name, samples, vy) < 0.1


@every_estimator
def test_an_irregular_rate_changes_little(name: str) -> None:
    dt = np.random.default_rng(2).choice([0.004, 0.01, 0.016, 0.04], 1500, p=[0.3, 0.5, 0.15, 0.05])
    assert error(name, *drive(1500, dt=dt)) < 0.15


@every_model
def test_missing_ay_leaves_the_model(name: str) -> None:
    samples, vy = drive(1500)
    samples[400:900, 3] = NAN
    assert error(name, samples, vy) < 0.15
    samples[:, 3] = NAN
    assert error(name, samples, vy) < 0.25


@every_estimator
def test_short_gaps_are_coasted_and_long_ones_start_anew(name: str) -> None:
    samples, vy = drive(1500)
    samples[500:530, 2] = NAN  # 0.3 s
    samples[900:1000, 1] = NAN  # 1 s
    track = lateral.estimate(lateral.get(name), samples, CAR)
    off = np.abs(track.estimate[:, 0] - vy) / np.abs(vy).max()
    assert track.held.sum() == 130
    assert track.held[500:530].all()
    np.testing.assert_array_equal(track.estimate[500:530, 0], np.full(30, track.estimate[499, 0]))
    assert off[530:900].max() < 0.4
    assert off[1000:].max() < 0.6
    assert np.median(off[1200:]) < 0.1


@every_estimator
def test_a_stop_is_held_and_the_drive_goes_on(name: str) -> None:
    moving, vy = drive(1000, 8.0)
    still = np.zeros((300, 5))
    still[:, 0], still[:, 1] = 0.01, np.linspace(0.9, 0.0, 300)
    samples = np.vstack([still, moving, still, moving])
    track = lateral.estimate(lateral.get(name), samples, CAR)
    assert track.held[:300].all()
    assert np.isnan(track.estimate[:300]).all()
    assert track.held[1300:1600].all()
    np.testing.assert_array_equal(track.estimate[1300:1600, 0], np.full(300, track.estimate[1299, 0]))
    assert not track.held[1600:].any()
    off = np.abs(track.estimate[1800:, 0] - vy[200:])
    assert off.max() < 0.2 * np.abs(vy).max()


@every_model
def test_a_biased_yaw_rate_moves_vy_by_no_more_than_the_model_says(name: str) -> None:
    samples, vy = drive(3000, 15.0)
    clean = lateral.estimate(lateral.get(name), samples, CAR).estimate[500:, 0]
    samples[:, 2] += 0.01
    shift = lateral.estimate(lateral.get(name), samples, CAR).estimate[500:, 0] - clean
    assert np.abs(shift).max() < 0.06  # a twentieth of what integration gathers in the same time
    drifted = lateral.estimate(integration, samples, CAR).estimate[-1, 0] - vy[-1]
    assert abs(drifted) > 3.0


# ------------------------------------------------------------------ the model in reverse


def test_a_car_in_reverse_is_stable_and_its_tyres_resist() -> None:
    for speed in (-1.0, -5.0, -20.0):
        m = linear(speed, CAR)
        assert np.linalg.eigvals([[m.a11, m.a12], [m.a21, m.a22]]).real.max() < 0.0
        lf, lr, vy, r, delta = CAR.front, CAR.rear, 0.05, 0.02, 0.01
        slip_f = -(vy + lf * r) / abs(speed) - delta  # the wheel rolls backwards: steering turns round
        slip_r = -(vy - lr * r) / abs(speed)
        front = CAR.front_stiffness * slip_f
        rear = CAR.rear_stiffness * slip_r
        ay = lateral_acceleration(vy, r, delta, speed, CAR)
        assert ay == pytest.approx((front + rear) / CAR.mass, rel=1e-6)
        yawing = m.a21 * vy + m.a22 * r + m.b2 * delta
        assert yawing == pytest.approx((lf * front - lr * rear) / CAR.inertia, rel=1e-6)


@pytest.mark.parametrize("speed", [3.0, 20.0, -4.0])
def test_a_steady_turn_is_an_equilibrium(speed: float) -> None:
    m = linear(speed, CAR)
    vy, r = np.linalg.solve([[m.a11, m.a12], [m.a21, m.a22]], [-m.b1 * 0.02, -m.b2 * 0.02])
    assert _linear.steady(float(r), speed, CAR) == pytest.approx(vy)


# ------------------------------------------------------------------ Riccati


def test_gain_and_poles_of_the_published_design() -> None:
    design = lq.prepare(CAR, lq.Gains(), 0.01)
    assert design.L[0] == pytest.approx([0.281599, 0.798597], abs=1e-6)
    F = _linear.phi([10.0], CAR, 0.01)[0]
    assert F.ravel() == pytest.approx([0.826446, -0.081409, 0.001845, 0.872307], abs=1e-6)
    poles = np.linalg.eigvals(F - np.outer(design.L[0], [0.0, 1.0]))
    assert sorted(poles.real) == pytest.approx([0.0746, 0.8256], abs=1e-4)


@pytest.mark.parametrize(("dt", "L"), [(0.001, (0.493, 0.904)), (0.02, (0.116, 0.696))])
def test_the_gain_depends_on_the_time_step(dt: float, L: tuple[float, float]) -> None:
    assert lq.prepare(CAR, lq.Gains(), dt).L[0] == pytest.approx(L, abs=1e-3)


def test_the_continuous_riccati_equation_with_the_sampled_model_is_unstable() -> None:
    F, Q = _linear.phi([10.0], CAR, 0.01)[0], np.diag([1000.0, 10.0])
    L = solve_continuous_are(F.T, _linear.C.T, Q, np.eye(1)) @ _linear.C.T
    assert L.ravel() == pytest.approx([3680.0, 5.8], rel=0.01)
    assert np.abs(np.linalg.eigvals(F - L @ _linear.C)).max() == pytest.approx(3.28, abs=0.01)


def test_doubling_solves_riccati_at_every_speed() -> None:
    F, Q = _linear.phi(_linear.table(), CAR, 0.01), np.diag([1000.0, 10.0])
    for R in (np.eye(1), 1e-3 * np.eye(1)):
        P = _linear.riccati(F, Q, R)
        for one, p in zip(F[::20], P[::20], strict=True):
            assert p == pytest.approx(solve_discrete_are(one.T, _linear.C.T, Q, R), rel=1e-9)


def test_a_gain_table_is_met_at_its_speeds_and_straight_between() -> None:
    speeds = _linear.table()
    for k in (0, 7, _linear.POINTS - 1, _linear.POINTS, 2 * _linear.POINTS - 1):
        i, w = _linear.tabled(float(speeds[k]))
        assert w * speeds[i] + (1.0 - w) * speeds[i + 1] == pytest.approx(speeds[k])
    for v in (1.3, 44.44, -2.2, -79.9):
        i, w = _linear.tabled(v)
        assert w * speeds[i] + (1.0 - w) * speeds[i + 1] == pytest.approx(v)
    assert _linear.tabled(500.0) == (_linear.POINTS - 2, 0.0)


@pytest.mark.parametrize(
    ("estimator", "gains"),
    [
        (lq, lq.Gains(speed=0.0)),
        (lq, lq.Gains(q_vy=-1.0)),
        (scheduled, scheduled.Gains(r=0.0)),
        (integration, integration.Gains(leak=-0.1)),
        (kalman, kalman.Gains(fade=0.0)),
    ],
)
def test_gains_that_cannot_be_are_refused(estimator: Any, gains: Any) -> None:
    with pytest.raises(InputError, match="want"):
        estimator.prepare(CAR, gains, 0.01)


# ------------------------------------------------------------------ scheduled


@pytest.mark.parametrize("name", ["scheduled", "kalman"])
def test_swinging_speed_and_steering_leave_no_lag(name: str) -> None:
    """Mean inputs of a step are right to second order: four times the step, sixteen times the error."""
    coarse, fine = (error(name, *drive(n, 12.0, 5.0, dt=dt)) for n, dt in ((600, 0.04), (2400, 0.01)))
    assert fine < 2e-3
    assert fine < 0.2 * coarse


@pytest.mark.parametrize("name", ["scheduled", "kalman"])
def test_a_steady_ramp_of_steering_gives_no_bias(name: str) -> None:
    samples, truth = [], []
    vy = r = 0.0
    for k in range(3000):  # steering rises by 0.01 rad/s: its mean over a step is what moves the car
        m = sampled(linear(10.0, CAR), 0.01)
        delta = 1e-4 * (k - 0.5)
        vy, r = m.a11 * vy + m.a12 * r + m.b1 * delta, m.a21 * vy + m.a22 * r + m.b2 * delta
        ay = lateral_acceleration(vy, r, 1e-4 * k, 10.0, CAR)
        samples.append([0.01, 10.0, r, ay, 1e-4 * k])
        truth.append(vy)
    track = lateral.estimate(lateral.get(name), np.array(samples), CAR)
    assert track.estimate[1000:, 0] == pytest.approx(np.array(truth[1000:]), abs=1e-5)


def test_a_share_of_the_riccati_gain_is_what_it_says() -> None:
    none, half, all_ = (scheduled.prepare(CAR, scheduled.Gains(share=s), 0.01).K for s in (0.0, 0.5, 1.0))
    assert not none[:, 0].any()
    np.testing.assert_allclose(half[:, 0], 0.5 * all_[:, 0])
    np.testing.assert_array_equal(none[:, 1], all_[:, 1])
    F = _linear.phi([10.0], CAR, 0.01)[0]
    assert F @ all_[18] == pytest.approx([0.281599, 0.798597], abs=1e-6)  # 10 m/s: the published L


@pytest.mark.parametrize("car", cars.names())
def test_decay_over_speed_is_proven_also_between_the_grid_points(car: str) -> None:
    proof = scheduled.certificate(car)
    assert proof.margin() > 1e-4
    assert len(proof.bounds) == 6
    fine = scheduled.claim(
        cars.load(car), scheduled.Gains(), points=150, dt=(0.004, 0.013, 0.03, 0.07, 0.15, 0.4)
    )
    assert fine.certificate(proof.P, proof.rate).margin() > 1e-4


def test_a_gain_that_is_wrong_has_no_proof() -> None:
    bad = scheduled.Gains(share=40.0)
    assert not _scheduled_proof.certificate("b_class", bad).proven()
    with pytest.raises(InputError, match="want one of b_class"):
        scheduled.certificate("lorry")
    with pytest.raises(InputError, match="1 <= low"):
        scheduled.claim(CAR, scheduled.Gains(), speed=(0.0, 10.0))


def test_a_proof_is_found_anew() -> None:
    pytest.importorskip("clarabel")
    made = _scheduled_proof.prove(CAR, scheduled.Gains(share=1.0), speed=(5.0, 30.0), dt=(0.01,), points=8)
    claim = scheduled.claim(CAR, scheduled.Gains(share=1.0), **made.asked)
    assert claim.certificate(made.P, made.rate).proven()


def test_errors_decay_as_proven_while_speed_changes() -> None:
    """Two estimates of one drive: their difference obeys the proof, at speeds that swing from 6 to 30 m/s."""
    P = scheduled.certificate("b_class").P
    samples, _ = drive(1500, 18.0, 12.0, angle=0.01)
    rows = [Sample(*map(float, row)) for row in samples]
    design = scheduled.prepare(CAR, scheduled.Gains(), 0.01)
    one = scheduled.start(rows[0], CAR, design)
    other = one._replace(vy=one.vy + 1.0, yaw_rate=one.yaw_rate - 0.05)
    before, pace = NAN, 0.0
    for row, last in zip(rows[1:], rows[:-1], strict=True):
        e = np.array([other.vy - one.vy, other.yaw_rate - one.yaw_rate]) / _scheduled_proof.SIZE
        if (size := float(np.sqrt(e @ P @ e))) < 1e-9:
            break
        assert not size > before * math.exp(-_scheduled_proof.DECAY * pace) * (1.0 + 1e-9)
        before, pace = size, -linear(0.5 * (row.vx + last.vx), CAR).a11 * row.dt
        one, other = (scheduled.step(s, row, CAR, design) for s in (one, other))
    assert size < 1e-6


# ------------------------------------------------------------------ integration


def test_integration_is_exact_on_a_linear_car_and_drifts_with_a_bias() -> None:
    samples, vy = drive(2000, 12.0, 4.0)
    track = lateral.estimate(integration, samples, CAR)
    off = track.estimate[:, 0] - vy
    assert np.ptp(off) < 1e-4
    samples[:, 3] += 0.1
    drift = lateral.estimate(integration, samples, CAR).estimate[:, 0] - track.estimate[:, 0]
    assert drift[-1] == pytest.approx(0.1 * samples[1:, 0].sum())
    leaky = lateral.estimate(integration, samples, CAR, integration.Gains(leak=0.5)).estimate[:, 0]
    assert abs((leaky - vy)[-1]) < 0.3


# ------------------------------------------------------------------ kalman


def test_kalman_tells_the_bias_of_the_yaw_rate_while_driving_and_from_a_stand() -> None:
    samples, vy = drive(6000, 14.0, 5.0, angle=0.02)
    samples = noisy(samples)
    samples[:, 2] += 0.012
    samples[:, 3] += 0.1
    driven = lateral.estimate(kalman, samples, CAR).estimate
    assert driven[3000:, 2] == pytest.approx(np.full(3000, 0.012), abs=0.003)
    assert np.sqrt(np.mean((driven[3000:, 0] - vy[3000:]) ** 2)) < 0.02
    still = np.zeros((2000, 5))
    still[:, 0], still[:, 2], still[:, 3] = 0.01, 0.012, 0.1
    stood = lateral.estimate(kalman, np.vstack([still, samples]), CAR).estimate[2000:]
    assert stood[:500, 2] == pytest.approx(np.full(500, 0.012), abs=5e-4)
    again = lateral.estimate(kalman, np.vstack([samples, still, samples[:200]]), CAR).estimate
    assert again[-200:, 2] == pytest.approx(np.full(200, 0.012), abs=1e-3)


def test_a_car_that_creeps_in_a_turn_is_not_taken_to_stand() -> None:
    creep = np.tile([0.01, 0.5, 0.05, 0.025, 0.3], (2000, 1))
    samples, _ = drive(300, 8.0)
    track = lateral.estimate(kalman, np.vstack([samples, creep, samples]), CAR)
    assert np.abs(track.estimate[2301:2400, 2]).max() < 0.002


def test_kalman_covariance_stays_one() -> None:
    samples, _ = drive(3000, 12.0, 6.0, dt=np.random.default_rng(4).choice([0.001, 0.01, 0.3], 3000))
    rows = [Sample(*map(float, row)) for row in noisy(samples)]
    design = kalman.prepare(CAR, kalman.Gains(), 0.01)
    state = kalman.start(rows[0], CAR, design)
    least = np.inf
    for row in rows[1:400]:
        state = kalman.step(state, row, CAR, design)
        P, half = np.zeros((5, 5)), np.tril_indices(5)
        P[half] = np.array(state[7:])
        P = P + np.tril(P, -1).T
        d = np.sqrt(np.diag(P))
        least = min(least, float(np.linalg.eigvalsh(P / d / d[:, None]).min()))
    assert least > 0.0


def test_order_on_a_car_that_slides() -> None:
    """Cheap sensors, the car known, a winding course: the filter beats scheduling, which beats one speed."""
    log = plant.simulate(course.winding(5, length=1500.0), CAR, 1.0, "mems", 11)
    assert log.vy is not None
    samples, vy = log.samples(CAR), log.vy
    rmse = {
        e: float(
            np.sqrt(np.nanmean((lateral.estimate(lateral.get(e), samples, CAR).estimate[:, 0] - vy) ** 2))
        )
        for e in ("kalman", "scheduled", "lq")
    }
    assert rmse["kalman"] < rmse["scheduled"] < 0.7 * rmse["lq"]
    assert rmse["kalman"] < 0.5 * float(np.sqrt(np.mean(vy**2)))
