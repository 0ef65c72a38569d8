"""A car that slides: single track with saturating tyres, driven along a course, seen by imperfect sensors.

    s' = (vx cos e - vy sin e) / (1 - k n)      n' = vx sin e + vy cos e      e' = r - k s'
    vx' = (Fxf cos d - Fyf sin d + Fxr) / m + vy r
    vy' = (Fyf cos d + Fxf sin d + Fyr) / m - vx r
    r'  = ((Fyf cos d + Fxf sin d) lf - Fyr lr) / Iz
    d'  = (asked - d) / LAG

s way, n offset to the left of the course, e direction against it, k its curvature; d angle of the front
wheels. An axle's force is the magic formula of Pacejka, its slope the car's stiffness, its peak friction
times grip times load; load moves to the rear when speeding up; force along takes from force across, as in
an ellipse.
"""

from __future__ import annotations

from functools import lru_cache
from math import atan, atan2, cos, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.cars import Car, checked
from outrider.errors import InputError
from outrider.kernel import kernel, rk4, to_row
from outrider.lateral.course import Course, G, plan
from outrider.lateral.log import Log

Array = npt.NDArray[np.float64]

SHAPE, BEND = 1.45, -0.2  # C and E of the magic formula
LAG = 0.05  # of the steering [s]
HEIGHT = 0.55  # of the centre of gravity [m]
FRONT = 0.6  # share of the front axle in driving and braking
SUBSTEPS = 5  # of Runge-Kutta in a step of the driver
DT = 0.01  # the driver acts, and the sensors are read, this often [s]
WIDEST = 12.0  # farther from the course the drive is over [m]
SPUN = 0.4  # and so it is where vy is more than this share of vx


class State(NamedTuple):
    """Of the car; the body frame has x forward and y left."""

    s: float  # way along the course [m]
    n: float  # offset from it, to the left [m]
    e: float  # yaw against its direction [rad]
    vx: float  # [m/s]
    vy: float  # of the centre of gravity [m/s]
    r: float  # yaw rate [rad/s]
    d: float  # angle of the front wheels [rad]


class Asked(NamedTuple):
    """What the driver asks for."""

    steering: float  # angle of the front wheels [rad]
    along: float  # acceleration [m/s2]


class Road(NamedTuple):
    """A course, how fast to take it, and how slippery it is."""

    step: float  # [m]
    curvature: Array  # (n,) [1/m]
    speed: Array  # (n,) [m/s]
    friction: float  # [-]


class World(NamedTuple):
    """All that does not change."""

    car: Car
    road: Road


@kernel
def at(values: Any, s: float, step: float) -> float:
    """Value at way s, straight between the points (n,), which repeat."""
    k = s / step
    i = int(np.floor(k))
    n = len(values)
    f: float = values[i % n] + (k - i) * (values[(i + 1) % n] - values[i % n])
    return f


@kernel
def tyre(slip: float, stiffness: float, peak: float) -> float:
    """Force across [N] at a slip angle [rad]: the magic formula, slope `stiffness`, at most `peak` [N]."""
    x = stiffness * slip / (SHAPE * peak)
    return peak * sin(SHAPE * atan(x - BEND * (x - atan(x))))


@kernel
def forces(s: State, y: Asked, c: World) -> tuple[float, float, float, float]:
    """Force along and across of the front axle, then of the rear axle, in the wheels' frame [N]."""
    car = c.car
    mu_f, mu_r = c.road.friction * car.front_grip, c.road.friction * car.rear_grip
    base = car.front + car.rear
    lifted = car.mass * y.along * HEIGHT / base
    front = car.mass * G * car.rear / base - lifted
    rear = car.mass * G * car.front / base + lifted
    along_f = min(max(FRONT * car.mass * y.along, -0.95 * mu_f * front), 0.95 * mu_f * front)
    along_r = min(max((1.0 - FRONT) * car.mass * y.along, -0.95 * mu_r * rear), 0.95 * mu_r * rear)
    across_f = tyre(s.d - atan2(s.vy + car.front * s.r, s.vx), car.front_stiffness, mu_f * front)
    across_r = tyre(-atan2(s.vy - car.rear * s.r, s.vx), car.rear_stiffness, mu_r * rear)
    across_f *= sqrt(1.0 - (along_f / (mu_f * front)) ** 2)
    across_r *= sqrt(1.0 - (along_r / (mu_r * rear)) ** 2)
    return along_f, across_f, along_r, across_r


@kernel
def rates(s: State, y: Asked, c: World) -> State:
    """The equations of motion: the time derivative of the state."""
    car = c.car
    k = at(c.road.curvature, s.s, c.road.step)
    along_f, across_f, along_r, across_r = forces(s, y, c)
    x_f = along_f * cos(s.d) - across_f * sin(s.d)
    y_f = across_f * cos(s.d) + along_f * sin(s.d)
    ds = (s.vx * cos(s.e) - s.vy * sin(s.e)) / (1.0 - k * s.n)
    return State(
        ds,
        s.vx * sin(s.e) + s.vy * cos(s.e),
        s.r - k * ds,
        (x_f + along_r) / car.mass + s.vy * s.r,
        (y_f + across_r) / car.mass - s.vx * s.r,
        (y_f * car.front - across_r * car.rear) / car.inertia,
        (y.steering - s.d) / LAG,
    )


@kernel
def driver(s: State, c: World) -> Asked:
    """Steering for the curvature ahead, against offset and course error; acceleration to the plan."""
    car, road = c.car, c.road
    v = max(s.vx, 3.0)
    base = car.front + car.rear
    under = car.mass / base * (car.rear / car.front_stiffness - car.front / car.rear_stiffness)
    ahead = at(road.curvature, s.s + 0.15 * v, road.step)
    gain = (base + under * v * v) / (v * v)  # wheel angle that a lateral acceleration takes
    drift = v * sin(s.e + atan2(s.vy, v))
    back = -gain * (2.0 * s.n + 2.4 * drift) - 0.05 * (s.r - ahead * v)
    steering = gain * v * v * ahead + min(max(back, -0.25), 0.25)
    goal = at(road.speed, s.s + 0.4 * v, road.step)
    along = min(max(2.5 * (goal - s.vx), -5.0 * road.friction), 4.0 * road.friction)
    return Asked(min(max(steering, -0.6), 0.6), along)


@lru_cache
def _driven() -> Any:
    """Compiled drive(first, world, until, out (n, 9)) -> rows filled: vx, vy, r, ay, d, s, n, e, along."""
    from outrider import compiler

    def drive(s, world, until, out):  # type: ignore[no-untyped-def]
        for k in range(len(out)):
            asked = driver(s, world)
            slope = rates(s, asked, world)
            to_row((s.vx, s.vy, s.r, slope.vy + s.vx * s.r, s.d, s.s, s.n, s.e, asked.along), out[k])
            if s.s >= until or abs(s.n) > WIDEST or abs(s.vy) > SPUN * abs(s.vx):
                return k
            s = rk4(rates, s, asked, Asked(0.0, 0.0), world, DT, SUBSTEPS)
        return len(out)

    return compiler.compiled(drive)


class Drive(NamedTuple):
    """What happened, without sensors: columns (n,) every `DT`."""

    t: Array  # [s]
    vx: Array  # [m/s]
    vy: Array  # [m/s]
    yaw_rate: Array  # [rad/s]
    ay: Array  # of the centre of gravity, to the left [m/s2]
    steering: Array  # angle of the front wheels [rad]
    s: Array  # way [m]
    n: Array  # offset [m]
    whole: bool  # the course was driven to its end


def drive(
    course: Course, car: Car, friction: float = 1.0, *, rounds: float = 1.0, speed: Any = None
) -> Drive:
    """Drive along a course, `rounds` times; speed (n,) [m/s] at its points, `course.plan` if None.

    The drive ends early where the car slides off. InputError for a car, friction or speed that cannot be.
    """
    car = checked(car, "car")
    speed = plan(course, friction) if speed is None else np.ascontiguousarray(speed, float)
    if speed.shape != course.curvature.shape or not (speed > 1.0).all():
        raise InputError(f"speeds {speed.shape}; want {course.curvature.shape}, all above 1 m/s")
    if not (0.0 < friction <= 2.0 and 0.0 < rounds <= 1000.0):
        raise InputError(
            f"friction {friction:g}, rounds {rounds:g}; want friction in (0, 2], rounds in (0, 1000]"
        )
    world = World(car, Road(course.step, np.ascontiguousarray(course.curvature), speed, float(friction)))
    longest = int(2.0 * rounds * float((course.step / speed).sum()) / DT) + 1000
    out = np.empty((longest, 9))
    first = State(0.0, 0.0, 0.0, float(speed[0]), 0.0, 0.0, 0.0)
    n = _driven()(first, world, rounds * course.length, out)
    vx, vy, r, ay, d, s, offset = (column.copy() for column in out[:n, :7].T)
    whole = bool(n < longest and out[n, 5] >= rounds * course.length)
    return Drive(DT * np.arange(n), vx, vy, r, ay, d, s, offset, whole)


# ------------------------------------------------------------------ sensors


class Noise(NamedTuple):
    """Errors of the sensors, white noise as standard deviations at 100 Hz, and constant ones."""

    ay: float = 0.0  # [m/s2]
    ay_bias: float = 0.0  # [m/s2]
    yaw_rate: float = 0.0  # [rad/s]
    yaw_rate_bias: float = 0.0  # [rad/s]
    speed_scale: float = 0.0  # what is read is (1 + scale) times the truth [-]
    steering: float = 0.0  # [rad]
    steering_bias: float = 0.0  # [rad]


NOISES = {
    "none": Noise(),
    "mems": Noise(0.08, 0.10, 0.005, 0.003, 0.01, 0.001, 0.002),
    "paper": Noise(ay=0.2, yaw_rate=0.1),  # variances 0.04 and 0.01
}


def sensed(truth: Drive, car: Car, noise: Noise, seed: int) -> Log:
    """What sensors log of a drive; of the car its steering gain and offset and its roll are used."""
    rng = np.random.default_rng(seed)
    n = len(truth.t)
    ay, r, steering = rng.standard_normal((3, n))
    wheels = truth.steering + noise.steering * steering + noise.steering_bias
    return Log(
        t=truth.t,
        vx=truth.vx * (1.0 + noise.speed_scale),
        yaw_rate=truth.yaw_rate + noise.yaw_rate * r + noise.yaw_rate_bias,
        ay=truth.ay * (1.0 + G * car.roll_gain) + noise.ay * ay + noise.ay_bias,
        steering=(wheels - car.steering_offset) / car.steering_gain,
        vy=truth.vy,
        faults=() if truth.whole else (f"slid off the course after {truth.t[-1]:.1f} s",),
    )


def simulate(
    course: Course,
    car: Car,
    friction: float = 1.0,
    noise: str | Noise = "none",
    seed: int = 0,
    speed: Array | None = None,
) -> Log:
    """A log, with the true vy, of a car driven once along a course; its faults tell of an early end.

    noise: a name of `NOISES`, or numbers. speed (n,): at the course's points, `course.plan` if None [m/s].
    InputError for an unknown noise, and as `drive` says.
    """
    if isinstance(noise, str):
        if noise not in NOISES:
            raise InputError(f"noise {noise!r} is not known; want one of {', '.join(NOISES)}")
        noise = NOISES[noise]
    return sensed(drive(course, car, friction, speed=speed), car, noise, seed)
