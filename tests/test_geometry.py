"""Angles, poses and rectangles: the laws they obey, for any numbers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from outrider.geometry import (
    compose,
    corners,
    interpolate_poses,
    invert,
    rotate,
    transform,
    wrap,
    wrap_axis,
)

angles = st.floats(-50.0, 50.0)
metres = st.floats(-200.0, 200.0)
points = st.tuples(metres, metres).map(np.array)
poses = st.tuples(metres, metres, st.floats(-7.0, 7.0)).map(np.array)
extents = st.tuples(st.floats(0.1, 20.0), st.floats(0.1, 5.0)).map(np.array)


def close(a, b, atol=1e-9):
    np.testing.assert_allclose(a, b, rtol=0.0, atol=atol)


def same_pose(a, b):
    close(a[..., :2], b[..., :2])
    close(wrap(a[..., 2] - b[..., 2]), 0.0)


@given(angles)
def test_wrap_keeps_the_direction_and_lands_in_its_interval(angle):
    folded = wrap(angle)
    assert -np.pi <= folded < np.pi
    close([np.cos(folded), np.sin(folded)], [np.cos(angle), np.sin(angle)])


@given(angles, st.integers(-5, 5))
def test_an_axis_does_not_know_front_from_rear(angle, halves):
    folded = wrap_axis(angle)
    assert -0.5 * np.pi <= folded < 0.5 * np.pi
    close(np.sin(wrap_axis(angle + halves * np.pi) - folded), 0.0)


@pytest.mark.parametrize(
    ("angle", "folded"), [(np.pi, -np.pi), (-np.pi, -np.pi), (0.0, 0.0), (1.5 * np.pi, -0.5 * np.pi)]
)
def test_wrap_at_its_ends(angle, folded):
    close(wrap(angle), folded)


@given(points, angles, angles)
def test_turns_add_up(p, a, b):
    close(rotate(rotate(p, a), b), rotate(p, a + b))


@given(points, points, angles)
def test_turning_keeps_lengths_and_angles(p, q, angle):
    close(rotate(p, angle) @ rotate(q, angle), p @ q, atol=1e-6)


def test_a_quarter_turn_takes_x_to_y():
    close(rotate(np.array([1.0, 0.0]), np.pi / 2), [0.0, 1.0])


@given(poses)
def test_a_pose_and_its_inverse_cancel(pose):
    same_pose(compose(pose, invert(pose)), np.zeros(3))
    same_pose(compose(invert(pose), pose), np.zeros(3))


@given(poses, poses, poses)
def test_composition_does_not_care_for_brackets(a, b, c):
    same_pose(compose(compose(a, b), c), compose(a, compose(b, c)))


@given(poses, poses, points)
def test_composing_poses_is_transforming_twice(a, b, p):
    close(transform(compose(a, b), p), transform(a, transform(b, p)))


@given(st.lists(poses, min_size=1, max_size=5), points)
def test_many_poses_at_once_equal_one_by_one(rows, p):
    stack = np.stack(rows)
    close(transform(stack, np.broadcast_to(p, (len(rows), 2))), np.stack([transform(row, p) for row in rows]))
    close(invert(stack), np.stack([invert(row) for row in rows]))


@given(poses, extents)
def test_corners_are_a_rectangle_about_the_pose(pose, extent):
    box = corners(pose, extent)
    close(box.mean(axis=0), pose[:2])
    sides = np.diff(np.vstack([box, box[:1]]), axis=0)
    close(np.hypot(*sides.T), [extent[0], extent[1], extent[0], extent[1]])
    x, y = box.T
    area = 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1))  # positive: counter-clockwise
    close(area, extent[0] * extent[1], atol=1e-6)


def test_corners_begin_at_the_front_left():
    close(corners(np.array([1.0, 2.0, 0.0]), np.array([4.0, 2.0])), [[3, 3], [-1, 3], [-1, 1], [3, 1]])


@given(poses, poses, extents)
def test_moving_the_world_moves_the_corners_with_it(world, pose, extent):
    close(corners(compose(world, pose), extent), transform(world, corners(pose, extent)))


@given(poses, poses, st.floats(0.0, 1.0))
def test_interpolation_meets_its_rows_and_turns_the_short_way(a, b, share):
    t = np.array([10.0, 12.0])
    found = interpolate_poses(t, np.stack([a, b]), np.array([10.0, 12.0, 10.0 + 2.0 * share, 9.0, 99.0]))
    same_pose(found[0], a)
    same_pose(found[1], b)
    same_pose(found[3], a)
    same_pose(found[4], b)
    close(found[2, :2], a[:2] + share * (b[:2] - a[:2]))
    turn = wrap(b[2] - a[2])
    if abs(abs(turn) - np.pi) > 1e-6:  # at half a turn both ways are as short
        close(wrap(found[2, 2] - a[2] - share * turn), 0.0)


def test_one_pose_is_held():
    found = interpolate_poses(np.array([5.0]), np.array([[1.0, 2.0, 0.5]]), np.array([0.0, 5.0, 9.0]))
    close(found, [[1.0, 2.0, 0.5]] * 3)
