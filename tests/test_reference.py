"""Every observer that is written in C for the benchmark too gives the same there, on data with all faults."""

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outrider import observers

PLACE = Path(__file__).parents[1] / "benchmarks" / "reference"
TWINS = sorted(path.stem for path in PLACE.glob("*.c"))
TRACKS, SAMPLES = 24, 60


@pytest.fixture(scope="module")
def reference() -> Any:
    """The module that compiles them."""
    spec = importlib.util.spec_from_file_location("outrider_reference", PLACE / "__init__.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if module.compiler() is None:
        pytest.skip("no C compiler `cc` on the path")
    return module


def recording() -> tuple[np.ndarray, np.ndarray]:
    """Measurements (24, 60, 9), dt (24, 60) [s]: winding, reversing; noisy, gappy, irregular, jumping."""
    rng = np.random.default_rng(5)
    shape = (TRACKS, SAMPLES)
    dt = rng.uniform(0.03, 0.25, shape)
    speed = rng.uniform(0.0, 20.0, (TRACKS, 1)) + np.cumsum(rng.normal(0.0, 1.0, shape), axis=1)
    yaw = rng.uniform(-np.pi, np.pi, (TRACKS, 1)) + np.cumsum(rng.normal(0.0, 0.1, shape), axis=1)
    way = (speed * dt)[..., None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    y = np.zeros((*shape, len(observers.Measurement._fields)))
    sigma = rng.uniform(0.01, 0.1, (TRACKS, 1))
    y[..., :2] = np.cumsum(way, axis=1) + sigma[..., None] * rng.normal(size=(*shape, 2))
    y[..., 2], y[..., 3], y[..., 4] = sigma**2, 0.3 * sigma**2, 0.8 * sigma**2
    y[..., 5] = yaw + rng.normal(0.0, 0.05, shape)
    y[..., 6] = np.where(rng.random(shape) < 0.5, 0.0025, np.inf)
    y[..., 7:] = 4.5, 1.8
    y[rng.random(shape) < 0.1, 0] = np.nan  # missed
    y[: TRACKS // 4, SAMPLES // 2, 1] += 20.0  # a wrong one
    dt[rng.random(shape) < 0.03] *= 30.0  # a long gap
    dt[rng.random(shape) < 0.03] *= -1.0
    return y, dt


@pytest.mark.parametrize("name", TWINS)
def test_c_gives_the_same(reference: Any, name: str) -> None:
    observer = observers.get(name)
    gains = observer.Gains()
    y, dt = recording()
    ours = observers.batch(observer, y, dt, gains)
    theirs = np.zeros_like(ours)
    reference.build(name)(y, dt, gains, theirs)
    assert np.isfinite(ours[:, -1]).all()
    np.testing.assert_allclose(theirs, ours, rtol=1e-9, atol=1e-9)
