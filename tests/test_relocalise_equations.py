"""[UNI] eq. 13 to 26: golden values, differentiation, and what the errata say of the paper."""

import numpy as np
import pytest
from scipy.optimize import fsolve

from made_circling import ANGLES, ELLIPSE, OFF, START, twist
from outrider.relocalise import equations as eq
from outrider.relocalise import simulate, wall
from outrider.relocalise.room import Room

EGG = wall.support(3.0, [(2, 0.4, 0.0), (3, 0.1, 0.06)])
TURN = np.linspace(0.0, 2.0 * np.pi, 14, endpoint=False)
SPLINE = wall.through(np.column_stack([3.0 * np.cos(TURN) + 0.2 * np.cos(2.0 * TURN), 2.4 * np.sin(TURN)]))
every_wall = pytest.mark.parametrize("curve", [ELLIPSE.wall, EGG, SPLINE], ids=["ellipse", "egg", "spline"])


def places(curve, n=200, seed=1):
    """Random true scenes: pose, angles, twist with a sideways part, configuration p, scene, rates."""
    rng = np.random.default_rng(seed)
    angles = np.array([1.1, -0.8])
    pose = simulate.anywhere(Room(curve, angles), n, rng, 0.3)
    motion = eq.Twist(*rng.uniform(-1.0, 1.0, (3, n)))
    hit = curve.ray(pose[:, None, :2], pose[:, 2:] + angles)
    p = np.column_stack([hit.s, pose[:, 2]])
    at = eq.scene(curve, p, angles, hit.range, motion)
    return pose, angles, motion, p, at, eq.rates(at)


def base():
    hit = ELLIPSE.wall.ray(START[:2], START[2] + ANGLES)
    p = np.array([*hit.s, START[2]])
    return p, eq.scene(ELLIPSE.wall, p, ANGLES, hit.range, twist())


def test_golden_values():
    p, at = base()
    rates = eq.rates(at)
    both = np.vstack([eq.gap_slope(at), eq.mismatch_slope(at, rates)])
    off = eq.scene(ELLIPSE.wall, p + OFF, ANGLES, at.ranges, twist())
    for found, wanted in (
        (p, [0.97285007, 5.45913057, 0.3]),
        (at.ranges, [2.93940805, 1.52264138]),
        (rates, [-0.06256609, 0.11836681]),
        (eq.flow(at), [0.29320317, 0.36853636]),
        (at.den, [3.53574393, 3.24074778]),
        (eq.transversality(at), [73.22844610, 41.80635097]),
        (eq.gap_slope(at), [[-3.30597401, -2.93562416, 3.90099886], [1.40736565, -1.69812750, 0.46521897]]),
        (eq.mismatch_slope(at, rates), [[2.93203168, 0, -3.78529459], [0, 3.68536360, -4.23873062]]),
        (eq.gap(off), [0.86524104, 0.99841871]),
        (eq.mismatch(off, rates), [-0.35705355, -2.21570312]),
    ):
        np.testing.assert_allclose(found, wanted, atol=1e-7, rtol=0.0)
    np.testing.assert_allclose(np.linalg.svd(both)[1], [8.75159, 3.97347, 1.39323], atol=1e-5)


@every_wall
def test_flow_and_rates_are_those_of_a_moving_robot(curve):
    """Eq. 13 and 14 against rays cast a moment before and after, also with a sideways velocity."""
    pose, angles, motion, _, at, rates = places(curve)
    h = 1e-5
    V = at.velocity[:, 0]

    def seen(dt):
        moved = pose + dt * np.column_stack([V, motion.w])
        return curve.ray(moved[:, None, :2], moved[:, 2:] + angles)

    before, after = seen(-h), seen(h)
    np.testing.assert_allclose((after.range - before.range) / (2 * h), rates, atol=2e-7)
    ends = (curve.at(after.s).r - curve.at(before.s).r) / (2 * h)
    np.testing.assert_allclose(ends, at.dr * eq.flow(at)[..., None], atol=1e-6)
    assert (at.den > 0.0).all()


@every_wall
def test_slopes_against_differences(curve):
    """dz/dp and eq. 23 at wrong configurations, ranges and measured rates held."""
    _, angles, motion, p, at, rates = places(curve)
    p = p + np.random.default_rng(2).uniform(-0.4, 0.4, p.shape)
    h = 1e-6

    def both(step):
        there = eq.scene(curve, p + step, angles, at.ranges, motion)
        return np.concatenate([eq.gap(there), eq.mismatch(there, rates)], axis=-1)

    steps = h * np.eye(3)
    numeric = np.stack([(both(step) - both(-step)) / (2 * h) for step in steps], axis=-1)
    there = eq.scene(curve, p, angles, at.ranges, motion)
    exact = np.concatenate([eq.gap_slope(there), eq.mismatch_slope(there, rates)], axis=-2)
    np.testing.assert_allclose(exact, numeric, atol=2e-6)


@every_wall
def test_kernels_and_transversality(curve):
    """Eq. 19, 24, 25 and 26, and that the two unseen directions are unseen."""
    pose, _, _, _, at, rates = places(curve)
    np.testing.assert_allclose(eq.positions(at), np.broadcast_to(pose[:, None, :2], at.r.shape), atol=1e-9)
    np.testing.assert_allclose(eq.gap_slope(at) @ eq.gap_kernel(at)[..., None], 0.0, atol=1e-10)
    slope = eq.mismatch_slope(at, rates)
    np.testing.assert_allclose(slope @ eq.mismatch_kernel(at, rates)[..., None], 0.0, atol=1e-9)
    along = eq.sweep(at)[..., None] * at.dr
    np.testing.assert_allclose(eq.turned(eq.pull(at, rates)), along, atol=1e-11)
    crossing = (slope @ eq.gap_kernel(at)[..., None])[..., 0]
    np.testing.assert_allclose(crossing, eq.sweep(at) * eq.transversality(at), rtol=1e-8, atol=1e-8)


@every_wall
def test_mismatch_is_a_range_rate_innovation(curve):
    """F_i = den_i (measured rate - eq. 14), for any p; so with eq. 14 as the measured rate F is 0."""
    _, angles, motion, p, at, rates = places(curve)
    wrong = eq.scene(curve, p + OFF, angles, at.ranges, motion)
    usable = (wrong.den > 0.1).all(axis=-1)
    innovation = wrong.den * (rates - eq.rates(wrong))
    np.testing.assert_allclose(eq.mismatch(wrong, rates)[usable], innovation[usable], atol=1e-11)
    assert np.abs(eq.mismatch(wrong, eq.rates(wrong))[usable]).max() < 1e-12
    assert np.abs(eq.mismatch(wrong, rates)[usable]).max() > 1.0


def test_one_end_may_stand_still_but_not_both():
    """H2 cannot fail for both sensors on different sides, but for one it can: w = v sin(phi) / rho."""
    p, at = base()
    w = 0.5 * np.sin(ANGLES[0]) / at.ranges[0]
    found = eq.sweep(eq.scene(ELLIPSE.wall, p, ANGLES, at.ranges, twist(0.5, w)))
    assert abs(found[0]) < 1e-15
    assert abs(found[1]) > 0.1


def test_an_exactly_unobservable_pose_with_one_end_moving():
    """c_1 = 0 and D_2 = 0 next to the pose of the errata: rank 2, though H2 and H3 name neither alone."""

    def scene(pose):
        hit = ELLIPSE.wall.ray(pose[:2], pose[2] + ANGLES)
        return eq.scene(ELLIPSE.wall, np.array([*hit.s, pose[2]]), ANGLES, hit.range, twist())

    def zeros(x):
        at = scene(np.array([*x, -3.16946]))
        return eq.sweep(at)[0], eq.transversality(at)[1] / 100.0

    x = fsolve(zeros, [0.17284, -1.75619], xtol=1e-14)
    np.testing.assert_allclose(x, [0.17284, -1.75619], atol=2e-5)
    at = scene(np.array([*x, -3.16946]))
    both = np.vstack([eq.gap_slope(at), eq.mismatch_slope(at, eq.rates(at))])
    assert np.linalg.svd(both)[1][2] < 1e-12
    assert eq.transversality(at)[0] == pytest.approx(89.0, abs=0.5)
    assert abs(eq.sweep(at)[1]) > 0.1
    assert np.linalg.matrix_rank(eq.gap_slope(at)) == 2


@pytest.mark.parametrize(
    ("apart", "wanted"), [(30, 1.0), (60, 1.0), (90, 1.41421), (120, 1.73205), (240, 1.73205)]
)
def test_longest_chord_is_what_rays_reach(apart, wanted):
    """Against all pairs of ranges on a grid; the paper's formula gives 0 for sensors at +-apart / 2."""
    angles = np.radians([0.5 * apart, -0.5 * apart])
    a, b = np.meshgrid(np.linspace(0.0, 1.0, 201), np.linspace(0.0, 1.0, 201))
    longest = np.sqrt(np.maximum(a**2 + b**2 - 2.0 * a * b * np.cos(angles[0] - angles[1]), 0.0)).max()
    assert eq.longest_chord(1.0, angles) == pytest.approx(longest, abs=1e-9)
    assert longest == pytest.approx(wanted, abs=1e-5)
