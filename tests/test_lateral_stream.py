"""Sample by sample gives what the whole log gives, whatever is missing in it."""

import numpy as np
import pytest

from outrider import cars, lateral
from outrider.lateral import Sample, course, plant, stream

CAR = cars.load("d_class")


def rough(seed=3):
    """Samples (n, 5) of a drive with everything that can go missing, a stop, and time that stutters."""
    rng = np.random.default_rng(seed)
    samples = plant.simulate(course.winding(seed, length=250.0), CAR, 1.0, "mems", seed).samples(CAR)[:900]
    samples[1:, 0] *= rng.uniform(0.5, 1.5, len(samples) - 1)
    samples[[0, 1, 2], 4] = np.nan
    samples[100:120, 3] = np.nan
    samples[150:170, 2] = np.nan
    samples[200:290, 1] = np.nan
    samples[300:420, 1] = rng.uniform(-0.9, 0.9, 120)
    samples[500, 0], samples[501, 0] = 0.0, np.nan
    samples[600, 0] = 5.0
    samples[700:, 1] *= -1.0
    return samples


@pytest.mark.parametrize("name", lateral.names())
def test_sample_by_sample_is_the_whole_log(name):
    estimator, samples = lateral.get(name), rough()
    track = lateral.estimate(estimator, samples, CAR, dt=0.01)
    design = estimator.prepare(CAR, estimator.Gains(), 0.01)
    memory, rows, held = stream.FIRST, [], []
    for row in samples:
        memory = stream.advance(estimator, memory, Sample(*(float(v) for v in row)), CAR, design)
        rows.append(memory.estimate)
        held.append(memory.held)
    np.testing.assert_array_equal(held, track.held)
    np.testing.assert_allclose(np.array(rows), track.estimate, rtol=1e-7, atol=1e-9)
    assert 0 < track.held.sum() < 450
    assert np.isfinite(track.estimate[3:]).all()
