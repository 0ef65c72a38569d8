"""Every observer beside scalar C, FilterPy and Stone Soup: many short recordings at once; scan by scan."""

import time
from functools import cache
from typing import Any

import numpy as np
import pytest

import peer_filters
import reference
from conftest import SPEED
from outrider import compiler, observers

TRACKS, SAMPLES = 100_000, 10
NAMES = observers.names()


@cache
def recordings() -> tuple[np.ndarray, np.ndarray]:
    """Measurements (10^5, 10, 9), dt (10^5, 10) [s]: noise of 5 cm, the heading known on half the tracks."""
    rng = np.random.default_rng(1)
    shape = (TRACKS, SAMPLES)
    dt = rng.uniform(0.08, 0.12, shape)
    way = dt * (rng.uniform(1.0, 15.0, (TRACKS, 1)) + np.cumsum(rng.normal(0.0, 0.2, shape), axis=1))
    yaw = rng.uniform(-np.pi, np.pi, (TRACKS, 1)) + np.cumsum(rng.normal(0.0, 0.03, shape), axis=1)
    y = np.empty((*shape, len(observers.Measurement._fields)))
    y[..., 0] = np.cumsum(way * np.cos(yaw), axis=1) + rng.normal(0.0, 0.05, shape)
    y[..., 1] = np.cumsum(way * np.sin(yaw), axis=1) + rng.normal(0.0, 0.05, shape)
    y[..., 2:5] = 0.0025, 0.0, 0.0025
    y[..., 5] = yaw + rng.normal(0.0, 0.05, shape)
    y[..., 6] = np.where(np.arange(TRACKS) % 2, 0.0025, np.inf)[:, None]
    y[..., 7:] = 4.5, 1.8
    return y, dt


@pytest.mark.parametrize("name", NAMES)
def test_batch(benchmark: Any, name: str) -> None:
    """10^5 tracks of ten samples, in turn with the same in C: microseconds a step."""
    observer, (y, dt) = observers.get(name), recordings()
    gains, out = observer.Gains(), np.empty((*dt.shape, len(observer.State._fields)))
    run = compiler.batch(observer.start, observer.step, observer.State, observers.Measurement)
    run(y[:10], dt[:10], gains, out[:10])  # compiles
    twin = reference.build(name) if reference.compiler() and name in reference.names() else None
    theirs = []

    def in_c() -> None:
        if twin is not None:
            begun = time.process_time()
            twin(y, dt, gains, out)
            theirs.append(time.process_time() - begun)

    benchmark.pedantic(run, (y, dt, gains, out), setup=in_c, rounds=7, warmup_rounds=1)
    assert np.isfinite(out[:, -1]).all()
    ours, steps = np.array(benchmark.stats.stats.data), TRACKS * (SAMPLES - 2)
    SPEED[name, "step"] = 1e6 * float(np.median(ours)) / steps
    if twin is not None:
        SPEED[name, "C"] = float(np.median(ours / theirs[-len(ours) :]))


@pytest.mark.parametrize("tracks", [1, 10, 50, 200])
@pytest.mark.parametrize("name", NAMES)
def test_stream(benchmark: Any, name: str, tracks: int) -> None:
    """One call a scan: microseconds."""
    observer = observers.get(name)
    gains, run = observer.Gains(), observers.stream(observer)
    y, dt = (np.ascontiguousarray(a[:tracks].swapaxes(0, 1)) for a in recordings())
    states, index = np.empty((tracks, len(observer.State._fields))), np.arange(tracks)
    run.start_all(y[0], y[1], dt[1], gains, index, states)
    for k in range(2, SAMPLES - 1):
        run.step_all(states, y[k - 1], y[k], dt[k], gains, index, states)
    out = states.copy()
    benchmark(run.step_all, states, y[-2], y[-1], dt[-1], gains, index, out)
    assert np.isfinite(out).all()
    SPEED[name, tracks] = 1e6 * benchmark.stats.stats.median


@pytest.mark.parametrize("kind", ["kalman", "ekf", "ukf", "imm"])
@pytest.mark.parametrize("library", ["filterpy", "stonesoup"])
def test_peer(benchmark: Any, library: str, kind: str) -> None:
    """One step of one track: microseconds."""
    what, work = getattr(peer_filters, library)(kind)
    benchmark.extra_info["what"] = what
    benchmark.pedantic(work, rounds=500, warmup_rounds=50)
    SPEED[library, kind] = 1e6 * benchmark.stats.stats.median
