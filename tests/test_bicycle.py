"""The bicycle model against closed forms, symmetry and the order of its integrator."""

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from outrider.geometry import rotate
from outrider.models import bicycle
from outrider.models.bicycle import State

CAR = State(3.0, -2.0, 7.0, -1.5, 0.4, 0.25)

angles = st.floats(-3.0, 3.0)
slips = st.floats(-0.35, 0.35)
places = st.floats(-100.0, 100.0)
speeds = st.floats(-20.0, 20.0)
accelerations = st.floats(-5.0, 5.0)
states = st.builds(State, places, places, speeds, accelerations, angles, slips)


def turned(s: State, angle: float, by: np.ndarray) -> State:
    """The state seen after the world was turned by angle and shifted."""
    X, Y = rotate(np.array([s.X, s.Y]), angle) + by
    return s._replace(X=X, Y=Y, psi=s.psi + angle)


def run(s: State, t: float, steps: int, **inputs: float) -> State:
    for _ in range(steps):
        s = bicycle.rk4(s, t / steps, **inputs)
    return s


def test_straight_on():
    s = bicycle.arc(State(1.0, 2.0, 3.0, 2.0, np.pi / 2.0, 0.0), 4.0)
    np.testing.assert_allclose(s, State(1.0, 2.0 + 12.0 + 16.0, 11.0, 2.0, np.pi / 2.0, 0.0), atol=1e-12)


def test_constant_speed_and_slip_go_round_a_circle():
    beta, l_r = 0.3, 1.5
    radius = l_r / np.sin(beta)
    turn = 2.0 * np.pi * radius / 5.0  # time of one round at 5 m/s
    start = State(0.0, 0.0, 5.0, 0.0, 0.7, beta)
    t = np.linspace(0.0, turn, 50)
    s = bicycle.arc(start, t, l_r)
    centre = radius * np.array([-np.sin(0.7 + beta), np.cos(0.7 + beta)])
    np.testing.assert_allclose(np.hypot(s.X - centre[0], s.Y - centre[1]), radius, rtol=1e-12)
    np.testing.assert_allclose([s.X[-1], s.Y[-1], s.psi[-1]], [0.0, 0.0, 0.7 + 2.0 * np.pi], atol=1e-12)
    half = bicycle.arc(start, 0.5 * turn, l_r)
    np.testing.assert_allclose([half.X, half.Y], 2.0 * centre, atol=1e-12)


def test_steering_round_the_rear_axle():
    """The rear axle's own velocity points along the body: that is what makes it a bicycle."""
    delta, l_r, wheelbase = 0.5, 1.2, 2.7
    s = State(0.0, 0.0, 4.0, 0.0, 0.9, bicycle.slip(delta, l_r, wheelbase))
    d = bicycle.rhs(s, l_r=l_r)
    rear = np.array([d.X, d.Y]) - l_r * d.psi * np.array([-np.sin(0.9), np.cos(0.9)])
    assert rotate(rear, -0.9)[1] == pytest.approx(0.0, abs=1e-12)
    assert d.psi == pytest.approx(rotate(rear, -0.9)[0] * np.tan(delta) / wheelbase)
    assert bicycle.steering(s.beta, l_r, wheelbase) == pytest.approx(delta)


@given(states, st.floats(0.0, 5.0), angles, places, places)
def test_turning_the_world_changes_nothing(s, dt, angle, x, y):
    by = np.array([x, y])
    for move in (bicycle.arc, bicycle.rk4):
        expected = turned(move(s, dt), angle, by)
        np.testing.assert_allclose(move(turned(s, angle, by), dt), expected, rtol=1e-9, atol=1e-8)


@given(states, st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_two_arcs_are_one(s, first, second):
    twice = bicycle.arc(bicycle.arc(s, first), second)
    np.testing.assert_allclose(twice, bicycle.arc(s, first + second), rtol=1e-9, atol=1e-8)


def test_arc_solves_the_equations():
    h = 1e-5
    before, after = bicycle.arc(CAR, 1.0 - h), bicycle.arc(CAR, 1.0 + h)
    slope = (np.array(after) - np.array(before)) / (2.0 * h)
    np.testing.assert_allclose(slope, bicycle.rhs(bicycle.arc(CAR, 1.0)), atol=1e-8)


def test_rk4_converges_to_the_arc_with_order_four():
    exact = np.array(bicycle.arc(CAR, 3.0))
    errors = [np.linalg.norm(np.array(run(CAR, 3.0, steps)) - exact) for steps in (10, 20, 40, 80)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    np.testing.assert_allclose(orders, 4.0, atol=0.15)


def test_rk4_integrates_jerk_and_slip_rate():
    s = run(CAR, 2.0, 400, jerk=0.8, slip_rate=-0.1)
    speed = CAR.V + CAR.A * 2.0 + 0.8 * 2.0
    np.testing.assert_allclose([s.V, s.A, s.beta], [speed, CAR.A + 1.6, CAR.beta - 0.2])
    t = np.linspace(0.0, 2.0, 20001)
    rate = (CAR.V + CAR.A * t + 0.4 * t**2) * np.sin(CAR.beta - 0.1 * t) / bicycle.REAR_AXLE
    assert s.psi == pytest.approx(CAR.psi + np.trapezoid(rate, t), abs=1e-8)


def test_numbers_arrays_and_compiled_code_agree():
    many = State(*(np.array([value, value]) for value in CAR))
    compiled = numba.njit(bicycle.arc)(CAR, 0.3, 2.0)
    for values in zip(bicycle.arc(CAR, 0.3), bicycle.arc(many, 0.3), compiled, strict=True):
        np.testing.assert_allclose(values[1], values[0], rtol=1e-14)
        np.testing.assert_allclose(values[2], values[0], rtol=1e-14)
