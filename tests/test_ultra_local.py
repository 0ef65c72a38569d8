"""The ultra-local estimators: what they become at the ends, where they are stable, what tuning finds."""

from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from outrider import cars, lateral, plots_tune
from outrider.errors import InputError, OutputError
from outrider.lateral import Sample, _search, course, plant, tune
from outrider.lateral.estimators import ultra_local, ultra_local_published
from outrider.lateral.log import Log
from outrider.models.single_track import linear, sampled

pytestmark = pytest.mark.once

B, D = cars.load("b_class"), cars.load("d_class")
DT = 0.01
K = [f"k{i}" for i in range(1, 8)]
ALPHA = [f"alpha{i}" for i in range(1, 8)]


def same(names, value, **others):
    return dict.fromkeys(names, value) | others


def run(name, samples, car=B, **gains):
    """vy (n,) of an estimator."""
    estimator = lateral.get(name)
    track = lateral.estimate(estimator, samples, car, lateral.gains_from(estimator, gains), DT)
    assert not track.held.any()
    return track.estimate[:, 0]


@lru_cache
def driven(noise="none", car=B, friction=1.0, seed=1):
    """A log of the plant on a made course, 400 s."""
    log = plant.simulate(course.winding(seed), car, friction, noise, seed=seed)
    assert not log.faults
    return log


def error(log, name, **gains):
    """RMSE of vy [m/s] of an estimator that believes in the B-class car."""
    return float(np.sqrt(np.mean((run(name, log.samples(B), **gains) - log.vy) ** 2)))


def straight(n, vx=10.0, **columns):
    samples = np.zeros((n, 5))
    samples[:, :2] = DT, vx
    for name, values in columns.items():
        samples[:, Sample._fields.index(name)] = values
    return samples


# ------------------------------------------------------------------ at its ends


def test_without_the_ultra_local_model_it_is_the_scheduled_observer():
    samples = driven("mems").samples(B)[:5000]
    made, base = run("ultra_local", samples, **same(K, 0.0)), run("scheduled", samples)
    np.testing.assert_allclose(made, base, rtol=0, atol=1e-12)


def test_as_published_without_the_ultra_local_model_it_is_the_fixed_observer():
    samples = driven("mems").samples(B)[:5000]
    np.testing.assert_allclose(run("ultra_local_published", samples), run("lq", samples), rtol=0, atol=1e-12)


def test_with_all_of_it_acceleration_is_integrated():
    samples = driven("mems").samples(B)[:2000]
    rate = samples[:, 3] - samples[:, 1] * samples[:, 2]
    made = run("ultra_local", samples, **same(K, 1.0 - 1e-9, memory=0.0))
    summed = made[0] + np.append(0.0, np.cumsum(0.5 * DT * (rate[1:] + rate[:-1])))
    np.testing.assert_allclose(made, summed, rtol=0, atol=1e-5)


@pytest.mark.parametrize("k", [1.0, 1.5, -0.1])
def test_a_share_outside_zero_to_one_is_refused(k):
    with pytest.raises(InputError, match=r"k4 = .* want 0 <= k < 1"):
        run("ultra_local", straight(3), k4=k)


@pytest.mark.parametrize(
    ("name", "gains", "said"),
    [
        ("ultra_local", {"over": 0.5}, "over = 0.5; want one of 0, 1"),
        ("ultra_local", {"base": 2.0}, "base = 2"),
        ("ultra_local", {"dt": 0.0}, "dt = 0"),
        ("ultra_local", {"memory": -1.0}, "memory = -1; want 0 or a positive time"),
        ("ultra_local_published", {"reading": 4.0}, "reading = 4; want one of 1, 2, 3"),
        ("ultra_local_published", {"alpha2": 0.0}, "alpha2 = 0; want a positive number"),
    ],
)
def test_gains_that_cannot_be_are_refused(name, gains, said):
    with pytest.raises(InputError, match=said):
        run(name, straight(3), **gains)


# ------------------------------------------------------------------ what a sensor's error does


@pytest.mark.parametrize("k", [0.5, 0.9, 0.95])
@pytest.mark.parametrize("vx", [6.0, 10.0, 20.0])
def test_a_biased_acceleration_moves_it_as_the_formula_says(k, vx):
    bias, phi11 = 0.1, sampled(linear(vx, B), DT).a11
    made = run("ultra_local", straight(20000, vx, ay=bias), **same(K, k, memory=0.0))
    assert made[-1] == pytest.approx(DT * bias * k / ((1.0 - k) * (1.0 - phi11)), rel=0.01)
    assert abs(made[-1] - made[-100]) < 1e-6


@given(st.floats(-0.3, 0.3), st.floats(-0.01, 0.01), st.floats(5.0, 20.0))
def test_the_bias_of_both_sensors_is_learned_on_straights(ay, yaw_rate, vx):
    samples = straight(6000, vx, ay=ay, yaw_rate=yaw_rate)
    plain, learned = (run("ultra_local", samples, **same(K, 0.95, memory=m))[-1] for m in (0.0, 30.0))
    model = run("scheduled", samples)[-1]
    assert abs(learned - model) <= 0.01 * abs(plain - model) + 1e-6


def test_learning_is_worth_it_whatever_the_sign_of_the_bias():
    cheap = plant.NOISES["mems"]
    for sign in (1.0, -1.0):
        noise = cheap._replace(ay_bias=sign * cheap.ay_bias, yaw_rate_bias=-sign * cheap.yaw_rate_bias)
        log = driven(noise)
        plain, learned = (error(log, "ultra_local", **same(K, 0.9, memory=m)) for m in (0.0, 30.0))
        assert learned < 0.8 * plain


@pytest.mark.parametrize("k", [0.0, 0.6, 0.98])
def test_ramps_leave_no_error(k):
    """A car as modelled, steering and speed ramping: what is sampled was integrated every 0.1 ms."""
    fine, n, vy, r, rows = 100, 300, 0.0, 0.0, []
    for i in range(n * fine + 1):
        vx, delta = 8.0 + 0.04 * i / fine, 0.0003 * i / fine
        m = linear(vx, B)
        if i % fine == 0:
            ay = m.a11 * vy + (m.a12 + vx) * r + m.b1 * delta
            rows.append((DT, vx, r, ay, delta, vy))
        d = sampled(m, DT / fine)
        vy, r = d.a11 * vy + d.a12 * r + d.b1 * delta, d.a21 * vy + d.a22 * r + d.b2 * delta
    rows = np.array(rows)
    made = run("ultra_local", np.ascontiguousarray(rows[:, :5]), **same(K, k, memory=0.0))
    assert np.abs(rows[:, 5]).max() > 0.2
    assert np.abs(made - rows[:, 5]).max() < 2e-4


def test_without_acceleration_it_goes_on_as_the_observer():
    samples = driven("mems").samples(B)[:3000]
    samples[:, 3] = np.nan
    made, base = run("ultra_local", samples, **same(K, 0.9)), run("scheduled", samples)
    np.testing.assert_allclose(made, base, rtol=0, atol=1e-12)
    some = driven("mems").samples(B)[:3000]
    some[1000:2000, 3] = np.nan
    whole = driven("mems").samples(B)[:3000]
    made, all_of_it = (run("ultra_local", s, **same(K, 0.9, memory=0.0)) for s in (some, whole))
    assert np.isfinite(made).all()
    assert np.abs(made - all_of_it)[1100:2000].max() > 1e-3
    assert np.abs(made - all_of_it)[2300:].max() < 2e-3


@given(st.floats(0.0, 0.999), st.floats(-200.0, -2.0), st.floats(0.001, 0.5))
def test_the_share_leaks_the_same_at_any_step(k, a11, dt):
    made = ultra_local.same_leak(k, a11, dt, DT)
    model = 1.0 - np.exp(a11 * dt)
    once = 1.0 - (1.0 - k) * (1.0 - np.exp(a11 * DT))
    assert 0.0 <= made < 1.0 + 1e-12
    assert 1.0 - (1.0 - made) * model == pytest.approx(once ** (dt / DT), abs=1e-9)
    assert ultra_local.same_leak(k, a11, DT, DT) == k
    assert ultra_local.same_leak(0.0, a11, dt, DT) == 0.0


@pytest.mark.parametrize("every", [2, 5])
def test_a_table_for_one_rate_serves_another(every):
    log = driven()
    samples = log.samples(B)
    slow = samples[::every].copy()
    slow[:, 0] *= every
    full, sparse = (run("ultra_local", s, **same(K, 0.95)) for s in (samples, slow))
    wrong = run("ultra_local", slow, **same(K, 0.95, dt=DT * every))
    apart = np.sqrt(np.mean((full[::every] - sparse) ** 2))
    assert apart < 0.02 * np.sqrt(np.mean(full**2))
    assert apart < 0.5 * np.sqrt(np.mean((full[::every] - wrong) ** 2))


# ------------------------------------------------------------------ as published


def grows(reading, alpha, vx, share):
    """Largest eigenvalue of a step of the published form, from the estimator's own `step`."""
    gains = ultra_local_published.Gains(reading=reading, base=1.0, share=share)._replace(**same(ALPHA, alpha))
    design = ultra_local_published.prepare(B, gains, DT)
    zero = Sample(DT, vx, 0.0, 0.0, 0.0)
    fields = ["vy", "yaw_rate", "u", "vy_free", "yaw_rate_free"]
    rest = ultra_local_published.State(*[0.0] * 5, vx, 0.0, 0.0, 0.0, 1.0)
    steps = [ultra_local_published.step(rest._replace(**{f: 1e-3}), zero, B, design)[:5] for f in fields]
    return np.abs(np.linalg.eigvals(1e3 * np.array(steps).T)).max()


@pytest.mark.parametrize(
    ("reading", "share", "limits"),
    [(1, 1.0, (84, 81, 80)), (1, 0.0, (100, 99, 96)), (2, 1.0, (40, 43, 43)), (2, 0.0, (42, 44, 43))],
)
def test_readings_1_and_2_are_unstable_below_a_limit(reading, share, limits):
    for vx, limit in zip((6.0, 10.0, 20.0), limits, strict=True):
        assert grows(reading, limit + 0.5, vx, share) < 1.0
        assert grows(reading, limit - 2.0, vx, share) > 1.0


@pytest.mark.parametrize("alpha", [1.0, 30.0, 100.0])
def test_reading_3_is_stable_at_any_alpha(alpha):
    assert max(grows(3, alpha, vx, 1.0) for vx in (6.0, 10.0, 20.0)) < 1.0


def test_reading_1_is_a_complementary_filter():
    """With direct injection in place of its yaw moment, alpha is Gamma1 / (dt k): the same drift."""
    samples, alpha = straight(30000, ay=0.1), 120.0
    made = run("ultra_local_published", samples, **same(ALPHA, alpha, share=0.0))
    k = linear(10.0, B).b1 / alpha
    assert made[-1] > 0.0
    assert made[-1] == pytest.approx(0.1 * k / (1.0 - k) / -linear(10.0, B).a11, rel=0.25)


def test_nothing_is_corrected_in_a_long_steady_turn():
    """A car with other tyres turns: acceleration says that vy rests, not where; it ends at the model's."""
    other = B._replace(front_stiffness=70e3, rear_stiffness=60e3)
    m, vx, delta = linear(10.0, other), 10.0, 0.05
    vy, r = np.linalg.solve([[m.a11, m.a12], [m.a21, m.a22]], [-m.b1 * delta, -m.b2 * delta])
    samples = straight(3000, vx, yaw_rate=r, ay=vx * r, steering=delta)
    model = run("scheduled", samples)[-1]
    assert abs(model - vy) > 0.05
    assert run("ultra_local", samples, **same(K, 0.95))[-1] == pytest.approx(model, abs=1e-6)
    alone = run("ultra_local_published", samples)[-1]
    third = run("ultra_local_published", samples, **same(ALPHA, 150.0, reading=3.0))[-1]
    assert third == pytest.approx(alone, abs=1e-6)
    bare = run("ultra_local_published", samples, share=0.0)[-1]
    first = run("ultra_local_published", samples, **same(ALPHA, 150.0, share=0.0))[-1]
    assert first == pytest.approx(bare, abs=1e-3)


def test_an_unstable_alpha_stays_finite():
    log = driven()
    made = run("ultra_local_published", log.samples(B)[:5000], **same(ALPHA, 20.0))
    assert np.isfinite(made).all()
    assert np.abs(made).max() > 10.0


# ------------------------------------------------------------------ the order of the source's table


def test_the_claim_holds_without_noise_and_without_the_observers_gain_on_vy():
    log = driven()
    fixed, literal = error(log, "lq"), error(log, "ultra_local_published", **same(ALPHA, 105.0, share=1.0))
    together = error(log, "ultra_local", **same(K, 0.998, base=0.0, memory=0.0))
    assert together < 0.3 * fixed
    assert literal > 0.95 * fixed
    other = driven(car=D)
    assert error(other, "ultra_local", **same(K, 0.998, base=0.0, memory=0.0)) < 0.5 * error(other, "lq")


def test_scheduling_brings_most_of_it_and_the_rest_is_small_with_cheap_sensors():
    log = driven("mems")
    fixed, scheduled, both = error(log, "lq"), error(log, "scheduled"), error(log, "ultra_local")
    assert both < scheduled < 0.6 * fixed
    assert fixed - scheduled > 3.0 * (scheduled - both)
    assert error(log, "ultra_local", **same(K, 0.998)) > 5.0 * fixed


# ------------------------------------------------------------------ tuning


@lru_cache
def tuned(estimator="ultra_local", over="", method="grid", noise="mems"):
    gains = {"memory": 0.0} if estimator == "ultra_local" else {}
    return tune.tune([driven(noise)], B, estimator, over, method, gains)


def test_each_bin_gets_its_least_error():
    made = tuned()
    errors = np.array(made.rmse_mps)
    assert sum(made.rows) == len(driven("mems").t)
    assert made.values["grid"] == [made.grid[i] for i in errors.argmin(axis=0)]
    assert made.gains == dict(zip(K, made.values["grid"], strict=True)) | {
        "over": 1.0,
        "dt": DT,
        "memory": 0.0,
    }
    assert made.rmse_of["grid"] < 0.8 * made.rmse_of["none"]
    assert made.rmse_of["joint"] <= made.rmse_of["grid"]
    assert made.rmse_of["none"] == pytest.approx(error(driven("mems"), "scheduled"))
    assert made.rmse_of["grid"] == pytest.approx(error(driven("mems"), "ultra_local", **made.gains))
    squares = np.square(made.rms_vy_mps) @ made.rows / sum(made.rows)
    assert np.sqrt(squares) == pytest.approx(np.sqrt(np.mean(driven("mems").vy ** 2)))


def test_noise_decides_how_much_of_it_is_best():
    cheap, silent = tuned(), tuned(noise="none")
    assert cheap.values["grid"][0] == 0.0
    assert cheap.values["grid"][-1] >= 0.8
    assert all(a <= b for a, b in zip(cheap.values["grid"], silent.values["grid"], strict=True))
    assert silent.rmse_of["joint"] < 0.2 * silent.rmse_of["none"]


def test_the_published_loop_stops_at_the_first_rise():
    assert _search.first_rise(np.array([3.0, 2.0, 2.5, 1.0])) == 1
    assert _search.first_rise(np.array([3.0, 3.0, 1.0])) == 0
    assert _search.first_rise(np.array([3.0, 2.0, 1.0])) == 2
    made = tuned(noise="none")
    assert any(a < b for a, b in zip(made.values["greedy"], made.values["grid"], strict=True))
    assert made.rmse_of["greedy"] > made.rmse_of["grid"]


def test_as_published_tuning_gains_next_to_nothing():
    made = tuned("ultra_local_published")
    assert made.over == "speed"
    assert 0.97 * made.rmse_of["none"] < made.rmse_of["grid"] <= made.rmse_of["none"]
    assert np.isinf(made.alpha(np.zeros(7), made.middles)).all()


def test_the_curve_is_level_then_a_slope_then_level():
    at, rows = np.arange(7.0), np.array([500, 100, 100, 200, 300, 100, 50])
    goal = np.array([0.0, 0.0, 0.3, 0.6, 0.9, 0.9, -5.0])  # the last has too few rows to count
    np.testing.assert_allclose(_search.ramp(at, goal, rows, at), [*goal[:6], 0.9], atol=1e-12)
    level = _search.ramp(at, goal, np.array([500, 0, 0, 0, 0, 0, 0]), at)
    np.testing.assert_allclose(level, 0.0, atol=1e-12)


def test_alpha_is_what_the_share_means():
    made = tuned()
    gamma = sampled(linear(10.0, B), DT).b1 / DT
    np.testing.assert_allclose(made.alpha(np.full(7, 0.5), made.middles), gamma / 0.5)
    assert gamma == pytest.approx(89.1, abs=0.05)


def test_the_bins_see_the_acceleration_that_the_estimator_sees():
    samples = driven("mems").samples(B)[:500]
    samples[100:150, 3] = np.nan
    design = ultra_local.prepare(B, ultra_local.Gains(), DT)
    states = [ultra_local.start(Sample(*samples[0]), B, design)]
    for row in samples[1:]:
        states.append(ultra_local.step(states[-1], Sample(*row), B, design))
    np.testing.assert_allclose(tune.low_passed(samples), [s.side for s in states], atol=1e-12)


def test_a_tuning_is_kept_with_what_it_was_tuned_on(tmp_path):
    made = tuned()
    tune.save(made, tmp_path / "alpha.json")
    again = tune.load(tmp_path / "alpha.json")
    assert again == made
    assert again.logs[0].sha256 == driven("mems").fingerprint() != driven("none").fingerprint()
    lateral.gains_from(lateral.get(again.estimator), again.gains)


def short(**columns):
    t = DT * np.arange(400)
    base = {"vx": 10.0 + 0 * t, "yaw_rate": 0 * t, "ay": 0 * t, "steering": 0 * t, "vy": 0 * t}
    return Log(t=t, **(base | columns))


@pytest.mark.parametrize(
    ("logs", "asked", "said"),
    [
        ([], {}, "no bin of ay has 100 rows"),
        ([short(vy=None)], {}, "log 1 has no vy"),
        ([short(), short(vy=np.full(400, np.nan))], {}, "log 2 has no vy"),
        ([short(vx=np.full(400, 0.5))], {}, "no bin of ay has 100 rows"),
        ([short(ay=np.full(400, np.nan))], {}, "no bin of ay has 100 rows"),
        ([short()], {"estimator": "lq"}, "has no alpha to tune"),
        ([short()], {"over": "slip"}, "over 'slip'; want one of ay, speed"),
        ([short()], {"estimator": "ultra_local_published", "over": "ay"}, "want one of speed"),
        ([short()], {"method": "random"}, "method 'random' is not known"),
        ([short()], {"gains": {"k3": 0.5}}, "gain k3 is what is tuned"),
        ([short()], {"gains": {"depth": 0.5}}, "gain 'depth' is not known"),
    ],
)
def test_what_cannot_be_tuned_is_said(logs, asked, said):
    with pytest.raises(InputError, match=said):
        tune.tune(logs, B, **asked)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text[:-20], "no gains"),
        (lambda text: text.replace('"ultra_local"', '"kalmann"'), "estimator 'kalmann' is not known"),
        (lambda text: text.replace('"k7": 0.', '"k7": 1.'), "k7 = 1.* want 0 <= k < 1"),
        (lambda text: text.replace('"mass": 1223.0', '"mass": -1.0'), "mass_kg = -1; want a positive number"),
        (lambda text: text.replace('"mass"', '"weight"'), "alpha.json: .*weight"),
    ],
)
def test_a_file_that_is_no_tuning_is_refused(tmp_path, change, said):
    path = tmp_path / "alpha.json"
    tune.save(tuned(), path)
    text = path.read_text()
    assert change(text) != text
    path.write_text(change(text))
    with pytest.raises(InputError, match=said):
        tune.load(path)


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(InputError, match="cannot read gains"):
        tune.load(tmp_path / "none.json")
    with pytest.raises(OutputError, match="cannot write"):
        tune.save(tuned(), tmp_path / "none" / "alpha.json")


# ------------------------------------------------------------------ the picture


@pytest.mark.parametrize(("estimator", "over"), [("ultra_local", "ay"), ("ultra_local_published", "speed")])
def test_the_picture_shows_what_was_found(estimator, over, tmp_path):
    made = tuned(estimator, over)
    assert plots_tune.save(made, tmp_path / "alpha.png").stat().st_size > 20_000
    left, right, *_ = plots_tune.figure(made).axes
    points = {line.get_label(): line.get_xydata() for line in left.lines}
    x = made.middles * (3.6 if over == "speed" else 1.0)
    grid = points["best of the grid"]
    np.testing.assert_allclose(grid[:, 0], x)
    strength = _search.KINDS[estimator].strength(made.values["grid"])
    np.testing.assert_allclose(grid[:, 1], np.minimum(made.alpha(strength, made.middles), plots_tune.MOST))
    tries = [line.get_ydata() for line in right.lines if len(line.get_xdata()) == len(made.grid)]
    np.testing.assert_allclose(np.array(tries).T, np.array(made.rmse_mps) / made.rmse_mps[0])
    assert all(a < b for a, b in pairwise(right.get_xticks()))
