"""Every estimator of lateral velocity on a million samples, one core: seconds, of which one is the aim."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from outrider import cars, lateral
from outrider.lateral import Sample, stream

SAMPLES = 1_000_000


@cache
def log() -> np.ndarray:
    """Samples (10^6, 5) at 100 Hz of a car that weaves while its speed swings from 8 to 16 m/s."""
    t = 0.01 * np.arange(SAMPLES)
    vx, r = 12.0 + 4.0 * np.sin(0.1 * t), 0.2 * np.sin(0.7 * t)
    noise = np.random.default_rng(1).standard_normal((3, SAMPLES)) * [[0.005], [0.08], [0.001]]
    ay, steering = vx * r + noise[1], r * (2.34 / vx + 0.004 * vx) + noise[2]
    return np.column_stack([np.full(SAMPLES, 0.01), vx, r + noise[0], ay, steering])


@pytest.mark.parametrize("name", lateral.names())
def test_whole_log(benchmark: Any, name: str) -> None:
    """One call, compiled before."""
    estimator, samples, car = lateral.get(name), log(), cars.load("b_class")
    lateral.estimate(estimator, samples[:100], car)  # compiles
    track = benchmark.pedantic(lateral.estimate, (estimator, samples, car), rounds=3)
    benchmark.extra_info["ns a sample"] = 1e9 * benchmark.stats.stats.min / SAMPLES
    assert np.isfinite(track.estimate).all()
    assert not track.held.any()


@pytest.mark.parametrize("name", lateral.names())
def test_sample_by_sample(benchmark: Any, name: str) -> None:
    """One sample, in plain Python, as it comes in."""
    estimator, car = lateral.get(name), cars.load("b_class")
    design, rows = estimator.prepare(car, estimator.Gains(), 0.01), log()[:2].tolist()
    memory = stream.advance(estimator, stream.FIRST, Sample(*rows[0]), car, design)
    after = benchmark(stream.advance, estimator, memory, Sample(*rows[1]), car, design)
    assert np.isfinite(after.estimate).all()
    assert not after.held
