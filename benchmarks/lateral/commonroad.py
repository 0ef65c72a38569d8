"""Cars of the CommonRoad vehicle models as truth: single track with drift, and multi-body.

The package's own equations of motion, compiled as they stand; its car 2 scaled to the mass, inertia, axles
and stiffness asked for; our driver. Source: Althoff and Wuersching, "CommonRoad: Vehicle Models", 2020 (BSD).
"""

from __future__ import annotations

from collections import namedtuple
from functools import lru_cache
from typing import Any

import numba
import numpy as np
from numba.extending import register_jitable
from vehiclemodels import vehicle_dynamics_mb, vehicle_dynamics_std
from vehiclemodels.init_mb import init_mb
from vehiclemodels.init_std import init_std
from vehiclemodels.utils import tire_model
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

from outrider import compiler
from outrider.cars import Car
from outrider.lateral import plant
from outrider.lateral.course import Course, G, plan
from outrider.lateral.plant import DT, LAG, SPUN, WIDEST, Drive, Road, State, World

KINDS = ("drift", "multibody")
SUBSTEPS = (20, 10)  # of the classical Runge-Kutta method in a step of the driver: wheels are stiff when slow
SHIFTS = ("p_hy1", "p_hy3", "p_vy1", "p_vy3", "r_hy1", "r_vy1", "r_vy3")  # of the tyre: they jump with camber
STIFF = 0.5  # weight of the front axle in the one tyre that both axles have


def parameters(car: Car, friction: float) -> Any:
    """The package's parameters of its car 2, made as heavy, long and stiff as `car`; tyres times friction."""
    p = setup_vehicle_parameters(vehicle_id=2)
    heavier, base = car.mass / p.m, car.front + car.rear
    for name in ("m_s", "m_uf", "m_ur", "K_sf", "K_sdf", "K_sr", "K_sdr", "K_tsf", "K_tsr", "K_ras", "K_rad"):
        setattr(p, name, getattr(p, name) * heavier)
    for name in ("K_zt", "I_Phi_s", "I_y_s", "I_uf", "I_ur"):
        setattr(p, name, getattr(p, name) * heavier)
    p.m, p.I_z, p.a, p.b, p.K_lt = car.mass, car.inertia, car.front, car.rear, p.K_lt / heavier
    load_f, load_r = car.mass * G * car.rear / base, car.mass * G * car.front / base
    p.tire.p_ky1 = -(STIFF * car.front_stiffness / load_f + (1.0 - STIFF) * car.rear_stiffness / load_r)
    p.tire.p_dy1 *= friction
    p.tire.p_dx1 *= friction
    for name in SHIFTS:
        setattr(p.tire, name, 0.0)
    p.steering.v_min, p.steering.v_max = -20.0, 20.0
    return p


def frozen(values: Any, name: str = "Parameters") -> Any:
    """A dataclass as a named tuple of floats, nested where it is: what compiled code reads."""
    found = {k: v for k, v in vars(values).items() if v is not None and k != "trailer"}
    made = {
        k: frozen(v, k) if hasattr(v, "__dict__") else float(v)
        for k, v in found.items()
        if hasattr(v, "__dict__") or isinstance(v, int | float)
    }
    return namedtuple(name, made)(**made)


@lru_cache
def _compiled() -> tuple[Any, Any]:
    """The package's two right-hand sides, compiled as they stand."""
    modules = (vehicle_dynamics_mb, vehicle_dynamics_std)
    for helper in ("steering_constraints", "acceleration_constraints", "vehicle_dynamics_ks_cog"):
        register_jitable(getattr(modules[0], helper))
    for helper in ("sign", "formula_longitudinal", "formula_lateral"):
        register_jitable(getattr(tire_model, helper))
    for helper in ("formula_longitudinal_comb", "formula_lateral_comb"):
        register_jitable(getattr(tire_model, helper))
    return numba.njit(modules[1].vehicle_dynamics_std), numba.njit(modules[0].vehicle_dynamics_mb)


@lru_cache
def _loop(kind: str) -> Any:
    """Compiled drive of one kind: as `plant._driven`, with the package's state vector."""
    right, substeps = _compiled()[KINDS.index(kind)], SUBSTEPS[KINDS.index(kind)]
    many = kind == "multibody"

    def body(x, slope):  # type: ignore[no-untyped-def]
        """vx, vy, r, ay as a sensor in the body reads it, d; x forward, y left."""
        if many:  # z points down, y to the right; what rolls to the outside feels gravity
            ay = slope[10] + x[3] * x[5] - G * np.sin(x[6])
            return x[3], -x[10], -x[5], -ay, -x[2]
        vx, vy = x[3] * np.cos(x[6]), x[3] * np.sin(x[6])
        ay = slope[3] * np.sin(x[6]) + x[3] * np.cos(x[6]) * (slope[6] + x[5])
        return vx, vy, x[5], ay, x[2]

    body = numba.njit(body)
    driver, at = compiler.compiled(plant.driver), compiler.compiled(plant.at)
    sign = -1.0 if many else 1.0

    def f(x, u, p):  # type: ignore[no-untyped-def]
        return np.array(right(x, u, p))

    f = numba.njit(f)

    def drive(x, p, world, until, out):  # type: ignore[no-untyped-def]
        s, n, e, h, road = 0.0, 0.0, 0.0, DT / substeps, world.road
        for k in range(len(out)):
            vx, vy, r, ay, d = body(x, f(x, np.zeros(2), p))
            asked = driver(State(s, n, e, vx, vy, r, d), world)
            vx, vy, r, ay, d = body(x, f(x, np.array([0.0, asked.along]), p))
            out[k] = np.array([vx, vy, r, ay, d, s, n, e, asked.along])
            if s >= until or abs(n) > WIDEST or abs(vy) > SPUN * abs(vx) or not np.isfinite(vy):
                return k
            for _ in range(substeps):
                u = np.array([(sign * asked.steering - x[2]) / LAG, asked.along])
                k1 = f(x, u, p)
                k2 = f(x + 0.5 * h * k1, u, p)
                k3 = f(x + 0.5 * h * k2, u, p)
                k4 = f(x + h * k3, u, p)
                x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
                vx, vy, r, ay, d = body(x, k1)
                c = at(road.curvature, s, road.step)
                ds = (vx * np.cos(e) - vy * np.sin(e)) / (1.0 - c * n)
                n += h * (vx * np.sin(e) + vy * np.cos(e))
                e += h * (r - c * ds)
                s += h * ds
        return len(out)

    return numba.njit(drive)


def drive(kind: str, course: Course, car: Car, friction: float = 1.0, speed: Any = None) -> Drive:
    """Drive one of the package's cars, made like `car`, once along a course; as `plant.drive`."""
    p = parameters(car, friction)
    speed = plan(course, friction) if speed is None else speed
    world = World(car, Road(course.step, course.curvature, speed, float(friction)))
    core = [0.0, 0.0, 0.0, float(speed[0]), 0.0, 0.0, 0.0]
    first = np.array(init_mb(core, p) if kind == "multibody" else init_std(core, p), float)
    out = np.empty((int(2.0 * float((course.step / speed).sum()) / DT) + 1000, 9))
    n = _loop(kind)(first, frozen(p), world, course.length, out)
    vx, vy, r, ay, d, s, offset = (column.copy() for column in out[:n, :7].T)
    whole = bool(n < len(out) and out[n, 5] >= course.length)
    return Drive(DT * np.arange(n), vx, vy, r, ay, d, s, offset, whole)
