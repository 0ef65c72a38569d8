"""Times to collision against closed forms, symmetries and a dense reference made with shapely."""

import dataclasses

import numpy as np
import pytest
import shapely
from hypothesis import example, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from outrider import settings
from outrider.contact import gap
from outrider.errors import InputError
from outrider.geometry import compose, corners, rotate
from outrider.records import Ego, Tracks, TrackState
from outrider.threat import assess, predict_arc

CAR = (4.0, 2.0)
RIDER = settings.Rider(length_m=1.2, width_m=0.6, margin_m=0.3)  # 1.8 x 1.2 m with its margin
FRONT, SIDE = 0.9, 0.6
THREAT = settings.Threat()


def tracks(*rows, extent=CAR, state=TrackState.CONFIRMED, bound=(np.inf, np.inf)):
    """Tracks from rows x, y, course, speed, acceleration, yaw_rate, slip; what is left out is 0."""
    table = np.zeros((len(rows), 7))
    for i, row in enumerate(rows):
        table[i, : len(row)] = row
    x, y, course, speed, acceleration, yaw_rate, slip = table.T
    n = len(rows)
    return Tracks(
        t=12.5,
        id=np.arange(n) + 7,
        state=np.full(n, state, np.uint8),
        W_p=np.column_stack([x, y]),
        speed=speed,
        acceleration=acceleration,
        course=course,
        yaw=course - slip,
        slip=slip,
        yaw_rate=yaw_rate,
        extent=np.tile(np.asarray(extent, float), (n, 1)),
        cov=np.tile(0.01 * np.eye(2), (n, 1, 1)),
        hits=np.full(n, 9),
        age=np.full(n, 2.0),
        bound=np.tile(np.asarray(bound, float), (n, 1)),
        broken=np.zeros(n, np.bool_),
    )


def ego(speed=0.0, yaw_rate=0.0, pose=(0.0, 0.0, 0.0)):
    yaw = pose[2]
    W_v = speed * np.array([np.cos(yaw), np.sin(yaw)])
    return Ego(12.5, np.array(pose, float), W_v, yaw_rate, True)


def one(row, rider_speed=0.0, yaw_rate=0.0, threat=THREAT, rider=RIDER, **more):
    return assess(tracks(row, **more), ego(rider_speed, yaw_rate), rider, threat)


# ------------------------------------------------------------------ closed forms


@pytest.mark.parametrize(("rider", "car", "x"), [(0.0, 10.0, 30.0), (5.0, 10.0, 40.0), (6.0, 0.0, 20.0)])
def test_head_on_is_gap_over_closing_speed(rider, car, x):
    threats = one((x, 0.0, np.pi, car), rider)
    gap_now = x - 0.5 * CAR[0] - FRONT
    assert threats.ttc[0] == pytest.approx(gap_now / (rider + car), abs=1e-6)
    assert threats.closest_distance[0] == 0.0
    assert threats.closest_time[0] == threats.ttc[0]
    assert threats.closing_speed[0] == pytest.approx(rider + car, rel=1e-6)
    assert threats.in_corridor[0]


@pytest.mark.parametrize("acceleration", [-1.0, -0.3, 0.0, 0.5, 2.0])
def test_following_is_the_root_of_a_quadratic(acceleration):
    """A car from behind at 12 m/s, the rider at 5 m/s: 7 t + a t^2 / 2 = gap."""
    threats = one((-18.0, 0.0, 0.0, 12.0, acceleration), 5.0)
    d = 18.0 - 0.5 * CAR[0] - FRONT
    roots = np.roots([0.5 * acceleration, 7.0, -d]) if acceleration else np.array([d / 7.0])
    expected = roots[(np.isreal(roots)) & (roots.real > 0)].real.min()
    assert threats.ttc[0] == pytest.approx(expected, abs=1e-5)


def test_a_car_that_stops_in_time_does_not_collide_and_does_not_reverse():
    threats = one((-30.0, 0.0, 0.0, 10.0, -2.5))  # stops after 4 s and 20 m
    assert threats.ttc[0] == np.inf
    assert threats.closest_distance[0] == pytest.approx(30.0 - 20.0 - 2.0 - FRONT, abs=1e-6)
    assert threats.closest_time[0] == pytest.approx(4.0, abs=0.02)
    assert threats.required_deceleration[0] == 0.0
    poses = predict_arc(tracks((-30.0, 0.0, 0.0, 10.0, -2.5)), 6.0, 0.5)[0]
    assert np.all(np.diff(poses[:, 0]) >= 0.0)
    assert poses[-1, 0] == pytest.approx(-10.0)


def test_crossing_at_a_right_angle_touches_when_the_first_corner_enters():
    """Rider east at 5 m/s, car north at 8 m/s: overlap begins when both projections overlap."""
    x, y = 12.0, -18.0
    threats = one((x, y, 0.5 * np.pi, 8.0), 5.0)
    enter_x = (x - 0.5 * CAR[1] - FRONT) / 5.0
    enter_y = (-y - 0.5 * CAR[0] - SIDE) / 8.0
    leave_x = (x + 0.5 * CAR[1] + FRONT) / 5.0
    leave_y = (-y + 0.5 * CAR[0] + SIDE) / 8.0
    assert max(enter_x, enter_y) < min(leave_x, leave_y)
    assert threats.ttc[0] == pytest.approx(max(enter_x, enter_y), abs=1e-5)


@pytest.mark.parametrize("y", [-10.0, -29.5])  # clear ahead of the rider, and clear behind
def test_crossing_with_room_misses(y):
    threats = one((12.0, y, 0.5 * np.pi, 8.0), 5.0)
    assert threats.ttc[0] == np.inf
    assert threats.closest_distance[0] > 0.3
    assert threats.required_deceleration[0] == 0.0


@pytest.mark.parametrize("direction", [0.0, np.pi])
def test_parallel_traffic_stays_at_its_lateral_gap(direction):
    """A lane 3.5 m away: no overlap, outside the corridor; 2.2 m away: inside, but no overlap."""
    for y, inside in [(3.5, False), (2.2, True)]:
        threats = one((-20.0 if direction == 0.0 else 20.0, y, direction, 12.0), 5.0)
        assert threats.ttc[0] == np.inf
        assert threats.closest_distance[0] == pytest.approx(y - 0.5 * CAR[1] - SIDE, abs=1e-6)
        assert threats.in_corridor[0] == inside


def test_receding_is_never():
    threats = one((10.0, 0.0, 0.0, 12.0), 5.0)
    assert threats.ttc[0] == np.inf
    assert threats.closest_time[0] == 0.0
    assert threats.closest_distance[0] == pytest.approx(10.0 - 2.0 - FRONT)
    assert threats.closing_speed[0] == 0.0


def test_overlapping_is_now():
    threats = one((2.0, 0.3, 0.4, 3.0))
    assert threats.ttc[0] == 0.0
    assert threats.closest_distance[0] == 0.0
    assert threats.required_deceleration[0] == np.inf


def test_a_standing_pair_never_meets():
    threats = one((8.0, 0.0, 1.0, 0.0))
    assert threats.ttc[0] == np.inf
    distance = shapely.Polygon(corners(np.array([8.0, 0.0, 1.0]), np.array(CAR))).distance(
        shapely.Polygon(corners(np.zeros(3), np.array([2 * FRONT, 2 * SIDE])))
    )
    assert threats.closest_distance[0] == pytest.approx(distance, abs=1e-9)


def test_a_static_track_stands_whatever_its_columns_say():
    threats = one((20.0, 0.0, np.pi, 9.0, 3.0, 0.5), 5.0, state=TrackState.STATIC)
    assert threats.ttc[0] == pytest.approx((20.0 - 2.0 - FRONT) / 5.0, abs=1e-6)


def test_a_reversing_car_comes_backwards():
    threats = one((20.0, 0.0, 0.0, -4.0))
    assert threats.ttc[0] == pytest.approx((20.0 - 2.0 - FRONT) / 4.0, abs=1e-6)
    assert threats.required_deceleration[0] == pytest.approx(16.0 / (2 * (20.0 - 2.0 - FRONT)), rel=0.006)


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_a_standing_car_that_starts_goes_forward(zero):
    """From rest: a t^2 / 2 = gap; the sign of a zero speed means nothing."""
    threats = one((20.0, 0.0, np.pi, zero, 2.0))
    assert threats.ttc[0] == pytest.approx(np.sqrt(20.0 - 2.0 - FRONT), abs=1e-5)


def test_the_footprint_lies_ahead_of_the_ego_origin():
    rider = settings.Rider(length_m=1.2, width_m=0.6, margin_m=0.3, centre_x_m=0.5)
    assert one((30.0, 0.0, np.pi, 10.0), rider=rider).ttc[0] == pytest.approx((27.1 - 0.5) / 10.0, abs=1e-6)


# ------------------------------------------------------------------ braking


@pytest.mark.parametrize("acceleration", [-0.2, 0.0, 1.5])
def test_required_deceleration_before_a_standing_rider(acceleration):
    d = 30.0 - 2.0 - FRONT
    threats = one((30.0, 0.0, np.pi, 10.0, acceleration))
    assert threats.required_deceleration[0] == pytest.approx(100.0 / (2 * d), rel=0.006)


def test_required_deceleration_behind_a_moving_rider():
    """Braking must take the closing speed of 6 m/s within the gap: dv^2 / (2 d)."""
    d = 20.0 - 2.0 - FRONT
    threats = one((-20.0, 0.0, 0.0, 11.0), 5.0)
    assert threats.required_deceleration[0] == pytest.approx(36.0 / (2 * d), rel=0.006)


def test_braking_cannot_help_where_the_rider_rides_into_it():
    assert one((12.0, 0.0, np.pi, 2.0), 5.0).required_deceleration[0] == np.inf
    assert one((12.0, 0.0, np.pi, 0.0), 5.0).required_deceleration[0] == np.inf


def test_no_braking_where_not_accelerating_is_enough():
    """The car would pass in front of the rider only if it accelerated; at constant speed it stays behind."""
    threats = one((-20.0, 0.0, 0.0, 5.0, 3.0), 5.0)
    assert threats.ttc[0] < 6.0
    assert threats.required_deceleration[0] == 0.0


@example(r=8.0, bearing=-1.5, speed=12.0, yaw_rate=0.25, v=3.0, w=0.0)  # touches for a few milliseconds
@given(
    st.floats(8.0, 30.0), st.floats(-np.pi, np.pi), st.floats(2.0, 15.0),
    st.floats(-0.3, 0.3), st.floats(0.0, 6.0), st.floats(-0.3, 0.3),
)  # fmt: skip
def test_braking_as_required_avoids_contact_within_the_horizon(r, bearing, speed, yaw_rate, v, w):
    """Aimed at where the rider is; the same car braking 1 % harder than required does not touch."""
    row = (r * np.cos(bearing), r * np.sin(bearing), bearing + np.pi, speed, 0.0, yaw_rate)
    needed = one(row, v, w).required_deceleration[0]
    if 0.0 < needed < np.inf:
        # curvature is yaw_rate / speed at the start and kept while braking: the same path
        assert one((*row[:4], -1.01 * needed, yaw_rate), v, w).ttc[0] > 5.9


# ------------------------------------------------------------------ against a dense reference


def reference(row, speed, yaw_rate, extent, step=0.002, horizon=6.0):
    """First touch and least gap by integrating the motion in small steps and asking shapely."""
    x, y, course, v, a, w, slip = (*row, *[0.0] * (7 - len(row)))
    curvature = np.clip(w / v, -1.0 / extent[0], 1.0 / extent[0]) if v else 0.0
    rider, size = np.zeros(3), np.array([2 * FRONT, 2 * SIDE])
    least, sub = np.inf, 4
    for k in range(int(horizon / step) + 1):
        body = shapely.Polygon(corners(np.array([x, y, course - slip]), np.array(extent)))
        gap_now = body.distance(shapely.Polygon(corners(rider, size)))
        least = min(least, gap_now)
        if gap_now == 0.0:
            return k * step, 0.0
        h = step / sub
        for _ in range(sub):
            mean = v + 0.5 * a * h if v * (v + a * h) > 0.0 or v == 0.0 else 0.0
            turn = curvature * mean * h
            x, y = x + mean * h * np.cos(course + 0.5 * turn), y + mean * h * np.sin(course + 0.5 * turn)
            course += turn
            v = v + a * h if mean else 0.0
            a = a if v else 0.0
            heading = rider[2] + 0.5 * yaw_rate * h
            rider = rider + h * np.array([speed * np.cos(heading), speed * np.sin(heading), yaw_rate])
    return np.inf, least


@pytest.mark.parametrize(
    ("row", "speed", "yaw_rate"),
    [
        ((15.0, 12.0, -0.5 * np.pi, 6.0, 0.0, -0.45), 2.0, 0.0),  # turns right into the rider's way
        ((14.0, 3.5, np.pi, 7.0, 0.0, 0.5), 3.0, 0.0),  # oncoming, then left turn
        ((-15.0, 4.0, 0.0, 9.0, 0.5, -0.2, 0.1), 5.0, 0.15),  # both turn, the car slips
        ((-10.0, -9.0, 0.8, 8.0, -1.0, 0.1), 4.0, -0.2),
        ((12.0, -10.0, 2.0, 5.0, -2.0, 0.3), 5.0, 0.3),  # brakes to a stop
        ((9.0, 9.0, -2.3, 4.0, 1.0, 0.0), 0.0, 0.0),
    ],
)
def test_turning_arcs_agree_with_a_dense_reference(row, speed, yaw_rate):
    ttc, least = reference(row, speed, yaw_rate, CAR)
    threats = one(row, speed, yaw_rate)
    assert np.isfinite(ttc) == np.isfinite(threats.ttc[0])
    if np.isfinite(ttc):
        assert threats.ttc[0] == pytest.approx(ttc, abs=0.003)
    assert threats.closest_distance[0] == pytest.approx(least, abs=0.02)


poses = st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-4, 4))
sizes = st.tuples(st.floats(0.05, 6), st.floats(0.05, 3))


@given(poses, sizes, poses, sizes)
@example((0.0, 0.0, 0.0), (4.0, 0.2), (0.0, 0.0, 1.5), (4.0, 0.2))  # a cross: no corner inside the other
def test_gap_between_rectangles_is_shapelys_distance(p, e, q, f):
    value = gap(*p, 0.5 * e[0], 0.5 * e[1], *q, 0.5 * f[0], 0.5 * f[1])
    a, b = (shapely.Polygon(corners(np.array(x), np.array(s))) for x, s in ((p, e), (q, f)))
    assert max(value, 0.0) == pytest.approx(a.distance(b), abs=1e-9)
    assert (value <= 1e-9) == a.intersects(b) or abs(value) < 1e-9


# ------------------------------------------------------------------ symmetries

rows = st.tuples(
    st.floats(-25, 25), st.floats(-25, 25), st.floats(-np.pi, np.pi), st.floats(0.5, 15),
    st.floats(-3, 3), st.floats(-0.5, 0.5), st.floats(-0.3, 0.3),
)  # fmt: skip
riders = st.tuples(st.floats(0.6, 8), st.floats(-0.4, 0.4))


def same(a, b, closeness=1e-6, length=1.0, rounding=2e-3):
    """Two threats are the same; grazing cases, where a hair decides, are left out by the caller."""
    assert b.ttc == pytest.approx(a.ttc, abs=rounding)
    assert b.closest_distance == pytest.approx(length * a.closest_distance, abs=1e-4 * length + closeness)
    assert np.array_equal(a.in_corridor, b.in_corridor)


def grazing(row, speed, yaw_rate):
    """Whether a centimetre more or less of margin changes if, or much of when, there is contact."""
    wide, thin = (
        one(
            row,
            speed,
            yaw_rate,
            rider=settings.Rider(margin_m=0.3 + d),
            threat=settings.Threat(corridor_width_m=c),
        )
        for d, c in ((0.01, 3.02), (-0.01, 2.98))
    )
    if wide.in_corridor[0] != thin.in_corridor[0] or np.isfinite(wide.ttc[0]) != np.isfinite(thin.ttc[0]):
        return True
    return bool(np.isfinite(wide.ttc[0]) and thin.ttc[0] - wide.ttc[0] > 0.1)


@hypothesis_settings(max_examples=200)
@given(rows, riders, st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-np.pi, np.pi)))
def test_turning_and_moving_the_world_changes_nothing(row, rider, move):
    if grazing(row, *rider):
        return
    before = one(row, *rider)
    x, y, course = compose(np.array(move), np.array(row[:3]))
    there = assess(tracks((x, y, course, *row[3:])), ego(*rider, pose=move), RIDER, THREAT)
    same(before, there)


@hypothesis_settings(max_examples=200)
@given(rows, riders)
def test_left_and_right_are_alike(row, rider):
    if grazing(row, *rider):
        return
    x, y, course, v, a, w, slip = row
    same(one(row, *rider), one((x, -y, -course, v, a, -w, -slip), rider[0], -rider[1]))


@hypothesis_settings(max_examples=200)
@given(rows, riders, st.floats(0.1, 10.0))
def test_scaling_lengths_and_speeds_keeps_the_time(row, rider, scale):
    """A 1/10 model that moves at 1/10 of the speed collides after the same time."""
    rider = (max(rider[0], 0.6 / min(scale, 1.0)), rider[1])  # below 0.5 m/s the corridor follows the body
    if grazing(row, *rider):
        return
    x, y, course, v, a, w, slip = row
    body = settings.Rider(length_m=1.2 * scale, width_m=0.6 * scale, margin_m=0.3 * scale)
    threat = settings.Threat(corridor_width_m=THREAT.corridor_width_m * scale)
    small = (x * scale, y * scale, course, v * scale, a * scale, w, slip)
    extent = (CAR[0] * scale, CAR[1] * scale)
    scaled = one(small, rider[0] * scale, rider[1], threat=threat, rider=body, extent=extent)
    before = one(row, *rider)
    same(before, scaled, length=scale)
    assert scaled.closing_speed == pytest.approx(scale * before.closing_speed, rel=1e-2, abs=1e-3 * scale)


@hypothesis_settings(max_examples=300)
@given(rows, riders)
def test_contact_lies_in_the_corridor(row, rider):
    """The corridor is wider than the footprint, so whoever touches comes into it."""
    threats = one(row, *rider)
    assert threats.in_corridor[0] or threats.ttc[0] == np.inf


# ------------------------------------------------------------------ nothing slips through


@pytest.mark.parametrize("offset", np.linspace(0.0, 1.0, 23))
def test_a_thin_fast_object_is_not_tunnelled_through(offset):
    """0.3 m x 2 cm at 60 m/s moves 6 m in a step of 0.1 s; the rider is 1.2 m wide."""
    x = 60.0 + 6.0 * offset
    ttc = one((0.0, x, -0.5 * np.pi, 60.0), extent=(0.3, 0.02)).ttc[0]
    assert ttc == pytest.approx((x - 0.15 - SIDE) / 60.0, abs=1e-5)


def test_a_body_that_turns_on_the_spot_sweeps_a_post():
    """No point has a speed along the path, yet the long rectangle turns into the post after 3 s."""
    rider, w, post = settings.Rider(length_m=6.0, width_m=0.1, margin_m=0.0), 0.5, (0.0, 2.5, 0.0, 0.0)
    turn = np.arctan2(2.49, 0.01) - np.arcsin(0.05 / np.hypot(2.49, 0.01))  # side through the post's corner
    assert one(post, 0.0, w, rider=rider, extent=(0.02, 0.02)).ttc[0] == pytest.approx(turn / w, abs=1e-5)


def test_a_coarse_step_changes_no_contact():
    many = [(20 * np.cos(b), 20 * np.sin(b), b + np.pi + 0.1, 9.0, 0.0, 0.1) for b in np.linspace(-3, 3, 40)]
    fine, coarse = (
        assess(tracks(*many), ego(4.0, 0.1), RIDER, settings.Threat(step_s=step)) for step in (0.01, 1.0)
    )
    assert np.array_equal(fine.ttc, coarse.ttc)
    assert 0 < np.isfinite(fine.ttc).sum() < 40


def test_no_contact_beyond_the_horizon():
    assert one((70.0, 0.0, np.pi, 10.0)).ttc[0] == np.inf
    assert one((70.0, 0.0, np.pi, 10.0), threat=settings.Threat(horizon_s=7.0)).ttc[0] < 7.0


# ------------------------------------------------------------------ corridor


def test_the_corridor_bends_with_the_rider():
    """Rider on a circle of 10 m to the left: what stands on it is inside, what stands ahead is not."""
    on_circle, ahead = (10 * np.sin(1.0), 10 - 10 * np.cos(1.0), 1.0), (22.0, 0.0, 0.0)
    bent = assess(tracks(on_circle, ahead), ego(5.0, 0.5), RIDER, THREAT)
    assert bent.in_corridor.tolist() == [True, False]
    straight = assess(tracks(on_circle, ahead), ego(5.0), RIDER, THREAT)
    assert straight.in_corridor.tolist() == [False, True]


def test_the_corridor_of_a_standing_rider_lies_along_the_body():
    behind, beside = (-20.0, 1.0, 0.0, 5.0), (0.0, 8.0, 0.0, 5.0)
    threats = assess(tracks(behind, beside), ego(), RIDER, THREAT)
    assert threats.in_corridor.tolist() == [True, False]


# ------------------------------------------------------------------ arcs, bad rows, bad settings


def test_predicted_arc_is_a_circle_at_constant_speed():
    poses = predict_arc(tracks((1.0, 2.0, 0.3, 6.0, 0.0, 0.5, 0.1)), 4.0, 0.25)
    assert poses.shape == (1, 17, 3)
    t = np.linspace(0.0, 4.0, 17)
    local = 12.0 * np.column_stack([np.sin(0.5 * t), 1.0 - np.cos(0.5 * t)])
    np.testing.assert_allclose(poses[0, :, :2], np.array([1.0, 2.0]) + rotate(local, 0.3), atol=1e-12)
    np.testing.assert_allclose(poses[0, :, 2], 0.2 + 0.5 * t, atol=1e-12)


def test_a_path_is_never_tighter_than_the_body_is_long():
    """A yaw rate left over on a car that has almost stopped does not spin it on the spot."""
    poses = predict_arc(tracks((0.0, 0.0, 0.0, 0.01, 0.0, 2.0)), 6.0, 0.5)[0]
    assert abs(poses[-1, 2]) == pytest.approx(0.06 / CAR[0])


@pytest.mark.parametrize("value", [np.nan, -np.inf, 1e300])
@pytest.mark.parametrize("column", ["W_p", "speed", "acceleration", "course", "yaw", "yaw_rate", "extent"])
def test_a_row_that_is_not_finite_is_marked_and_leaves_the_others_alone(column, value):
    rows = [(30.0, 0.0, np.pi, 10.0), (25.0, 0.0, np.pi, 10.0)]
    whole = tracks(*rows)
    values = getattr(whole, column).copy()
    values[0] = value
    threats = assess(dataclasses.replace(whole, **{column: values}), ego(), RIDER, THREAT)
    assert threats.ttc[0] == threats.closest_distance[0] == np.inf
    assert not threats.in_corridor[0]
    assert threats.ttc[1] == one(rows[1]).ttc[0]
    for value in (threats.closest_time, threats.required_deceleration, threats.closing_speed):
        assert np.isfinite(value[0])


def test_a_rider_that_is_not_finite_marks_every_row():
    lost = dataclasses.replace(ego(), W_v=np.array([np.nan, 0.0]))
    threats = assess(tracks((30.0, 0.0, np.pi, 10.0)), lost, RIDER, THREAT)
    assert threats.closest_distance.tolist() == [np.inf]


def test_no_tracks_no_threats():
    threats = assess(tracks(), ego(5.0), RIDER, THREAT)
    assert threats.ttc.shape == threats.id.shape == threats.in_corridor.shape == (0,)
    assert predict_arc(tracks(), 6.0, 0.1).shape == (0, 61, 3)


@pytest.mark.parametrize(
    ("section", "key"), [("threat", "horizon_s"), ("threat", "step_s"), ("rider", "width_m")]
)
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_a_setting_that_makes_no_sense_is_refused(section, key, value):
    chosen = {"rider": RIDER, "threat": THREAT}
    chosen[section] = type(chosen[section])(**{key: value})
    with pytest.raises(InputError, match=f"{section}.{key} is .*: want a positive number"):
        assess(tracks(), ego(), chosen["rider"], chosen["threat"])
