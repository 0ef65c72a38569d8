"""The car that slides: what holds at small slip, at the limit, in a mirror; what the sensors add."""

import numpy as np
import pytest

from outrider import cars
from outrider.errors import InputError
from outrider.kernel import rk4
from outrider.lateral import course, plant
from outrider.lateral.plant import Asked, Drive, Noise, Road, State, World
from outrider.models import single_track

pytestmark = pytest.mark.once

B = cars.load("b_class")
TURN = course.Course(1.0, np.full(600, 1.0 / 40.0), np.zeros(600), np.zeros(600))


def flat(friction=1.0, n=400):
    return World(B, Road(1.0, np.zeros(n), np.full(n, 12.0), friction))


def steady(radius, speed, friction=1.0, car=B):
    bend = course.Course(1.0, np.full(600, 1.0 / radius), np.zeros(600), np.zeros(600))
    return plant.drive(bend, car, friction, speed=np.full(600, speed))


def test_at_small_slip_it_is_the_linear_single_track():
    s = State(0.0, 0.0, 0.0, 12.0, 0.003, 0.004, 0.0005)
    slope, m = plant.rates(s, Asked(0.0, 0.0), flat()), single_track.linear(12.0, B)
    assert slope.vy == pytest.approx(m.a11 * s.vy + m.a12 * s.r + m.b1 * s.d, rel=2e-3)
    assert slope.r == pytest.approx(m.a21 * s.vy + m.a22 * s.r + m.b2 * s.d, rel=2e-3)


def test_a_gentle_bend_is_driven_as_the_linear_model_says():
    drive = steady(400.0, 12.0)
    m, last = single_track.linear(12.0, B), -1
    A = np.array([[m.a11, m.a12], [m.a21, m.a22]])
    vy, r = np.linalg.solve(A, -np.array([m.b1, m.b2]) * drive.steering[last])
    assert drive.vy[last] == pytest.approx(vy, rel=0.02)
    assert drive.yaw_rate[last] == pytest.approx(r, rel=0.02)
    assert drive.yaw_rate[last] == pytest.approx(12.0 / 400.0, rel=0.01)


@pytest.mark.parametrize("friction", [1.0, 0.5, 0.2])
def test_no_tyre_gives_more_than_friction(friction):
    slips = np.linspace(-1.5, 1.5, 301)
    forces = np.array([plant.tyre(a, 123e3, friction * 6000.0) for a in slips])
    assert np.abs(forces).max() <= friction * 6000.0
    assert np.abs(forces).max() == pytest.approx(friction * 6000.0, rel=1e-2)
    assert forces == pytest.approx(-forces[::-1], abs=1e-6)
    assert plant.tyre(1e-6, 123e3, friction * 6000.0) == pytest.approx(0.123, rel=1e-6)


def test_braking_takes_from_cornering_and_loads_the_front():
    s = State(0.0, 0.0, 0.0, 12.0, 0.0, 0.0, 0.06)
    free, braked = plant.forces(s, Asked(0.0, 0.0), flat()), plant.forces(s, Asked(0.0, -8.0), flat())
    assert (free[0], free[2]) == (0.0, 0.0)
    assert braked[0] == pytest.approx(plant.FRONT * B.mass * -8.0)
    assert 0.0 < braked[1] < free[1]
    hard = plant.forces(s, Asked(0.0, -30.0), flat())  # more than there is: the axle keeps within its circle
    load = B.mass * plant.G * B.rear / (B.front + B.rear) + B.mass * 30.0 * plant.HEIGHT / (B.front + B.rear)
    assert np.hypot(hard[0], hard[1]) <= load


def test_in_a_mirror_all_is_mirrored():
    made = course.winding(2, 800.0)
    right = course.Course(made.step, -made.curvature, made.x, -made.y)
    a, b = plant.drive(made, B, 0.7), plant.drive(right, B, 0.7)
    assert b.vx == pytest.approx(a.vx, abs=1e-9)
    for name in ("vy", "yaw_rate", "ay", "steering", "n"):
        assert getattr(b, name) == pytest.approx(-getattr(a, name), abs=1e-9)


def test_the_kinematics_hold():
    d = plant.drive(course.winding(2, 800.0), B)
    slope = np.gradient(d.vy, d.t)
    inner = slice(2, -2)
    assert d.ay[inner] == pytest.approx((slope + d.vx * d.yaw_rate)[inner], abs=0.3)
    assert np.sqrt(np.mean((d.ay - slope - d.vx * d.yaw_rate)[inner] ** 2)) < 0.02


def in_python(world, steps, substeps):
    """The loop of the drive, uncompiled."""
    s, rows = State(0.0, 0.0, 0.0, float(world.road.speed[0]), 0.0, 0.0, 0.0), []
    for _ in range(steps):
        rows.append(s)
        s = rk4(plant.rates, s, plant.driver(s, world), Asked(0.0, 0.0), world, plant.DT, substeps)
    return np.array(rows)


def test_the_step_is_small_enough_and_compiling_changes_nothing():
    made = course.winding(2, 800.0)
    world = World(B, Road(made.step, made.curvature, course.plan(made), 1.0))
    d = plant.drive(made, B)
    here, fine = in_python(world, 600, plant.SUBSTEPS), in_python(world, 600, 4 * plant.SUBSTEPS)
    for column, name in ((0, "s"), (3, "vx"), (4, "vy"), (5, "yaw_rate"), (6, "steering")):
        assert getattr(d, name)[:600] == pytest.approx(here[:, column], abs=1e-9)
    assert np.ptp(here[:, 4]) > 0.1
    assert here == pytest.approx(fine, abs=1e-5)


@pytest.mark.parametrize("car", ["b_class", "d_class"])
def test_a_course_is_driven_at_the_limit_it_was_planned_for(car):
    d = plant.drive(course.winding(1), cars.load(car))
    assert d.whole
    assert np.abs(d.n).max() < 1.0
    assert 7.5 < np.abs(d.ay).max() < 9.0
    assert d.vx.min() > 5.5
    assert d.vx.max() < 20.5


def test_too_fast_a_car_slides_off_and_the_log_says_so():
    log = plant.simulate(TURN, B, 0.4, speed=np.full(600, 18.0))
    assert log.faults
    assert "slid off" in log.faults[0]
    assert np.isfinite(log.vy).all()


def test_no_noise_is_the_truth():
    d = plant.drive(TURN, B, speed=np.full(600, 10.0))
    log = plant.sensed(d, B, Noise(), 3)
    for name in ("t", "vx", "vy", "yaw_rate", "ay", "steering"):
        assert np.array_equal(getattr(log, name), getattr(d, name))
    assert log.faults == ()


def test_noise_has_the_size_it_says_and_hangs_on_the_seed():
    n = 100_000
    zero = np.zeros(n)
    rest = Drive(0.01 * np.arange(n), zero + 10.0, zero, zero, zero, zero, zero, zero, True)
    log = plant.sensed(rest, B, plant.NOISES["mems"], 1)
    assert log.ay.std() == pytest.approx(0.08, rel=0.02)
    assert log.ay.mean() == pytest.approx(0.10, abs=0.002)
    assert log.yaw_rate.std() == pytest.approx(0.005, rel=0.02)
    assert log.vx == pytest.approx(10.1)
    paper = plant.sensed(rest, B, plant.NOISES["paper"], 1)
    assert paper.ay.var() == pytest.approx(0.04, rel=0.03)
    assert paper.yaw_rate.var() == pytest.approx(0.01, rel=0.03)
    assert np.array_equal(paper.ay, plant.sensed(rest, B, plant.NOISES["paper"], 1).ay)
    assert not np.array_equal(paper.ay, plant.sensed(rest, B, plant.NOISES["paper"], 2).ay)


def test_a_log_read_with_its_car_gives_the_wheel_angle_and_the_level_acceleration():
    odd = B._replace(steering_gain=0.06, steering_offset=0.01, roll_gain=0.016)
    d = plant.drive(TURN, odd, speed=np.full(600, 12.0))
    rows = plant.sensed(d, odd, Noise(), 0).samples(odd)
    assert rows[:, 4] == pytest.approx(d.steering, abs=1e-12)
    assert rows[:, 3] == pytest.approx(d.ay, abs=1e-12)


@pytest.mark.parametrize(
    "bad",
    [
        {"friction": 0.0},
        {"friction": float("nan")},
        {"noise": "loud"},
        {"speed": np.zeros(600)},
        {"speed": np.ones(5)},
        {"car": B._replace(mass=-1.0)},
    ],
)
def test_what_cannot_be_is_refused(bad):
    with pytest.raises(InputError):
        plant.simulate(**{"course": TURN, "car": B, **bad})
