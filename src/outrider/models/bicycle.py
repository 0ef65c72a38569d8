"""Kinematic bicycle in the rear-axle slip form: steering enters through the slip of the body centre.

    X' = V cos(psi + beta)    Y' = V sin(psi + beta)    V' = A    A' = J
    psi' = V sin(beta) / l_r                            beta = atan(l_r tan(delta) / (l_f + l_r))

X, Y body centre [m], V signed speed [m/s], A acceleration along the course [m/s2], J jerk [m/s3], psi yaw
[rad], beta slip [rad], delta steering angle of the front wheel [rad], l_r and l_f body centre to rear and
front axle [m].
Source: Alai & Rajamani 2023, IEEE Trans. Intelligent Vehicles, eq. 1-10; the arc is integrated here.

Every function takes numbers or arrays of one shape, and compiles in Numba as it stands.
"""

from typing import Any, NamedTuple

import numpy as np

REAR_AXLE = 2.0  # l_r [m]
WHEELBASE = 4.0  # l_f + l_r [m]


class State(NamedTuple):
    """Body centre and motion; each a number or an array."""

    X: Any  # [m]
    Y: Any  # [m]
    V: Any  # along the course, negative when reversing [m/s]
    A: Any  # [m/s2]
    psi: Any  # yaw, not wrapped [rad]
    beta: Any  # slip [rad]


def slip(delta: Any, l_r: Any = REAR_AXLE, wheelbase: Any = WHEELBASE) -> Any:
    """Slip [rad] of the body centre at steering angle delta [rad]."""
    return np.arctan(l_r * np.tan(delta) / wheelbase)


def steering(beta: Any, l_r: Any = REAR_AXLE, wheelbase: Any = WHEELBASE) -> Any:
    """Steering angle [rad] that gives slip beta [rad]; undoes `slip`."""
    return np.arctan(wheelbase * np.tan(beta) / l_r)


def yaw_rate(s: State, l_r: Any = REAR_AXLE) -> Any:
    """Yaw rate [rad/s]."""
    return s.V * np.sin(s.beta) / l_r


def rhs(s: State, jerk: Any = 0.0, slip_rate: Any = 0.0, l_r: Any = REAR_AXLE) -> State:
    """Time derivative of the state under jerk [m/s3] and slip rate [rad/s]."""
    chi = s.psi + s.beta
    return State(s.V * np.cos(chi), s.V * np.sin(chi), s.A, jerk, yaw_rate(s, l_r), slip_rate)


def arc(s: State, dt: Any, l_r: Any = REAR_AXLE) -> State:
    """State after dt [s] at constant acceleration and slip: exact, a circle of curvature sin(beta) / l_r."""
    way = s.V * dt + 0.5 * s.A * dt * dt
    half_turn = 0.5 * way * np.sin(s.beta) / l_r
    chord = way * np.sinc(half_turn / np.pi)
    chi = s.psi + s.beta + half_turn
    return State(
        s.X + chord * np.cos(chi),
        s.Y + chord * np.sin(chi),
        s.V + s.A * dt,
        s.A,
        s.psi + 2.0 * half_turn,
        s.beta,
    )


def rk4(s: State, dt: Any, jerk: Any = 0.0, slip_rate: Any = 0.0, l_r: Any = REAR_AXLE) -> State:
    """State after one classical Runge-Kutta step of dt [s] at constant jerk and slip rate; of order 4."""
    k1 = rhs(s, jerk, slip_rate, l_r)
    k2 = rhs(_ahead(s, k1, 0.5 * dt), jerk, slip_rate, l_r)
    k3 = rhs(_ahead(s, k2, 0.5 * dt), jerk, slip_rate, l_r)
    k4 = rhs(_ahead(s, k3, dt), jerk, slip_rate, l_r)
    s = _ahead(_ahead(s, k1, dt / 6.0), k2, dt / 3.0)
    return _ahead(_ahead(s, k3, dt / 3.0), k4, dt / 6.0)


def _ahead(s: State, k: State, h: Any) -> State:
    return State(
        s.X + h * k.X,
        s.Y + h * k.Y,
        s.V + h * k.V,
        s.A + h * k.A,
        s.psi + h * k.psi,
        s.beta + h * k.beta,
    )
