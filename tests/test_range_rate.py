"""Rates of measured ranges: exact where they should be, late where they must be, NaN where unknown."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from outrider.errors import InputError
from outrider.relocalise import range_rate

EVEN = np.arange(60) * 0.05
every_method = pytest.mark.parametrize("method", ["parabola", "line", "difference"])


def two(first, second):
    return np.stack([np.broadcast_to(first, EVEN.shape), np.broadcast_to(second, EVEN.shape)], axis=-1)


@given(
    st.lists(st.floats(0.02, 0.12), min_size=20, max_size=40),
    st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3)),
)
def test_a_parabola_is_exact_on_a_parabola_at_any_times(steps, c):
    t = np.cumsum(steps)
    ranges = np.stack([c[0] + c[1] * t + c[2] * t**2, 2.0 + 0.0 * t], axis=-1)
    rates = range_rate.of_log(t, ranges)
    known = np.isfinite(rates)
    wanted = np.stack([c[1] + 2.0 * c[2] * t, 0.0 * t], axis=-1)
    np.testing.assert_allclose(rates[known], wanted[known], atol=1e-8)
    assert known[t > t[0] + 0.3 + 1e-6].all()
    assert not known[t < t[0] + 0.3 - 1e-6].any()


def test_a_line_is_late_by_half_the_window_and_a_difference_by_half_a_step():
    ranges = two(EVEN**2, 1.0 + 0.5 * EVEN)
    for method, late in (("line", 0.15), ("difference", 0.025)):
        rates = range_rate.of_log(EVEN, ranges, method=method)
        np.testing.assert_allclose(rates[10:, 0], 2.0 * (EVEN[10:] - late), atol=1e-12)
        np.testing.assert_allclose(rates[10:, 1], 0.5, atol=1e-12)


def test_against_numpy():
    """The slope at the end of polyfit's polynomial, with noise and holes."""
    rng = np.random.default_rng(0)
    ranges = two(2.0 + np.sin(EVEN), 3.0) + 0.01 * rng.standard_normal((60, 2))
    ranges[rng.random((60, 2)) < 0.2] = np.nan
    for method, degree in (("parabola", 2), ("line", 1)):
        rates = range_rate.of_log(EVEN, ranges, method=method)
        compared = 0
        for k in range(60):
            for i in range(2):
                if np.isfinite(rates[k, i]):
                    used = np.isfinite(ranges[:, i]) & (EVEN[k] >= EVEN) & (EVEN[k] - 0.3 - 1e-9 < EVEN)
                    fit = np.polyfit(EVEN[used] - EVEN[k], ranges[used, i], degree)
                    assert rates[k, i] == pytest.approx(fit[-2], abs=1e-9)
                    compared += 1
        assert compared > 40


def test_noise_of_a_parabola_is_some_four_times_that_of_a_line():
    rng = np.random.default_rng(1)
    ranges = 2.0 + 0.01 * rng.standard_normal((400, 200, 2))
    t = np.arange(400) * 0.02
    spread = [np.nanstd(range_rate.of_log(t, ranges, method=m)) for m in ("parabola", "line")]
    assert spread[0] / spread[1] == pytest.approx(4.0, abs=0.3)


@every_method
def test_sample_by_sample_is_the_whole_log(method):
    """Bit for bit, with holes, a gap and a sensor that is turned; and many robots are each alone."""
    rng = np.random.default_rng(2)
    ranges = 2.0 + rng.random((60, 3, 2))
    ranges[rng.random(ranges.shape) < 0.1] = np.nan
    ranges[30:36] = np.nan
    angles = np.tile([1.0, -1.0], (60, 1))
    angles[45:, 0] = 0.5
    whole = range_rate.of_log(EVEN, ranges, angles, method)
    memory, each = None, []
    for k, t in enumerate(EVEN):
        rates, memory = range_rate.advance(memory, t, ranges[k], angles[k], method)
        each.append(rates)
    np.testing.assert_array_equal(each, whole)
    alone = range_rate.of_log(EVEN, ranges[:, 1], angles, method)
    np.testing.assert_allclose(alone, whole[:, 1], atol=1e-12)
    assert np.isfinite(whole).any()
    assert np.isnan(whole[30:36]).all()


def test_the_window_fills_anew_after_a_gap_or_a_turn():
    angles = np.tile([1.0, -1.0], (60, 1))
    angles[40:, 1] = 0.3
    ranges = two(1.0 + EVEN, 2.0)
    ranges[20:24, 0] = np.nan
    known = np.isfinite(range_rate.of_log(EVEN, ranges, angles))
    first = np.ones(60, bool)
    first[:6] = first[20:30] = False
    second = np.ones(60, bool)
    second[:6] = second[40:46] = False
    np.testing.assert_array_equal(known, np.stack([first, second], axis=-1))


def test_one_hole_is_no_gap():
    ranges = two(1.0 + EVEN, 2.0)
    ranges[20, 0] = np.nan
    known = np.isfinite(range_rate.of_log(EVEN, ranges))
    assert not known[20, 0]
    assert known[21:].all()


def test_a_time_that_does_not_increase_is_forgotten():
    ranges = two(1.0 + EVEN, 2.0)
    memory = None
    for k in range(20):
        rates, memory = range_rate.advance(memory, EVEN[k], ranges[k], np.zeros(2))
    for t in (EVEN[19], EVEN[10], np.nan):
        again, same = range_rate.advance(memory, t, ranges[0], np.zeros(2))
        assert np.isnan(again).all()
        assert same is memory
    np.testing.assert_allclose(rates, [1.0, 0.0], atol=1e-12)


def test_too_slow_a_sensor_has_no_rate_but_a_difference():
    t = np.arange(30) * 0.2
    ranges = np.stack([t, t], axis=-1)
    assert np.isnan(range_rate.of_log(t, ranges)).all()
    assert np.isfinite(range_rate.of_log(t, ranges, window=0.8)[4:]).all()
    np.testing.assert_allclose(range_rate.of_log(t, ranges, method="difference")[1:], 1.0)


@pytest.mark.parametrize("asked", [{"method": "cubic"}, {"window": 0.0}, {"window": np.nan}])
def test_what_is_refused(asked):
    with pytest.raises(InputError, match="range rate"):
        range_rate.of_log(EVEN, two(1.0, 1.0), **asked)
