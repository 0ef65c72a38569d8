"""Scenarios as recordings with truth: bodies drive on exact arcs, a lidar looks at them beam by beam.

Times of the functions here are seconds from the scenario's beginning; stamps in messages begin at `EPOCH_NS`.
Nothing depends on the clock of the machine: the same scenario and seed give the same messages.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from outrider import lidar_model
from outrider.errors import InputError
from outrider.geometry import compose, rotate, wrap
from outrider.lidar_model import Shapes
from outrider.models import bicycle
from outrider.models.bicycle import State
from outrider.records import Float32s, LaserScan, Pose
from outrider.scenario import Faults, Manoeuvre, Rider, Scenario, Sensor, Vehicle, load, names

__all__ = ["Truth", "contact_times", "load", "names", "record", "rider_at", "time_to_contact", "truth_at"]

Array = npt.NDArray[np.float64]

EPOCH_NS = 1_700_000_000_000_000_000  # stamp of time 0
POSE_NS = 20_000_000  # between two poses: 50 Hz
STEERING_STEP_S = 0.01  # a turning wheel is moved in steps this long, each an exact arc
CONTACT_STEP_S = 0.01  # contact is looked for this often, then bisected
NOTHING = np.zeros(0)


class Truth(NamedTuple):
    """Motion of one body at m times, in W."""

    x: Array  # (m,) body centre [m]
    y: Array  # (m,) [m]
    yaw: Array  # (m,) direction the body points in [rad]
    speed: Array  # (m,) along the course, negative when reversing [m/s]
    acceleration: Array  # (m,) along the course [m/s2]
    slip: Array  # (m,) course - yaw [rad]
    yaw_rate: Array  # (m,) [rad/s]
    extent: Array  # (2,) length, width [m]


# ------------------------------------------------------------------ motion


class _Motion(NamedTuple):
    """Pieces of constant acceleration and slip; piece i lasts from t[i] to t[i + 1], the last for ever."""

    t: Array  # (p,) [s]
    state: Array  # (p, 6) at t, columns as in bicycle.State
    l_r: float  # [m]

    def at(self, t: Array) -> State:
        """State, each (m,), at times t (m,) [s]."""
        i = np.maximum(np.searchsorted(self.t, t, side="right") - 1, 0)
        return bicycle.arc(State(*self.state[i].T), t - self.t[i], self.l_r)

    def poses(self, t: Array) -> Array:
        """Poses (m, 3) in W at times t (m,) [s]."""
        s = self.at(t)
        return np.column_stack([s.X, s.Y, wrap(s.psi)])

    def held(self, t: float) -> _Motion:
        """The motion that goes on as it is at t, with speed and steering held."""
        s = self.at(np.array([t]))
        return self._replace(t=np.array([t]), state=np.column_stack(s._replace(A=np.zeros(1))))


def _drive(body: Vehicle | Rider) -> _Motion:
    """Motion of a body from its start and manoeuvres."""
    s = State(body.x_m, body.y_m, body.speed_mps, 0.0, np.deg2rad(body.yaw_deg), 0.0)
    t, delta, rows = 0.0, 0.0, []
    for manoeuvre in body.manoeuvres:
        if manoeuvre.steering_deg is not None:
            delta = float(np.deg2rad(manoeuvre.steering_deg))
        a, rate = manoeuvre.acceleration_mps2, float(np.deg2rad(manoeuvre.steering_rate_degps))
        standstill = -s.V / a if s.V * a < 0.0 else np.inf
        for begin, end in pairwise(_edges(manoeuvre, standstill)):
            angle = delta + rate * 0.5 * (begin + end)
            s = s._replace(A=a, beta=bicycle.slip(angle, body.rear_axle_m, body.wheelbase_m))
            if begin >= standstill:
                s = s._replace(V=0.0, A=0.0)
            rows.append((t + begin, *s))
            s = bicycle.arc(s, end - begin, body.rear_axle_m)
        t += manoeuvre.duration_s
        delta += rate * manoeuvre.duration_s
        s = s._replace(V=0.0 if abs(s.V) < 1e-9 else s.V)
    s = s._replace(A=0.0, beta=bicycle.slip(delta, body.rear_axle_m, body.wheelbase_m))
    table = np.array([*rows, (t, *s)])
    return _Motion(table[:, 0], table[:, 1:], body.rear_axle_m)


def _edges(manoeuvre: Manoeuvre, standstill: float) -> list[float]:
    """Times [s] in a manoeuvre between which slip and acceleration are constant."""
    count = int(np.ceil(manoeuvre.duration_s / STEERING_STEP_S)) if manoeuvre.steering_rate_degps else 1
    edges = [float(edge) for edge in np.linspace(0.0, manoeuvre.duration_s, count + 1)]
    return sorted({*edges, standstill}) if standstill < manoeuvre.duration_s else edges


def _targets(world: Scenario) -> tuple[Vehicle, ...]:
    """All bodies whose truth is recorded, as vehicles: vehicles, parked cars, pedestrians."""
    parked = (Vehicle(**msgspec.structs.asdict(body)) for body in world.parked)
    walking = (
        Vehicle(
            name=body.name,
            x_m=body.x_m,
            y_m=body.y_m,
            yaw_deg=body.yaw_deg,
            speed_mps=body.speed_mps,
            length_m=2.0 * body.radius_m,
            width_m=2.0 * body.radius_m,
        )
        for body in world.pedestrians
    )
    return (*world.vehicles, *parked, *walking)


# ------------------------------------------------------------------ truth


def truth_at(world: Scenario, t: Any) -> dict[str, Truth]:
    """Motion of every vehicle, parked car and pedestrian, by name, at times t (m,) [s]."""
    return {body.name: _truth(body, t) for body in _targets(world)}


def rider_at(world: Scenario, t: Any) -> Truth:
    """Motion of the rider's body origin at times t (m,) [s]."""
    return _truth(world.rider, t)


def _truth(body: Vehicle | Rider, t: Any) -> Truth:
    motion = _drive(body)
    s = motion.at(np.atleast_1d(np.asarray(t, float)))
    rate = bicycle.yaw_rate(s, motion.l_r)
    return Truth(s.X, s.Y, wrap(s.psi), s.V, s.A, s.beta, rate, np.array([body.length_m, body.width_m]))


def contact_times(world: Scenario) -> dict[str, float | None]:
    """Time [s] at which each body's rectangle first overlaps the rider's footprint, None for never.

    A contact shorter than `CONTACT_STEP_S` may be missed; the time is good to a microsecond.
    """
    rider = _drive(world.rider)
    return {
        body.name: _first_contact(world.rider, rider, body, _drive(body), 0.0, world.duration_s)
        for body in _targets(world)
    }


def time_to_contact(world: Scenario, t: float, horizon: float = 6.0) -> dict[str, float]:
    """Time [s] from t until each body would touch the rider if from t on all held their speed and steering.

    Infinity where that is not within the horizon [s].
    """
    rider = _drive(world.rider).held(t)
    times = {
        body.name: _first_contact(world.rider, rider, body, _drive(body).held(t), t, t + horizon)
        for body in _targets(world)
    }
    return {name: np.inf if at is None else at - t for name, at in times.items()}


def _first_contact(
    rider: Rider, rider_motion: _Motion, body: Vehicle, motion: _Motion, begin: float, end: float
) -> float | None:
    centre = np.array([rider.centre_x_m, 0.0, 0.0])
    own, other = np.array([rider.length_m, rider.width_m]), np.array([body.length_m, body.width_m])

    def touch(t: Array) -> npt.NDArray[np.bool_]:
        return _overlap(compose(rider_motion.poses(t), centre[None]), own, motion.poses(t), other)

    t = np.append(np.arange(begin, end, CONTACT_STEP_S), end)
    found = np.flatnonzero(touch(t))
    if not len(found):
        return None
    after, before = t[found[0]], t[max(found[0] - 1, 0)]
    while after - before > 1e-6:
        middle = 0.5 * (before + after)
        before, after = (before, middle) if touch(np.array([middle]))[0] else (middle, after)
    return float(after)


def _overlap(a_pose: Array, a_extent: Array, b_pose: Array, b_extent: Array) -> npt.NDArray[np.bool_]:
    """Whether rectangles at poses (m, 3) overlap (m,): no side of either separates them."""
    apart = np.zeros(len(a_pose), bool)
    turn = b_pose[:, 2] - a_pose[:, 2]
    c, s = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    for yaw, mine, its in ((a_pose[:, 2], a_extent, b_extent), (b_pose[:, 2], b_extent, a_extent)):
        gap = 2.0 * np.abs(rotate(b_pose[:, :2] - a_pose[:, :2], -yaw))
        apart |= gap[:, 0] > mine[0] + its[0] * c + its[1] * s
        apart |= gap[:, 1] > mine[1] + its[0] * s + its[1] * c
    return ~apart


# ------------------------------------------------------------------ messages


def record(
    world: Scenario, seed: int | None = None, faults: Mapping[str, Any] | None = None
) -> Iterator[LaserScan | Pose]:
    """Messages of a recording in the order they would be received: `/scan`, `/ego_pose`, `/truth/NAME`.

    A pose comes at its own stamp, a scan one turn after that of its first beam. `seed` and `faults` replace
    those of the scenario; `faults` has the keys of the sensor's, such as {"time_scale": 1e-3}. Raises
    InputError for faults that are not known.
    """
    try:
        wrong = world.sensor.faults if faults is None else msgspec.convert(dict(faults), Faults)
    except msgspec.ValidationError as error:
        raise InputError(f"faults: {error}; want {', '.join(Faults.__struct_fields__)}") from error
    world = msgspec.structs.replace(world, sensor=msgspec.structs.replace(world.sensor, faults=wrong))
    rng = np.random.Generator(np.random.PCG64(world.seed if seed is None else seed))
    return heapq.merge(_poses(world), _scans(world, rng), key=lambda message: message.received_ns)


def _poses(world: Scenario) -> Iterator[Pose]:
    stamps = range(0, round(world.duration_s * 1e9) + 1, POSE_NS)
    t = np.array(stamps, float) * 1e-9
    bodies = [("/ego_pose", "rider", NOTHING, _drive(world.rider).poses(t))]
    for body in _targets(world):
        extent = np.array([body.length_m, body.width_m])
        bodies.append((f"/truth/{body.name}", body.name, extent, _drive(body).poses(t)))
    for i, stamp in enumerate(stamps):
        for topic, name, extent, poses in bodies:
            x, y, yaw = poses[i]
            yield Pose(
                topic=topic,
                frame="map",
                body=name,
                stamp_ns=EPOCH_NS + stamp,
                received_ns=EPOCH_NS + stamp,
                position=np.array([x, y, 0.0]),
                quaternion=np.array([0.0, 0.0, np.sin(0.5 * yaw), np.cos(0.5 * yaw)]),
                extent=extent,
            )


def _scans(world: Scenario, rng: np.random.Generator) -> Iterator[LaserScan]:
    sensor = world.sensor
    angle = lidar_model.beam_angles(sensor)
    mount = np.array([[sensor.x_m, sensor.y_m, np.deg2rad(sensor.yaw_deg)]])
    period_ns = round(1e9 / sensor.rate_hz)
    rider, shapes_at = _drive(world.rider), _shapes(world)
    for first in range(0, round(world.duration_s * 1e9) - period_ns + 1, period_ns):
        t = first * 1e-9 + np.arange(len(angle), dtype=np.float64) * (period_ns * 1e-9 / len(angle))
        W_sensor = compose(rider.poses(t), mount)
        echo = lidar_model.cast(W_sensor[:, :2], W_sensor[:, 2] + angle, shapes_at(t))
        yield _message(sensor, EPOCH_NS + first, period_ns, angle, lidar_model.measure(echo, sensor, rng))


def _shapes(world: Scenario) -> Callable[[Array], Shapes]:
    """What beams at times t (n,) can meet, as a function of t."""
    targets = [(body, _drive(body)) for body in _targets(world)]
    count = len(targets) - len(world.pedestrians)
    boxes, walking = targets[:count], targets[count:]
    extent = np.array([[body.length_m, body.width_m] for body, _ in boxes]).reshape(-1, 2)
    poles = np.array([[pole.x_m, pole.y_m] for pole in world.poles]).reshape(-1, 2)
    radius = np.array([body.width_m / 2.0 for body, _ in walking] + [pole.radius_m for pole in world.poles])
    walls = np.array([pair for wall in world.walls for pair in pairwise(wall.points_m)]).reshape(-1, 2, 2)

    def at(t: Array) -> Shapes:
        pose = np.array([motion.poses(t) for _, motion in boxes]).reshape(-1, len(t), 3)
        people = np.array([motion.poses(t)[:, :2] for _, motion in walking]).reshape(-1, len(t), 2)
        standing = np.broadcast_to(poles[:, None], (len(poles), len(t), 2))
        centre = np.concatenate([people, standing])
        return Shapes(pose.swapaxes(0, 1), extent, centre.swapaxes(0, 1), radius, walls)

    return at


def _message(sensor: Sensor, stamp: int, period_ns: int, angle: Array, ranges: Float32s) -> LaserScan:
    """The scan as the driver writes it; its numbers are those a float32 holds, as in a ROS message."""
    first, step, period = angle[0], angle[1] - angle[0], period_ns * 1e-9
    if sensor.faults.reverse:
        first, step, ranges = angle[-1], -step, ranges[::-1].copy()
    scale = sensor.faults.time_scale
    return LaserScan(
        topic="/scan",
        frame="laser",
        stamp_ns=stamp,
        received_ns=stamp + period_ns,
        angle_min=float(np.float32(first)),
        angle_increment=float(np.float32(step)),
        time_increment=float(np.float32(scale * period / len(angle))),
        scan_time=float(np.float32(scale * period)),
        range_min=float(np.float32(sensor.range_min_m)),
        range_max=float(np.float32(sensor.range_max_m)),
        ranges=ranges,
        intensities=np.zeros(0, np.float32),
    )
