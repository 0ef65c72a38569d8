"""Scenarios, the lidar model and the recordings made of them, against closed forms, shapely and symmetry."""

import math
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from outrider import lidar_model, simulate
from outrider.errors import InputError
from outrider.geometry import compose, corners, rotate, wrap
from outrider.lidar_model import Echo, Shapes, cast
from outrider.models import bicycle
from outrider.records import LaserScan, Pose
from outrider.scenario import PARTS, Pole, Sensor, parse

HARMLESS = ("overtakes", "overtakes_too", "oncoming", "oncoming_too")
NAMES = [
    "accelerating",
    "constant",
    "crossing",
    "demo",
    "left_turn_in_front",
    "oncoming",
    "oncoming_left_turn",
    "overtaking",
    "turning",
]
IDEAL = {"sigma_m": 0.0, "lost": 0.0, "echoes": 1e5}


def ideal(world, **changes):
    """The scenario seen by a sensor without errors."""
    return msgspec.structs.replace(
        world, sensor=msgspec.structs.replace(world.sensor, **{**IDEAL, **changes})
    )


def shapes(n, boxes=(), circles=(), walls=()):
    """Shapes that stand: boxes (x, y, yaw, length, width), circles (x, y, radius), walls ((x, y), (x, y))."""
    boxes = np.array(boxes, float).reshape(-1, 5)
    circles = np.array(circles, float).reshape(-1, 3)
    return Shapes(
        np.broadcast_to(boxes[:, :3], (n, len(boxes), 3)),
        boxes[:, 3:],
        np.broadcast_to(circles[:, :2], (n, len(circles), 2)),
        circles[:, 2],
        np.array(walls, float).reshape(-1, 2, 2),
    )


def scans_of(messages):
    return [message for message in messages if isinstance(message, LaserScan)]


def seconds(stamp_ns):
    return (stamp_ns - simulate.EPOCH_NS) * 1e-9


def beams(scan):
    """Times and angles of the beams as the header says."""
    i = np.arange(len(scan.ranges))
    return seconds(scan.stamp_ns) + i * scan.time_increment, scan.angle_min + i * scan.angle_increment


def points(world, scan):
    """Times of the returns, and the returns in the fixed frame (sensor mounted at the body's origin)."""
    t, angle = beams(scan)
    rider = simulate.rider_at(world, t)
    back = np.isfinite(scan.ranges)
    way = scan.ranges[back, None] * rotate(np.array([1.0, 0.0]), (rider.yaw + angle)[back])
    return t[back], np.column_stack([rider.x, rider.y])[back] + way


def hits_on(world, scan):
    """Number of returns on each body, by name."""
    t, p = points(world, scan)
    count = {}
    for name, body in simulate.truth_at(world, t).items():
        local = rotate(p - np.column_stack([body.x, body.y]), -body.yaw)
        count[name] = int(np.sum(np.all(np.abs(local) <= 0.5 * body.extent + 0.1, axis=1)))
    return count


def outline(body, i):
    return shapely.Polygon(corners(np.array([body.x[i], body.y[i], body.yaw[i]]), body.extent))


# ------------------------------------------------------------------ rays


def test_a_box_in_front_is_hit_on_the_sides_it_shows():
    heading = np.deg2rad(np.arange(-180.0, 180.0, 0.75) + 0.1)
    echo = cast(np.zeros((480, 2)), heading, shapes(480, boxes=[(10.0, 2.0, 0.0, 4.0, 2.0)]))
    rear = np.abs(8.0 * np.tan(heading) - 2.0) <= 1.0
    rear &= np.abs(heading) < np.pi / 2.0
    with np.errstate(divide="ignore"):
        side = ~rear & (np.abs(1.0 / np.tan(heading) - 10.0) <= 2.0) & (heading > 0.0)
    expected = np.full(480, np.inf)
    expected[rear] = 8.0 / np.cos(heading[rear])
    expected[side] = 1.0 / np.sin(heading[side])
    assert rear.sum() > 10
    assert side.sum() > 0
    np.testing.assert_allclose(echo.range, expected, rtol=1e-12)
    np.testing.assert_allclose(echo.incidence[rear], np.cos(heading[rear]), rtol=1e-12)
    np.testing.assert_allclose(echo.incidence[side], np.sin(heading[side]), rtol=1e-12)


def test_rays_agree_with_shapely():
    boxes = [(8.0, 3.0, 0.6, 4.5, 1.8), (-5.0, 6.0, -1.1, 5.0, 2.0), (12.0, 6.0, 2.0, 4.0, 1.7)]
    walls = [((-20.0, -6.0), (15.0, -7.5)), ((15.0, -7.5), (15.0, 20.0))]
    origin, heading = np.tile([0.4, -0.3], (360, 1)), np.deg2rad(np.arange(360) + 0.37)
    echo = cast(origin, heading, shapes(360, boxes=boxes, circles=[(3.0, -3.0, 0.3)], walls=walls))
    things = [shapely.Polygon(corners(np.array(box[:3]), np.array(box[3:]))) for box in boxes]
    things += [shapely.LineString(wall) for wall in walls]
    world = shapely.union_all(things)
    for start, angle, got in zip(origin, heading, echo.range, strict=True):
        ray = shapely.LineString([start, start + 100.0 * np.array([np.cos(angle), np.sin(angle)])])
        distance = shapely.Point(start).distance(ray.intersection(world))
        to = np.array([3.0, -3.0]) - start
        along = to @ [np.cos(angle), np.sin(angle)]
        below = 0.3**2 - (to @ to - along**2)
        circle = along - math.sqrt(below) if below > 0.0 and along > 0.0 else math.inf
        nearest = min(circle, math.inf if math.isnan(distance) else distance)
        assert got == pytest.approx(nearest, rel=1e-9)


def test_along_a_side_inside_and_nothing():
    along = cast(np.zeros((1, 2)), np.zeros(1), shapes(1, boxes=[(5.0, 0.5, 0.0, 2.0, 2.0)]))
    np.testing.assert_allclose(along.range, 4.0)  # runs along the slab, not outside it
    outside = cast(np.zeros((1, 2)), np.zeros(1), shapes(1, boxes=[(5.0, 1.5, 0.0, 2.0, 2.0)]))
    assert np.isinf(outside.range[0])
    inside = cast(
        np.zeros((1, 2)),
        np.zeros(1),
        shapes(1, boxes=[(0.1, 0.0, 0.3, 4.0, 2.0)], walls=[((9.0, -1.0), (9.0, 1.0))]),
    )
    assert inside.range[0] == 0.0
    nothing = cast(np.zeros((3, 2)), np.zeros(3), shapes(3))
    assert np.all(np.isinf(nothing.range))
    assert np.all(nothing.incidence == 0.0)


@given(st.floats(-3.0, 3.0), st.floats(-50.0, 50.0), st.floats(-50.0, 50.0))
def test_turning_the_world_changes_no_range(angle, x, y):
    pose = np.array([x, y, angle])
    boxes = np.array([(8.0, 3.0, 0.6, 4.5, 1.8), (-5.0, 6.0, -1.1, 5.0, 2.0)])
    circles, wall = np.array([(3.0, -3.0, 0.3)]), np.array([[-20.0, -6.0], [15.0, -7.5]])
    heading = np.deg2rad(np.arange(0.0, 360.0, 3.0) + 0.377)
    echo = cast(np.zeros((120, 2)), heading, shapes(120, boxes, circles, [wall]))
    boxes[:, :3] = compose(np.tile(pose, (2, 1)), boxes[:, :3])
    circles[:, :2] = pose[:2] + rotate(circles[:, :2], angle)
    moved = shapes(120, boxes, circles, [pose[:2] + rotate(wall, angle)])
    again = cast(np.tile(pose[:2], (120, 1)), heading + angle, moved)
    np.testing.assert_allclose(again.range, echo.range, rtol=1e-7)
    np.testing.assert_allclose(again.incidence, echo.incidence, atol=1e-7)


def test_one_scan_takes_less_than_two_milliseconds():
    n = 480
    boxes = [(5.0 * np.cos(i), 20.0 * np.sin(i), i, 4.5, 1.8) for i in range(20)]
    walls = [((i, 30.0), (i + 1.0, 30.0)) for i in range(20)]
    world = shapes(n, boxes, [(i, -5.0, 0.2) for i in range(10)], walls)
    heading = lidar_model.beam_angles(Sensor())
    took = []
    for _ in range(30):
        begin = time.process_time()
        cast(np.zeros((n, 2)), heading, world)
        took.append(time.process_time() - begin)
    assert min(took) < 2e-3


# ------------------------------------------------------------------ sensor errors


def test_noise_has_the_stated_deviation():
    sensor = Sensor(lost=0.0, echoes=1e6, sigma_m=0.02)
    n = 40000
    ranges = lidar_model.measure(Echo(np.full(n, 7.0), np.ones(n)), sensor, np.random.default_rng(3))
    assert np.mean(ranges, dtype=float) == pytest.approx(7.0, abs=4.0 * 0.02 / math.sqrt(n))
    assert np.std(ranges, dtype=float) == pytest.approx(0.02, rel=4.0 / math.sqrt(2.0 * n))


@pytest.mark.parametrize(("distance", "incidence"), [(5.0, 1.0), (20.0, 0.3), (38.0, 1.0), (38.0, 0.1)])
def test_share_of_returns_is_the_stated_one(distance, incidence):
    sensor, n = Sensor(lost=0.01), 40000
    echo = Echo(np.full(n, distance), np.full(n, incidence))
    share = np.isfinite(lidar_model.measure(echo, sensor, np.random.default_rng(4))).mean()
    expected = 0.99 * (1.0 - math.exp(-3.0 * incidence * (40.0 / distance) ** 2))
    assert share == pytest.approx(expected, abs=4.0 * math.sqrt(expected * (1.0 - expected) / n))


def test_returns_get_rarer_with_range_and_grazing():
    far = Echo(np.linspace(10.0, 40.0, 31), np.full(31, 0.4))
    assert np.all(np.diff(lidar_model.return_probability(far, Sensor())) < 0.0)
    grazing = Echo(np.full(31, 25.0), np.linspace(1.0, 0.0, 31))
    chance = lidar_model.return_probability(grazing, Sensor())
    assert np.all(np.diff(chance) < 0.0)
    assert chance[-1] == 0.0


def test_out_of_range_is_no_return():
    echo = Echo(np.array([0.05, 0.2, 39.0, 41.0, np.inf]), np.array([1.0, 1.0, 1.0, 1.0, 0.0]))
    got = lidar_model.measure(echo, Sensor(**IDEAL), np.random.default_rng(0))
    np.testing.assert_array_equal(got, np.float32([np.inf, 0.2, 39.0, np.inf, np.inf]))


# ------------------------------------------------------------------ motion


def test_braking_ends_at_a_standstill_and_stays_there():
    world = simulate.load("accelerating")
    car = simulate.truth_at(world, [2.0, 4.0, 6.0, 8.5, 20.0])["car"]
    np.testing.assert_allclose(car.x, [-4.0, 12.0, 27.0, 32.0, 32.0])
    np.testing.assert_allclose(car.speed, [6.0, 10.0, 5.0, 0.0, 0.0])
    np.testing.assert_allclose(car.acceleration, [2.0, -2.5, -2.5, 0.0, 0.0])


def test_reversing_out_of_a_standstill():
    world = parse("""
        title = "reversing"
        duration_s = 4.0
        vehicles = [{ name = "car", x_m = 0.0, y_m = 5.0, manoeuvres = [
          { duration_s = 2.0, acceleration_mps2 = -1.0 }, { duration_s = 5.0, acceleration_mps2 = 1.0 }] }]
    """)
    car = simulate.truth_at(world, [2.0, 4.0, 6.5])["car"]
    np.testing.assert_allclose(car.x, [-2.0, -4.0, -4.0])
    np.testing.assert_allclose(car.speed, [-2.0, 0.0, 0.0], atol=1e-12)


def test_a_turning_wheel_follows_the_model():
    """The steps the wheel is turned in make no difference that matters: against a fine Runge-Kutta run."""
    world = simulate.load("turning")
    s = bicycle.State(-18.0 + 6.0 * 1.5, 4.0, 6.0, 0.0, 0.0, 0.0)
    n, rate = 2000, np.deg2rad(15.0)
    for i in range(n):
        now, then = bicycle.slip(rate * i / n), bicycle.slip(rate * (i + 1) / n)
        s = bicycle.rk4(s._replace(beta=now), 1.0 / n, slip_rate=(then - now) * n)
    car = simulate.truth_at(world, 2.5)["car"]
    assert [car.x[0], car.y[0]] == pytest.approx([s.X, s.Y], abs=1e-4)
    assert car.yaw[0] == pytest.approx(s.psi, abs=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_truth_is_consistent(name):
    """Speed, course, yaw rate and acceleration are the derivatives of the positions, except at a switch."""
    world = simulate.load(name)
    h = 1e-4
    t = np.arange(0.0503, world.duration_s - 0.05, 0.1)
    before, now, after = (simulate.truth_at(world, t + d) for d in (-h, 0.0, h))
    for body in now:
        a, b, c = before[body], now[body], after[body]
        course = b.yaw + b.slip
        np.testing.assert_allclose((c.x - a.x) / (2 * h), b.speed * np.cos(course), atol=0.05)
        np.testing.assert_allclose((c.y - a.y) / (2 * h), b.speed * np.sin(course), atol=0.05)
        np.testing.assert_allclose(wrap(c.yaw - a.yaw) / (2 * h), b.yaw_rate, atol=0.01)
        np.testing.assert_allclose((c.speed - a.speed) / (2 * h), b.acceleration, atol=0.01)


# ------------------------------------------------------------------ recordings


def test_beams_are_sequential_while_the_sensor_rides():
    """Range to a wall ahead, beam by beam, from where the sensor is when that beam leaves."""
    world = ideal(
        parse("""
        title = "towards a wall"
        duration_s = 1.0
        rider = { speed_mps = 8.0 }
        walls = [{ points_m = [[20.0, -30.0], [20.0, 30.0]] }]
    """)
    )
    for k, scan in enumerate(scans_of(simulate.record(world))):
        i = np.arange(480)
        angle = -np.pi + i * 2.0 * np.pi / 480
        x = 8.0 * (0.1 * k + i * 0.1 / 480)
        ahead = np.abs(angle) < 0.9
        np.testing.assert_allclose(scan.ranges[ahead], ((20.0 - x) / np.cos(angle))[ahead], rtol=1e-6)


@pytest.mark.parametrize("clockwise", [False, True])
def test_beams_are_sequential_while_the_target_drives(clockwise):
    """A box beside a standing sensor: where its front is depends on when the beam leaves."""
    world = ideal(
        parse("""
        title = "a box passes"
        duration_s = 0.1
        vehicles = [{ name = "box", x_m = 0.0, y_m = 3.0, speed_mps = 20.0, length_m = 6.0, width_m = 2.0 }]
    """),
        clockwise=clockwise,
    )
    (scan,) = scans_of(simulate.record(world))
    t, angle = beams(scan)
    assert scan.angle_increment * (-1.0 if clockwise else 1.0) > 0.0
    left = (angle > 0.3) & (angle < 2.8)
    t, angle, ranges = t[left], angle[left], scan.ranges[left]
    side = np.abs(2.0 / np.tan(angle) - 20.0 * t) <= 3.0  # the box's side is where the beam crosses y = 2
    assert side.sum() > 100
    np.testing.assert_allclose(ranges[side], 2.0 / np.sin(angle[side]), rtol=1e-6)
    assert np.all(ranges[~side] > 2.001 / np.sin(angle[~side]))


def test_the_sensor_looks_from_where_it_is_mounted():
    text = """
        title = "mounted"
        duration_s = 0.1
        walls = [{ points_m = [[20.0, -30.0], [20.0, 30.0]] }]
    """
    world = ideal(parse(text), x_m=0.5, y_m=1.0, yaw_deg=90.0)
    (scan,) = scans_of(simulate.record(world))
    angle = beams(scan)[1]
    ahead = np.abs(angle + np.pi / 2.0) < 0.9
    np.testing.assert_allclose(scan.ranges[ahead], 19.5 / -np.sin(angle[ahead]), rtol=1e-6)


def test_a_turned_scenario_gives_the_same_scans():
    world = ideal(simulate.load("turning"))
    world = msgspec.structs.replace(world, poles=(*world.poles, Pole(x_m=-3.0, y_m=-2.0)))
    pose = np.array([7.0, -4.0, np.deg2rad(37.0)])

    def moved(part):
        x, y, _ = compose(pose, np.array([part.x_m, part.y_m, 0.0]))
        yaw = {"yaw_deg": part.yaw_deg + 37.0} if hasattr(part, "yaw_deg") else {}
        return msgspec.structs.replace(part, x_m=float(x), y_m=float(y), **yaw)

    walls = tuple(
        msgspec.structs.replace(
            wall, points_m=tuple(tuple(pose[:2] + rotate(np.array(p), pose[2])) for p in wall.points_m)
        )
        for wall in world.walls
    )
    again = msgspec.structs.replace(
        world,
        rider=moved(world.rider),
        vehicles=tuple(map(moved, world.vehicles)),
        poles=tuple(map(moved, world.poles)),
        walls=walls,
    )
    pairs = zip(scans_of(simulate.record(world)), scans_of(simulate.record(again)), strict=True)
    for one, other in pairs:
        np.testing.assert_allclose(other.ranges, one.ranges, rtol=1e-5)


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 2**32))
def test_same_seed_same_messages(seed):
    world = simulate.load("crossing")
    one, two = list(simulate.record(world, seed)), list(simulate.record(world, seed))
    assert len(one) == len(two)
    for a, b in zip(one, two, strict=True):
        assert type(a) is type(b)
        for field in type(a).__slots__:
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
    other = scans_of(simulate.record(world, seed + 1))
    assert any(not np.array_equal(a.ranges, b.ranges) for a, b in zip(scans_of(one), other, strict=True))


def test_messages_come_in_order_with_the_right_headers():
    world = simulate.load("demo")
    messages = list(simulate.record(world))
    received = [message.received_ns for message in messages]
    assert received == sorted(received)
    scans = scans_of(messages)
    assert len(scans) == 140
    for k, scan in enumerate(scans):
        assert seconds(scan.stamp_ns) == pytest.approx(0.1 * k, abs=1e-9)
        assert scan.received_ns - scan.stamp_ns == 100_000_000
        assert scan.scan_time == pytest.approx(0.1)
        assert scan.time_increment == pytest.approx(0.1 / 480)
        assert len(scan.ranges) == 480
        assert scan.ranges.dtype == np.float32
    topics = {message.topic for message in messages}
    assert topics == {"/scan", "/ego_pose"} | {f"/truth/{name}" for name in simulate.truth_at(world, 0.0)}
    for topic in topics - {"/scan"}:
        stamps = np.array([message.stamp_ns for message in messages if message.topic == topic])
        np.testing.assert_array_equal(np.diff(stamps), 20_000_000)


def test_poses_are_the_truth():
    world = simulate.load("left_turn_in_front")
    poses = [m for m in simulate.record(world) if isinstance(m, Pose) and m.topic == "/truth/car"]
    car = simulate.truth_at(world, [seconds(pose.stamp_ns) for pose in poses])["car"]
    got = np.array([pose.xyyaw for pose in poses])
    np.testing.assert_allclose(got[:, 0], car.x)
    np.testing.assert_allclose(got[:, 1], car.y)
    np.testing.assert_allclose(wrap(got[:, 2] - car.yaw), 0.0, atol=1e-9)
    np.testing.assert_array_equal(poses[0].extent, [4.5, 1.8])
    assert poses[0].body == "car"


def test_faults_touch_the_header_alone():
    world = simulate.load("crossing")
    right = scans_of(simulate.record(world))
    wrong = scans_of(simulate.record(world, faults={"time_scale": 1e-3, "reverse": True}))
    for a, b in zip(right, wrong, strict=True):
        assert b.scan_time == pytest.approx(1e-4)
        assert b.time_increment == pytest.approx(1e-4 / 480)
        np.testing.assert_array_equal(b.ranges, a.ranges[::-1])
        np.testing.assert_allclose(beams(b)[1], beams(a)[1][::-1], atol=1e-4)
    with pytest.raises(InputError, match="time_scale, reverse"):
        simulate.record(world, faults={"time": 1.0})


# ------------------------------------------------------------------ scenario files


def test_all_scenarios_are_there():
    assert simulate.names() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_every_scenario_runs_and_shows_its_vehicles(name):
    world = simulate.load(name)
    scans = scans_of(simulate.record(world))
    assert len(scans) == round(world.duration_s * 10.0)
    seen = dict.fromkeys((vehicle.name for vehicle in world.vehicles), 0)
    for scan in scans:
        hits = hits_on(world, scan)
        seen = {vehicle: scans_with + (hits[vehicle] >= 4) for vehicle, scans_with in seen.items()}
    assert min(seen.values()) >= 40
    assert len(world.walls) + len(world.poles) >= 2


@pytest.mark.parametrize("name", NAMES)
def test_nothing_drives_through_anything(name):
    world = simulate.load(name)
    t = np.arange(0.0, world.duration_s, 0.1)
    bodies = {**simulate.truth_at(world, t), "rider": simulate.rider_at(world, t)}
    standing = shapely.union_all(
        [shapely.LineString(wall.points_m) for wall in world.walls]
        + [shapely.Point(pole.x_m, pole.y_m).buffer(pole.radius_m) for pole in world.poles]
    )
    for i in range(len(t)):
        outlines = [outline(body, i) for body in bodies.values()]
        tree = shapely.STRtree(outlines)
        a, b = tree.query(outlines, predicate="dwithin", distance=0.2)
        assert np.array_equal(a, b)
        assert min(shapely.distance(standing, outlines)) > 0.2


@pytest.mark.parametrize("name", NAMES)
def test_contact_times_agree_with_shapely(name):
    world = simulate.load(name)
    contacts = simulate.contact_times(world)
    t = np.arange(0.0, world.duration_s + 0.005, 0.01)
    rider = simulate.rider_at(world, t)
    for body, truth in simulate.truth_at(world, t).items():
        touching = [i for i in range(len(t)) if outline(truth, i).intersects(outline(rider, i))]
        if contacts[body] is None:
            assert not touching
        else:
            assert t[touching[0]] - 0.01 <= contacts[body] <= t[touching[0]] + 1e-6


def test_the_papers_experiments_go_where_their_names_say():
    def ends(name):
        world = simulate.load(name)
        rider = simulate.rider_at(world, [0.0, world.duration_s])
        return simulate.truth_at(world, [0.0, world.duration_s])["car"], rider

    car, _ = ends("crossing")
    assert car.y[0] > 5.0  # left of the rider, who looks along x
    assert car.y[1] < -5.0
    assert car.x[0] == pytest.approx(car.x[1])
    assert car.speed[1] > car.speed[0] > 0.0
    car, _ = ends("left_turn_in_front")
    assert car.y[0] < -5.0
    assert abs(wrap(car.yaw - np.deg2rad([90.0, 180.0]))) == pytest.approx([0.0, 0.0], abs=0.01)
    assert car.x[1] < 0.0 < car.y[1]  # leaves in its own lane, left of the rider
    car, _ = ends("oncoming")
    assert car.x[0] > 0.0 > car.x[1]
    assert np.all(car.y > 0.0)
    car, _ = ends("oncoming_left_turn")
    assert car.x[0] > 20.0
    assert car.y[0] > 0.0 > car.y[1]
    assert car.x[1] < 6.0
    car, rider = ends("overtaking")
    assert car.x[0] < rider.x[0]
    assert car.x[1] > rider.x[1]
    assert 1.0 <= car.y[0] - 0.9 - 0.3 <= 1.5
    assert (rider.speed[0], car.speed[0]) == (5.0, 11.0)


def test_demo_has_two_collision_courses_and_harmless_traffic():
    world = simulate.load("demo")
    assert [v.name for v in world.vehicles if v.collision_course] == ["brakes_late", "runs_light"]
    contacts = simulate.contact_times(world)
    assert contacts.pop("runs_light") == pytest.approx(13.96, abs=1e-5)  # front 0.3 m from the rider's path
    assert set(contacts.values()) == {None}
    assert len(world.pedestrians) >= 1
    assert len(world.parked) >= 3
    late = simulate.truth_at(world, [5.8, 6.3, 14.0])["brakes_late"]
    np.testing.assert_allclose(late.acceleration, [0.0, -8.0, 0.0])
    assert late.speed[-1] == 0.0
    assert late.y[-1] + 2.25 < -0.3 - 0.8  # stands short of the rider's path
    t = np.arange(0.0, 14.0, 0.05)
    rider, truth = simulate.rider_at(world, t), simulate.truth_at(world, t)
    for name in (*HARMLESS, *(parked.name for parked in world.parked)):
        gap = min(outline(truth[name], i).distance(outline(rider, i)) for i in range(len(t)))
        assert gap >= 1.2


def test_demo_time_to_contact_while_speeds_are_held():
    world = simulate.load("demo")
    for t in np.arange(1.0, 13.9, 0.25):
        left = simulate.time_to_contact(world, t)
        expected = {"runs_light": 13.96 - t}
        if t < 5.87:
            expected["brakes_late"] = (40.95 - 2.25 - 0.3) / 6.0 - t
        for name, value in left.items():
            due = expected.get(name, np.inf)
            if name == "brakes_late" and 5.87 <= t < 6.7:
                continue  # brakes: on course until it is slow enough
            assert value == (pytest.approx(due, abs=1e-5) if due < 6.0 else np.inf)


@pytest.mark.parametrize("name", ["brakes_late", "runs_light"])
def test_demo_collision_courses_are_in_sight_long_enough(name):
    world = simulate.load("demo")
    due = 13.96 if name == "runs_light" else 6.4
    scans = [s for s in scans_of(simulate.record(world)) if due - 3.6 <= seconds(s.stamp_ns) <= due - 0.1]
    assert len(scans) >= 35
    assert min(hits_on(world, scan)[name] for scan in scans) >= 4


def test_demo_sees_walls_pedestrians_and_parked_cars():
    world = simulate.load("demo")
    seen, on_walls = dict.fromkeys(simulate.truth_at(world, 0.0), 0), 0
    walls = shapely.union_all([shapely.LineString(wall.points_m) for wall in world.walls])
    for scan in scans_of(simulate.record(world))[::5]:
        hits = hits_on(world, scan)
        seen = {name: max(most, hits[name]) for name, most in seen.items()}
        on_walls += int(np.sum(shapely.dwithin(shapely.points(points(world, scan)[1]), walls, 0.1)))
    assert min(seen.values()) >= 4
    assert on_walls > 1000


def test_a_scenario_from_a_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('title = "mine"\nduration_s = 1\nvehicles = [{ name = "car", x_m = 9, y_m = 0 }]\n')
    world = simulate.load(path)
    assert world.vehicles[0].length_m == 4.5
    assert len(scans_of(simulate.record(world))) == 10


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "duration_s"),
        ("duration_s = -1", "duration_s"),
        ('vehicles = [{ name = "a", x_m = 0, y_m = 0, speed = 3 }]', "did you mean speed_mps"),
        ("vehicles = [{ manoeuvres = [{ duration = 3 }] }]", "did you mean duration_s"),
        ("sensor = { faults = { time = 3 } }", "did you mean time_scale"),
        ("wall = []", "did you mean walls"),
        ('vehicles = [{ name = "a", x_m = nan, y_m = 0 }]', "x_m"),
        ('vehicles = [{ name = "A b", x_m = 0, y_m = 0 }]', "name"),
        ('parked = [{ name = "a", x_m = 0, y_m = 0 }, { name = "a", x_m = 0, y_m = 9 }]', "twice"),
        ("sensor = { range_max_m = 0.05 }", "range_max_m"),
        ("walls = [{ points_m = [[0, 0]] }]", "walls"),
        ("poles = ", "not TOML"),
    ],
)
def test_a_wrong_file_is_one_clear_line(tmp_path, text, words):
    path = tmp_path / "wrong.toml"
    duration = "" if "duration_s" in (text, words) else "duration_s = 1"
    path.write_text(f'title = "wrong"\n{duration}\n{text}\n')
    with pytest.raises(InputError, match=words) as error:
        simulate.load(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_unknown_names_and_missing_files(tmp_path):
    with pytest.raises(InputError, match="want crossing"):
        simulate.load("crosing")
    with pytest.raises(InputError, match="cannot read"):
        simulate.load(tmp_path / "none.toml")


def test_every_key_and_scenario_is_documented():
    page = (Path(__file__).parents[1] / "docs" / "scenarios.md").read_text()
    keys = {key for part in PARTS.values() for key in part.__struct_fields__} | set(NAMES)
    assert {key for key in keys if f"`{key}`" not in page and f"[{key}]" not in page} == set()
