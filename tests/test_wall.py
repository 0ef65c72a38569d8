"""Walls against closed forms: derivatives, lengths, rays, what is inside, symmetry, and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ellipe

from outrider.errors import InputError
from outrider.relocalise import wall
from outrider.relocalise.curve import cross
from outrider.relocalise.wall import (
    circle,
    ellipse,
    polygon,
    rounded_rectangle,
    superellipse,
    support,
    through,
)

TURN = np.linspace(0, 2 * np.pi, 60, endpoint=False)
ROUND = np.stack([4 * np.cos(TURN), 2.5 * np.sin(TURN)], axis=-1)
EGG = support(3.0, ((2, 0.4, 0.0), (3, 0.1, 0.06)))
PENTAGON = polygon(((0, 0), (4, -1), (6, 2), (3, 5), (-1, 3)), radius=0.2, unknown_sides=(2,))
SHAPES = {
    "ellipse": ellipse(4, 2.5, (1, -2), 0.4),
    "circle": circle(2.5, (0.5, 0.5)),
    "superellipse": superellipse(4, 2.5, 4, (0.2, 0.1), 0.3),
    "barely smooth": superellipse(3, 2, 2.5),
    "egg": EGG,
    "rectangle": rounded_rectangle(8, 5, 0.5, (1, 1), -0.7),
    "sharp": rounded_rectangle(8, 5),
    "pentagon": PENTAGON,
    "spline": through(ROUND),
}
each = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES.keys())
bearings = st.floats(-10, 10)


def points_inside(shape, n, seed=0, margin=0.05):
    rng = np.random.default_rng(seed)
    x = shape.centroid + rng.uniform(-1, 1, (20 * n, 2)) * shape.diameter
    return x[shape.inside(x, margin)][:n]


def away_from_breaks(shape, n=97):
    s = np.linspace(0.013, 2 * np.pi, n, endpoint=False)
    far = np.abs(np.mod(s[:, None] - shape.breaks() + 1, 2 * np.pi) - 1)
    return s[np.all(far > 1e-3, axis=1)]


@each
def test_derivatives_agree_with_differences(shape):
    s, h = away_from_breaks(shape), 1e-5
    _, dr, ddr = shape.at(s)
    ahead, behind = shape.at(s + h), shape.at(s - h)
    assert np.allclose((ahead.r - behind.r) / (2 * h), dr, rtol=1e-7, atol=1e-6)
    assert np.allclose((ahead.dr - behind.dr) / (2 * h), ddr, rtol=1e-6, atol=1e-5)


@each
def test_a_wall_is_closed_counter_clockwise_and_convex(shape):
    s = np.linspace(0, 2 * np.pi, 1000)
    r, dr, ddr = shape.at(s)
    assert np.allclose(r[0], r[-1], atol=1e-12)
    assert cross(dr, ddr).min() >= -1e-9
    assert np.hypot(dr[:, 0], dr[:, 1]).min() > 0.1
    assert np.all(cross(dr, shape.centroid - r) > 0.0)


@pytest.mark.parametrize(
    "shape", [SHAPES[k] for k in ("ellipse", "superellipse", "barely smooth", "egg", "spline")]
)
def test_smooth_walls_are_twice_differentiable_everywhere(shape):
    edges = np.concatenate([shape.breaks(), np.arange(8) * np.pi / 4])
    before, after = shape.at(edges - 1e-9), shape.at(edges + 1e-9)
    for left, right in zip(before, after, strict=True):
        assert np.abs(left - right).max() < 2e-3  # power 2.5: the second derivative has an infinite slope
    assert np.abs(before.dr - after.dr).max() < 1e-6


@each
def test_arc_length_is_that_of_a_fine_polyline(shape):
    s = np.sort(np.concatenate([np.linspace(0, 2 * np.pi, 200_001), shape.breaks()]))
    step = np.hypot(*np.diff(shape.at(s).r, axis=0).T)
    assert shape.perimeter == pytest.approx(step.sum(), rel=1e-6)
    some = [10, 77_777, 150_000]
    assert shape.arc_length(s[some]) == pytest.approx(np.cumsum(step)[np.array(some) - 1], abs=1e-4)
    assert shape.arc_length(s[some] + 4 * np.pi) == pytest.approx(
        shape.arc_length(s[some]) + 2 * shape.perimeter
    )


def test_lengths_have_closed_forms():
    assert ellipse(4, 2.5).perimeter == pytest.approx(16 * ellipe(1 - (2.5 / 4) ** 2), rel=1e-13)
    assert circle(3).perimeter == pytest.approx(6 * np.pi, rel=1e-14)
    assert rounded_rectangle(8, 5, 0.5).perimeter == pytest.approx(22 + np.pi, rel=1e-14)
    assert EGG.perimeter == pytest.approx(6 * np.pi, rel=1e-13)  # Cauchy: the mean of the support function
    assert superellipse(4, 2.5, 2).perimeter == pytest.approx(ellipse(4, 2.5).perimeter, rel=1e-12)
    assert rounded_rectangle(3, 4).diameter == pytest.approx(5, rel=1e-12)
    assert ellipse(4, 2.5, turn=0.1).diameter == pytest.approx(8, rel=1e-4)


@each
def test_a_ray_ends_on_the_wall_and_on_its_line(shape):
    x = points_inside(shape, 40)[:, None]
    bearing = np.linspace(-4, 9, 53)
    hit = shape.ray(x, bearing)
    e = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    assert np.abs(shape.at(hit.s).r - (x + hit.range[..., None] * e)).max() < 1e-9
    assert np.all((hit.range > 0) & (hit.s >= 0) & (hit.s < 2 * np.pi))
    assert np.all(cross(e, shape.at(hit.s).dr) > -1e-9)


def test_rays_agree_with_closed_forms():
    rng = np.random.default_rng(1)
    bearing = rng.uniform(-np.pi, np.pi, 500)
    e = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    x = points_inside(rounded_rectangle(8, 5), 500, margin=1e-3)
    with np.errstate(divide="ignore"):
        box = np.min((np.sign(e) * (4, 2.5) - x) / e, axis=-1)
    assert np.abs(rounded_rectangle(8, 5).ray(x, bearing).range - box).max() < 1e-9
    x = points_inside(circle(3), 500, margin=1e-3)
    along = np.sum(x * e, axis=-1)
    chord = np.sqrt(along**2 + 9 - np.sum(x * x, axis=-1)) - along
    assert np.abs(circle(3).ray(x, bearing).range - chord).max() < 1e-9


def test_the_general_ray_agrees_with_the_closed_form_of_an_ellipse():
    closed, general = ellipse(4, 2.5, (1, -2), 0.4), superellipse(4, 2.5, 2.0, (1, -2), 0.4)
    x = points_inside(closed, 60, margin=1e-6)[:, None]
    bearing = np.linspace(-3, 3, 71)
    assert np.abs(closed.ray(x, bearing).range - general.ray(x, bearing).range).max() < 1e-9


@pytest.mark.parametrize("name", ["superellipse", "egg", "rectangle", "sharp", "pentagon", "spline"])
@pytest.mark.parametrize("gap", [1e-3, 1e-5, 1e-7])
def test_rays_from_close_to_the_wall_stay_exact(name, gap):
    shape = SHAPES[name]
    s = away_from_breaks(shape, 41)
    r, dr, _ = shape.at(s)
    inward = np.stack([-dr[:, 1], dr[:, 0]], axis=-1) / np.hypot(dr[:, 0], dr[:, 1])[:, None]
    x = (r + gap * inward)[:, None]
    bearing = np.linspace(0, 2 * np.pi, 37)
    hit = shape.ray(x, bearing)
    assert np.isfinite(hit.range).all()
    e = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    assert np.abs(shape.at(hit.s).r - (x + hit.range[..., None] * e)).max() < 1e-9
    assert np.allclose(shape.distance(x[:, 0]), gap, rtol=1e-6, atol=1e-12)


@each
@given(bearing=bearings)
def test_two_opposite_rays_make_a_chord(shape, bearing):
    x = points_inside(shape, 1, seed=3)[0]
    there, back = shape.ray(x, bearing), shape.ray(x, bearing + np.pi)
    chord = np.hypot(*(shape.at(there.s).r - shape.at(back.s).r))
    assert there.range + back.range == pytest.approx(chord, abs=1e-9)
    assert chord <= shape.diameter * (1 + 1e-4)


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 3), bearings)
def test_turning_and_moving_the_room_changes_no_range(dx, dy, turn, bearing):
    still, moved = superellipse(4, 2.5, 3), superellipse(4, 2.5, 3, (dx, dy), turn)
    x = np.array([1.3, -0.4])
    c, s = np.cos(turn), np.sin(turn)
    there = np.array([c * x[0] - s * x[1] + dx, s * x[0] + c * x[1] + dy])
    assert moved.ray(there, bearing + turn).range == pytest.approx(still.ray(x, bearing).range, abs=1e-9)


@each
def test_outside_there_is_no_range(shape):
    out = shape.at(0.3).r + 1e-6 * (shape.at(0.3).r - shape.centroid)
    x = np.stack([out, shape.centroid, [np.nan, 0.0], [1e6, 1e6]])
    hit = shape.ray(x, np.array([0.0, np.nan, 0.0, 0.0]))
    assert np.isnan(hit.range).all()
    assert np.isnan(hit.s).all()
    assert shape.inside(x).tolist() == [False, True, False, False]
    assert not shape.known(hit.s).any()


@each
def test_the_distance_to_the_wall_is_that_of_its_nearest_point(shape):
    rng = np.random.default_rng(2)
    x = shape.centroid + rng.uniform(-0.8, 0.8, (50, 2)) * shape.diameter
    fine = shape.at(np.concatenate([np.linspace(0, 2 * np.pi, 20_001), shape.breaks()])).r
    near, found = np.hypot(*np.moveaxis(x[:, None] - fine, -1, 0)).min(axis=-1), np.abs(shape.distance(x))
    assert np.all(found <= near + 1e-12)
    assert np.all(near <= np.hypot(found, 6 * shape.perimeter / 20_000))  # corners outside: less exact
    assert np.array_equal(shape.distance(x) > 0, shape.inside(x))
    assert np.array_equal(shape.inside(x, 0.5), shape.distance(x) > 0.5)


@pytest.mark.parametrize(
    ("shape", "order"),
    [
        (ellipse(4, 2.5, (3, 1), 0.2), 2),
        (ellipse(3, 3), 0),
        (circle(2, (1, 1)), 0),
        (superellipse(3, 3, 4, turn=0.3), 4),
        (support(3, ((3, 0.2, 0.1),)), 3),
        (support(3, ((2, 0.2, 0.0), (4, 0.05, 0.0))), 2),
        (support(3, ((1, 0.7, 0.3),)), 0),  # a circle that stands beside its origin
        (EGG, 1),
        (rounded_rectangle(8, 5, 0.3), 2),
        (rounded_rectangle(5, 5), 4),
        (
            polygon(((-4, -2), (4, -2), (4, 2), (-4, 2)), unknown_sides=(0,)),
            1,
        ),  # the gap tells which end it is
        (polygon(((-4, -2), (4, -2), (4, 2), (-4, 2)), unknown_sides=(0, 2)), 2),
        (PENTAGON, 1),
        (through(ROUND), 2),
    ],
)
def test_symmetry(shape, order):
    assert shape.symmetry == order


@pytest.mark.parametrize(
    "shape", [SHAPES["ellipse"], SHAPES["rectangle"], support(3, ((3, 0.2, 0.1),), (1, 2))]
)
def test_no_range_tells_a_pose_from_its_twins(shape):
    pose = np.append(shape.centroid + np.array([0.7, -0.3]), 3.0)
    bearing = np.linspace(0, 6, 11)
    ranges = shape.ray(pose[:2], pose[2] + bearing).range
    for k in range(shape.symmetry):
        twin = shape.turned(pose, k)
        assert shape.ray(twin[:2], twin[2] + bearing).range == pytest.approx(ranges, abs=1e-9)
        assert -np.pi <= twin[2] < np.pi
    assert shape.turned(pose, 0) == pytest.approx(pose)
    with pytest.raises(InputError, match="circle"):
        circle(1).turned(pose, 1)


def test_unknown_sides_predict_nothing():
    room = polygon(((-4, -2), (4, -2), (4, 2), (-4, 2)), radius=0.5, unknown_sides=(0,))
    hit = room.ray(np.zeros(2), np.deg2rad([-90, 0, 90, 180, -26.5]))
    assert room.known(hit.s).tolist() == [
        False,
        True,
        True,
        True,
        False,
    ]  # the last ends in a corner beside it
    turned_round = polygon(((-4, 2), (4, 2), (4, -2), (-4, -2)), radius=0.5, unknown_sides=(2,))
    again = turned_round.ray(np.zeros(2), np.deg2rad([-90, 0, 90, 180, -26.5]))
    assert turned_round.known(again.s).tolist() == room.known(hit.s).tolist()
    assert again.range == pytest.approx(hit.range)
    assert ellipse(2, 1).known(np.array([0.0, 7.0])).all()


def test_points_may_come_clockwise_or_closed():
    x, bearing = np.array([0.5, 0.2]), np.linspace(0, 6, 9)
    there = through(ROUND).ray(x, bearing).range
    assert through(ROUND[::-1]).ray(x, bearing).range == pytest.approx(there, abs=1e-12)
    assert through(np.vstack([ROUND, ROUND[:1]])).ray(x, bearing).range == pytest.approx(there, abs=1e-12)
    assert np.abs(there - ellipse(4, 2.5).ray(x, bearing).range).max() < 1e-5


def test_shapes_are_values():
    assert ellipse(4, 2.5) == ellipse(4.0, 2.5)
    assert ellipse(4, 2.5) != ellipse(4, 2.4)
    assert EGG.name == "support"
    with pytest.raises(AttributeError):
        EGG.radius_m = 2.0
    with pytest.raises(NotImplementedError):
        wall.Wall().at(0.0)


SQUARE = ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: ellipse(4, -1), "half_axes_m has -1; want lengths above 0"),
        (lambda: ellipse(np.nan, 1), "half_axes_m has nan"),
        (lambda: circle(0), "radius_m has 0; want lengths above 0"),
        (lambda: superellipse(4, 2, 1.5), "power = 1.5; want 2 "),
        (lambda: superellipse(4, 0, 3), "half_axes_m has 0"),
        (lambda: support(3, ((2, 1.1, 0.0),)), "harmonics_m bend it the wrong way"),
        (lambda: support(3, ((0, 0.1, 0.0),)), "harmonics_m has a wrong term"),
        (lambda: ellipse(2, 1, (np.nan, 0)), "centre_m or turn_deg is no finite number"),
        (lambda: support(-3, ()), "radius_m has -3"),
        (lambda: rounded_rectangle(8, 0), "length_m, width_m has 0"),
        (lambda: rounded_rectangle(8, 5, 2.6), "corner_radius_m = 2.6 is too large for side"),
        (lambda: rounded_rectangle(8, 5, -1), "corner_radius_m = -1; want 0 or more"),
        (lambda: polygon(SQUARE, unknown_sides=(4,)), "unknown_sides has 4; want 0 to 3"),
        (lambda: polygon(SQUARE[:2]), "corners_m has 2 different points; want 3 or more"),
        (lambda: polygon((*SQUARE, (0.5, 1.0))), r"corners_m is not convex at \(0.5, 1\) m"),
        (lambda: polygon((*SQUARE[::-1], (1.0, 0.5))), r"corners_m is not convex at \(1, 0.5\) m"),
        (lambda: polygon([SQUARE[i] for i in (0, 2, 1, 3)]), "crosses itself between points 0-1 and 2-3"),
        (lambda: polygon((SQUARE[0], *SQUARE)), "point 0 twice in a row"),
        (lambda: polygon(((0, 0), (1, np.inf), (1, 1))), "no finite number"),
        (lambda: polygon(((0, 0), (1, 0), (2, 0))), "no area"),
        (lambda: through(ROUND[:3]), "points_m has 3 different points; want 4 or more"),
        (lambda: through(ROUND[:30]), r"points_m is open: its ends are 7\.\d+ m apart"),
        (lambda: through(ROUND * (1 + 0.2 * np.cos(5 * TURN))[:, None]), "points_m is not convex at"),
        (lambda: through(ROUND[np.r_[0:20, 40:20:-1, 41:60]]), "crosses itself"),
        (
            lambda: through(rounded_rectangle(4, 3).at(TURN).r),
            "the curve through points_m is not convex near",
        ),
    ],
)
def test_what_is_no_wall_is_refused_in_one_line(make, said):
    with pytest.raises(InputError, match=said) as refused:
        make()
    assert "\n" not in str(refused.value)
    assert "want" in str(refused.value)


@pytest.mark.parametrize("turns", [2, 3])
def test_a_wall_that_runs_round_twice_crosses_itself(turns):
    angle = np.linspace(0, 2 * np.pi * turns, 5 * turns + 1, endpoint=False)
    star = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    with pytest.raises(InputError, match="crosses itself"):
        polygon(star)
