"""One call a scan over N tracks, for every observer: microseconds, median.

python -m pytest benchmarks/test_observer_speed.py --benchmark-enable --benchmark-columns=median,min,rounds
"""

from typing import Any

import numpy as np
import pytest

from outrider import observers


@pytest.mark.parametrize("tracks", [1, 10, 50, 200])
@pytest.mark.parametrize("name", observers.names())
def test_step(benchmark: Any, name: str, tracks: int) -> None:
    observer = observers.get(name)
    gains, run = observer.Gains(), observers.stream(observer)
    index, dt = np.arange(tracks), np.full(tracks, 0.1)
    before, after = np.zeros((2, tracks, len(observers.Measurement._fields)))
    before[:, 6] = after[:, 6] = np.inf
    after[:, 0] = np.linspace(0.1, 1.5, tracks)
    states = np.empty((tracks, len(observer.State._fields)))
    run.start_all(before, after, dt, gains, index, states)
    out = states.copy()
    run.step_all(states, before, after, dt, gains, index, out)  # compiles
    benchmark.extra_info["tracks"] = tracks
    benchmark(run.step_all, states, before, after, dt, gains, index, out)
    assert np.isfinite(out).all()
