"""The baseline: its beam model, its sample size, and that it finds and follows a robot."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from outrider.errors import InputError
from outrider.relocalise import Sample, motions, particle, room, simulate
from outrider.relocalise.particle import Cloud, Gains, ParticleFilter

pytestmark = pytest.mark.once

NONE = np.full(2, np.nan)


def driven(where, cloud, drives, robot=0):
    """Poses (k, 3) along a drive."""
    steps = np.diff(drives.t, prepend=drives.t[0])
    rows = zip(steps, drives.odometry[:, robot], drives.ranges[:, robot], strict=True)
    return np.array(
        [cloud.step(Sample(float(dt), v, 0.0, w, z, NONE, NONE, where.angles)) for dt, (v, w), z in rows]
    )


@pytest.mark.parametrize("wall", [0.5, 2.0, 7.0])
def test_the_beam_model_is_a_density(wall):
    gains = Gains()
    ends = [0.0, wall - 0.3, wall, wall + 0.3, 10.0]
    density = lambda z: float(particle.likelihood(z, wall, 10.0, gains))  # noqa: E731
    parts = [quad(density, a, b, limit=200)[0] for a, b in pairwise(ends)]
    none = float(particle.likelihood(np.nan, wall, 10.0, gains))
    assert sum(parts) + none == pytest.approx(
        gains.z_hit + gains.z_short + gains.z_max + gains.z_rand, abs=2e-3
    )


def test_the_beam_model_prefers_the_wall_and_then_what_is_before_it():
    at = particle.likelihood(np.array([3.0, 1.0, 5.0, np.nan]), 3.0, 10.0, Gains())
    assert at[0] > 50.0 * at[1] > 50.0 * at[2] > 0.0
    nowhere = particle.likelihood(np.array([3.0, np.nan]), np.nan, 10.0, Gains())
    assert nowhere[1] > 10.0 * nowhere[0] > 0.0


def test_resampling_takes_each_as_often_as_its_weight_says():
    weight = np.array([0.05, 0.5, 0.0, 0.45])
    for seed in range(20):
        counts = np.bincount(particle._drawn(weight, 100, np.random.default_rng(seed)), minlength=4)
        assert np.abs(counts - 100 * weight).max() <= 1.0
        assert counts[2] == 0


def test_kld_asks_for_fewer_where_the_cloud_is_small():
    gains = Gains(particles=5000.0, least=100.0)
    numbers = [particle.enough(k, gains) for k in (1, 2, 10, 100, 10000)]
    assert numbers == sorted(numbers)
    assert numbers[0] < 500
    assert numbers[-1] == 5000
    assert particle.enough(3, Gains(particles=300.0)) == 300
    # Fox's figure: the chi-square quantile with k - 1 degrees of freedom over twice the error
    assert particle.enough(51, gains) == pytest.approx(76.15 / 0.02, rel=0.01)


def test_the_centre_is_that_of_the_heaviest_cluster():
    rng = np.random.default_rng(0)
    near = np.array([1.0, 2.0, 3.1]) + 0.05 * rng.standard_normal((300, 3))
    far = np.array([-3.0, 0.0, 0.0]) + 0.05 * rng.standard_normal((200, 3))
    near[:, 2] = (near[:, 2] + np.pi) % (2.0 * np.pi) - np.pi  # its headings lie on both sides of the seam
    centre = particle.centre(Cloud(np.concatenate([near, far]), np.full(500, 0.002)))
    assert centre == pytest.approx([1.0, 2.0, 3.1], abs=0.03)


def test_it_follows_from_a_guess():
    where = room.load("ellipse")
    drives = simulate.drives(where, motions.constant, 1, seconds=15.0, seed=1)
    cloud = ParticleFilter(where, Gains(particles=500.0))
    cloud.around(drives.truth[0, 0] + [0.2, -0.2, 0.1], np.array([0.3, 0.3, 0.2]))
    off = driven(where, cloud, drives)[50:, :2] - drives.truth[50:, 0, :2]
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.05


def test_it_finds_the_robot_with_many_particles():
    where = room.load("asymmetric")
    drives = simulate.drives(where, motions.constant, 3, seconds=6.0, seed=2)
    found = 0
    for robot in range(3):
        cloud = ParticleFilter(where, Gains(particles=5000.0, least=500.0, width=0.15), seed=robot)
        found += np.hypot(*(driven(where, cloud, drives, robot)[-1] - drives.truth[-1, robot])[:2]) < 0.15
        assert len(cloud.cloud.pose) < 5000
        assert cloud.cloud.weight.sum() == pytest.approx(1.0)
    assert found >= 2


def test_the_same_seed_gives_the_same_numbers():
    where = room.load("ellipse")
    drives = simulate.drives(where, motions.constant, 1, seconds=2.0, seed=3)
    a, b = (driven(where, ParticleFilter(where, Gains(particles=200.0), seed=5), drives) for _ in range(2))
    assert np.array_equal(a, b)


def test_nothing_seen_and_all_outside_leave_finite_weights():
    where = room.load("ellipse")
    cloud = ParticleFilter(where, Gains(particles=50.0))
    pose = cloud.step(Sample(0.1, 0.5, 0.0, 0.1, NONE, NONE, NONE, where.angles))
    assert np.isfinite(pose).all()
    cloud.around(np.array([50.0, 0.0, 0.0]), np.zeros(3))
    pose = cloud.step(Sample(0.1, 0.0, 0.0, 0.0, np.array([1.0, 1.0]), NONE, NONE, where.angles))
    assert pose == pytest.approx([50.0, 0.0, 0.0], abs=1e-6)


def test_bad_settings_are_refused():
    with pytest.raises(InputError, match="want more than 0"):
        ParticleFilter(room.load("ellipse"), Gains(particles=0.0))
