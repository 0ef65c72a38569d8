"""What is said of a pose before it is trusted: figures of theory, exact cases, words and reasons."""

import numpy as np
import pytest

from made_circling import ANGLES, ELLIPSE, drive, twist
from outrider.relocalise import observability, simulate, wall
from outrider.relocalise import room as rooms
from outrider.relocalise.observability import REASONS, WORDS
from outrider.relocalise.room import Room

CIRCLE = Room(wall.circle(3.0), ANGLES)
BOX = rooms.load("rectangle")
MOTION = twist()


def median(room, motion=MOTION, angles=None, n=2000):
    """Median and 5 % quantile of sigma over random poses, 30 cm from the wall and more."""
    poses = simulate.anywhere(room, n, np.random.default_rng(0), 0.3)
    sigma = observability.sigma_min(room, poses, motion, angles)
    return np.median(sigma), np.quantile(sigma, 0.05)


def reason(room, pose, motion):
    found = observability.assess(room, np.array([pose], float), motion)
    return REASONS[found.reason[0]], WORDS[found.verdict[0]], found


@pytest.mark.parametrize(
    ("half_axes", "wanted"), [((3.05, 3.0), 1.7e-2), ((3.3, 3.0), 9.5e-2), ((4.0, 2.5), 0.40)]
)
def test_medians_of_ellipses(half_axes, wanted):
    assert median(Room(wall.ellipse(*half_axes), ANGLES))[0] == pytest.approx(wanted, rel=0.1)


@pytest.mark.parametrize(
    ("degrees", "middle", "low"),
    [
        ((90, -90), 0.42, 0.12),
        ((0, 180), 0.43, 0.16),
        ((60, -60), 0.39, 0.06),
        ((30, -30), 0.22, 0.009),
        ((20, 50), 0.07, 0.001),
        ((0, 90), 0.29, 0.018),
    ],
)
def test_where_the_sensors_should_look(degrees, middle, low):
    found = median(ELLIPSE, angles=np.radians(degrees))
    assert found[0] == pytest.approx(middle, rel=0.15)
    assert low / 2.0 < found[1] < low * 2.0


def test_a_circle_is_unobservable():
    poses = simulate.anywhere(CIRCLE, 300, np.random.default_rng(0))
    assert observability.sigma_min(CIRCLE, poses, twist()).max() < 1e-12
    found = observability.assess(CIRCLE, poses, twist())
    assert {REASONS[k][:22] for k in found.reason} == {"the wall is a circle: "}
    said = observability.summary(CIRCLE, found)
    assert (said.word, said.poses, said.unobservable) == ("unobservable", 0, 1.0)


def test_sigma_has_no_unit():
    """A room twice as large, a robot twice or a tenth as fast, a world that is turned: the same figure."""
    poses = simulate.anywhere(ELLIPSE, 50, np.random.default_rng(1))
    sigma = observability.sigma_min(ELLIPSE, poses, twist())
    np.testing.assert_allclose(observability.sigma_min(ELLIPSE, poses, twist(0.05, 0.05)), sigma, rtol=1e-9)
    large = Room(wall.ellipse(8.0, 5.0), ANGLES)
    double = observability.sigma_min(large, poses * [2.0, 2.0, 1.0], twist(1.0, 0.5))
    np.testing.assert_allclose(double, sigma, rtol=1e-9)
    c, s = np.cos(0.7), np.sin(0.7)
    moved = np.column_stack([poses[:, :2] @ np.array([[c, s], [-s, c]]) + [1.0, 2.0], poses[:, 2] + 0.7])
    other = Room(wall.ellipse(4.0, 2.5, (1.0, 2.0), 0.7), ANGLES)
    np.testing.assert_allclose(observability.sigma_min(other, moved, twist()), sigma, rtol=1e-7)


def test_sigma_vanishes_where_both_crossings_do():
    """Where dz has rank 2, sigma is small with (c1 D1, c2 D2) and not otherwise, within 0.05 and 10."""
    poses = simulate.anywhere(ELLIPSE, 4000, np.random.default_rng(2))
    found = observability.assess(ELLIPSE, poses, twist())
    crossing = np.linalg.norm(found.crossing, axis=-1)
    clear = found.gap > 0.2
    ratio = found.sigma[clear] / crossing[clear]
    assert found.sigma[clear].min() < 0.01
    assert ratio.max() < 10.0
    assert ratio.min() > 0.05


def test_standing_still():
    why, word, found = reason(ELLIPSE, [1.0, 0.5, 0.3], (0.0, 0.0, 0.0))
    assert word == "unobservable"
    assert "stands still" in why
    assert found.sigma[0] == 0.0


def test_parallel_straight_walls():
    """Along a corridor nothing changes; towards a corner it does."""
    why, word, found = reason(BOX, [0.0, 0.0, 0.0], (0.5, 0.0, 0.0))
    assert (word, found.sigma[0] < 1e-12) == ("unobservable", True)
    assert "parallel straight walls" in why
    why, word, _ = reason(BOX, [2.9, 1.0, 0.5], (0.5, 0.0, 0.3))
    assert (why, word) == ("", "good")


def test_square_to_the_chord():
    """Both ends of the minor axis: H1 and H3 fail, but dF makes up for it; without H2 it cannot."""
    room = ELLIPSE._replace(angles=np.radians([90.0, -90.0]))
    for motion in (twist(), (0.5, 0.0, 0.0), (0.0, 0.0, 1.0)):
        why, word, found = reason(room, [0.0, 0.4, 0.0], motion)
        assert (why, word) == ("", "good")
        assert found.gap[0] < 1e-12
        assert np.abs(found.crossing).max() < 1e-12
        assert found.sigma[0] > 0.1
    why, word, found = reason(room, [0.0, 1.5, 0.0], twist())  # w = v / rho_1: the first end stands still
    assert word == "unobservable"
    assert why.startswith("H1")
    assert found.sweep[0, 0] == pytest.approx(0.0, abs=1e-12)


def test_neither_end_moves():
    """Straight on with both sensors along the way: only the range ahead and behind change, by v."""
    room = ELLIPSE._replace(angles=np.radians([0.0, 180.0]))
    why, word, found = reason(room, [1.0, 0.5, 0.4], (0.5, 0.0, 0.0))
    assert word == "unobservable"
    assert why.startswith("H2")
    np.testing.assert_allclose(found.sweep, 0.0, atol=1e-15)


def test_the_pose_of_the_errata():
    why, word, found = reason(ELLIPSE, [0.17284, -1.75619, -3.16946], twist())
    assert word != "good"
    assert why.startswith("H3")
    assert found.gap[0] > 0.1
    assert np.abs(found.crossing).max() < 1e-5


def test_an_unknown_side_is_not_trusted():
    corners = np.array([[-4.0, -2.5], [4.0, -2.5], [4.0, 2.5], [-4.0, 2.5]])
    room = Room(wall.polygon(corners, 0.3, (0,)), np.radians([90.0, -90.0]))
    why, word, found = reason(room, [0.5, 0.5, 0.1], twist())
    assert (word, found.sigma[0]) == ("unobservable", 0.0)
    assert "not known" in why


def test_outside():
    why, _, found = reason(ELLIPSE, [5.0, 0.0, 0.0], twist())
    assert why == "outside the wall"
    assert np.isnan(found.sigma[0])
    nowhere = observability.summary(ELLIPSE, found)
    assert np.isnan(nowhere.median)
    assert nowhere.word == "unobservable"


def test_shapes_broadcast():
    """One pose, a grid of poses and headings, twists per pose: the same figures."""
    poses = simulate.anywhere(ELLIPSE, 12, np.random.default_rng(3))
    v, w = np.linspace(0.1, 0.5, 12), np.linspace(-0.5, 0.4, 12)
    flat = observability.sigma_min(ELLIPSE, poses, (v, 0.0 * v, w))
    grid = (4, 3)
    folded = observability.sigma_min(
        ELLIPSE, poses.reshape(*grid, 3), (v.reshape(grid), 0.0, w.reshape(grid))
    )
    np.testing.assert_allclose(folded.ravel(), flat, rtol=1e-12)
    for k in range(12):
        one = observability.sigma_min(ELLIPSE, poses[k], (v[k], 0.0, w[k]))
        assert one.shape == ()
        assert one == pytest.approx(flat[k], rel=1e-12)


def test_along_a_path():
    """The base run: an ellipse leaves two poses for ever, and says that H1 may fail for so long a reach."""
    truth = drive(seconds=12.0, rate=10.0).truth[:, 0]
    said = observability.summary(ELLIPSE, observability.assess(ELLIPSE, truth, twist()))
    assert (said.word, said.poses) == ("good", 2)
    assert 0.0 < said.least < said.median < 1.0
    assert said.width == pytest.approx(5.0, abs=1e-4)
    assert said.chord > said.width
    assert observability.narrowest(CIRCLE.wall) == pytest.approx(6.0, abs=1e-4)


def test_a_map():
    found = observability.over(ELLIPSE, (0.0, 0.0, 0.5), spacing=0.5, headings=12)
    assert found.least.shape == found.median.shape == (len(found.y), len(found.x))
    x, y = np.meshgrid(found.x, found.y)
    inside = (x / 4.0) ** 2 + (y / 2.5) ** 2 < 1.0
    np.testing.assert_array_equal(np.isfinite(found.least), inside)
    assert (found.least[inside] <= found.median[inside]).all()
    k, m = 3, 9
    theta = np.arange(12) * np.pi / 6.0
    poses = np.column_stack([np.full(12, found.x[m]), np.full(12, found.y[k]), theta])
    sigma = observability.sigma_min(ELLIPSE, poses, (0.0, 0.0, 0.5))
    assert found.least[k, m] == pytest.approx(sigma.min(), rel=1e-12)
    assert found.median[k, m] == pytest.approx(np.median(sigma), rel=1e-12)
