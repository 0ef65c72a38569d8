"""High-gain observer: position, velocity and acceleration in companion form, one gain for all courses.

Alai, Zemouche & Rajamani in continuous time, run here as predict and correct with the poles of their design.
What differs from the paper, and why, is in docs/observers/high_gain.md.
"""

from __future__ import annotations

from math import asin, atan2, ceil, cos, expm1, hypot, inf, pi, sin, sqrt
from typing import Any, NamedTuple

from outrider.kernel import kernel, rk4, wrap
from outrider.models import bicycle
from outrider.observers import Innovation, Measurement, Motion
from outrider.observers._measured import directed, heading_or, pointed, seen
from outrider.observers._path import chord, travel
from outrider.observers._sampled import chain_gains, heading_innovation, patient_huber

reference = (
    "H. Alai, A. Zemouche and R. Rajamani, Vehicle Trajectory Estimation Using a High-Gain Multi-Output "
    "Nonlinear Observer: eq. 30-58 (companion form), 59 (observer), 92 (gain)"
)

SLIP_MAX = pi / 9.0  # [rad]
V_MAX, A_MAX = 70.0, 100.0  # far beyond any vehicle: only keep numbers finite [m/s, m/s2]
GAP_MAX = 5.0  # after a longer step nothing is corrected [s]
SUBSTEP = 0.1  # of RK4 [s]
SCAN = 0.1  # between two scans, where nothing says how long it was [s]
WIDEST = 20.0  # variance of an innovation over that of its measurement, at most [-]


class State(NamedTuple):
    """z of eq. 30 at the time of the last sample, and the yaw."""

    X: float  # body centre in W [m]
    dX: float  # velocity [m/s]
    ddX: float  # acceleration [m/s2]
    Y: float  # [m]
    dY: float  # [m/s]
    ddY: float  # [m/s2]
    psi: float  # yaw, in [-pi, pi) [rad]
    run: float  # samples in a row whose innovation was limited [-]


class Gains(NamedTuple):
    """Gains of the continuous observer for street traffic, and what the paper leaves open."""

    L1: float = 10.9  # position, each axis [1/s]
    L2: float = 33.6  # velocity [1/s2]
    L3: float = 26.0  # acceleration [1/s3]
    c_max: float = 0.3  # course rate is saturated at this [rad/s]
    floor: float = 2.0  # speed below which the course rate is divided by this instead [m/s]
    l_r: float = 2.0  # body centre to rear axle, eq. 29 [m]
    heading: float = 25.0  # correction of the yaw by the rectangle's heading; 0: none [1/s]
    turn: float = 3.0  # of velocity and acceleration by the same, turned with it [1/s]
    heading_noise: float = 0.03  # standard deviation of a heading at which both are halved [rad]
    noise: float = 0.1  # standard deviation of a position, besides the measurement's own [m]
    huber: float = 4.0  # limit of the innovation in deviations, doubled by each in a row; 0: none [-]
    coast: float = 1.0  # time constant with which the acceleration fades while nothing is measured [s]
    reverse: float = 4.0  # what reverses faster is turned round, unless the heading is known [m/s]


PUBLISHED = Gains(L1=67.20, L2=823.1, L3=2818.5, c_max=1.9, heading=0.0, turn=0.0, huber=0.0)  # eq. 92
# Proven faster than 5 m/s, up to 3 m/s2 and 0.4 rad/s, with a decay rate of 0.5/s: design.high_gain.
DESIGNED = Gains(L1=14.08, L2=92.14, L3=248.4, c_max=0.4, floor=5.0)


class Free(NamedTuple):
    """Nothing drives the model."""

    input: float = 0.0  # [-]


@kernel
def course_rate(s: State, c: Gains) -> float:
    """c = (z6 z2 - z3 z5) / V^2 [rad/s], eq. 44, saturated and with a floor under V."""
    rate = (s.ddY * s.dX - s.ddX * s.dY) / max(s.dX * s.dX + s.dY * s.dY, c.floor**2)
    return min(max(rate, -c.c_max), c.c_max)


@kernel
def rhs(s: State, y: Free, c: Gains) -> State:
    """z' = F z + G f(z), eq. 56 and 58; the yaw is moved apart from it."""
    k = course_rate(s, c)
    f1 = -3.0 * s.ddY * k + 2.0 * s.dX * k * k
    f2 = 3.0 * s.ddX * k + 2.0 * s.dY * k * k
    return State(s.dX, s.ddX, f1, s.dY, s.ddY, f2, 0.0, 0.0)


@kernel
def to_vehicle(s: State, c: Gains) -> bicycle.State:
    """X, Y, V, A, psi, beta of z, eq. 37-44; forward is the way of motion within a right angle of the yaw."""
    V = hypot(s.dX, s.dY)
    if s.dX * cos(s.psi) + s.dY * sin(s.psi) < 0.0:
        V = -V
    if V == 0.0:
        return bicycle.State(s.X, s.Y, 0.0, s.ddX * cos(s.psi) + s.ddY * sin(s.psi), s.psi, 0.0)
    A = (s.dX * s.ddX + s.dY * s.ddY) / V
    largest = sin(SLIP_MAX)
    beta = asin(min(max(c.l_r * course_rate(s, c) / V, -largest), largest))
    course = atan2(s.dY, s.dX) if V > 0.0 else atan2(-s.dY, -s.dX)
    return bicycle.State(s.X, s.Y, V, A, wrap(course - beta), beta)


@kernel
def from_vehicle(v: bicycle.State, c: Gains) -> State:
    """z of a vehicle, eq. 29, 35 and 36; undoes `to_vehicle` within the limits of course rate and slip."""
    course = v.psi + v.beta
    along, across = cos(course), sin(course)
    a = v.V * v.V * sin(v.beta) / c.l_r  # towards the left
    return State(
        v.X,
        v.V * along,
        v.A * along - a * across,
        v.Y,
        v.V * across,
        v.A * across + a * along,
        wrap(v.psi),
        0.0,
    )


@kernel
def start(y0: Measurement, y1: Measurement, dt: float, gains: Gains) -> State:
    """State at rest, or moving along the way from y0 to y1 where it is longer than the noise."""
    if not (seen(y0) and seen(y1)):
        y = y1 if seen(y1) else y0
        return State(y.x, 0.0, 0.0, y.y, 0.0, 0.0, heading_or(y, 0.0), 0.0)
    dx, dy = y1.x - y0.x, y1.y - y0.y
    psi = heading_or(y1, heading_or(y0, wrap(atan2(dy, dx))))
    if 0.0 < dt < inf and directed(dx, dy, y0, y1, gains.noise, 2.0):
        if not gains.heading > 0.0:
            psi = wrap(atan2(dy, dx))
        return _limited(State(y1.x, dx / dt, 0.0, y1.y, dy / dt, 0.0, psi, 0.0), inf)
    return State(y1.x, 0.0, 0.0, y1.y, 0.0, 0.0, psi, 0.0)


@kernel
def step(state: State, previous: Measurement, measurement: Measurement, dt: float, gains: Gains) -> State:
    """State at the next sample: the model by RK4, then z + L_d(dt) (y - H z), eq. 59 sampled."""
    if not (seen(measurement) and dt <= GAP_MAX):
        return predict(state, dt, gains)
    if not dt > 0.0:
        return state
    n = min(max(ceil(dt / SUBSTEP), 1), 50)
    s = rk4(rhs, state, Free(0.0), Free(0.0), gains, dt, n)
    psi = _turned(state, dt, gains)
    l1, l2, l3 = chain_gains(gains.L1, gains.L2, gains.L3, dt)
    i = _innovation(s, measurement, l1, gains)
    w, run = patient_huber(i, gains.huber, state.run)
    ex, ey = w * i.x, w * i.y
    known = gains.heading > 0.0 and pointed(measurement)
    if known:
        e, trust = heading_innovation(psi, measurement, gains.heading_noise, gains.huber)
        psi -= expm1(-gains.heading * trust * dt) * e
        s = _rotated(s, -expm1(-gains.turn * trust * dt) * e)
    return _limited(
        State(
            s.X + l1 * ex,
            s.dX + l2 * ex,
            s.ddX + l3 * ex,
            s.Y + l1 * ey,
            s.dY + l2 * ey,
            s.ddY + l3 * ey,
            psi,
            run,
        ),
        inf if known else gains.reverse,
    )


@kernel
def predict(state: State, dt: float, gains: Gains) -> State:
    """State after dt [s] on its arc, acceleration fading; a braking vehicle stops. Closed form."""
    if not 0.0 < dt < inf:
        return state
    v = to_vehicle(state, gains)
    way, V, A = travel(v.V, v.A, dt, gains.coast)
    dx, dy, turn = chord(way, v.psi + v.beta, sin(v.beta) / gains.l_r)
    s = from_vehicle(bicycle.State(v.X + dx, v.Y + dy, V, A, v.psi + turn, v.beta), gains)
    return State(s.X, s.dX, s.ddX, s.Y, s.dY, s.ddY, wrap(state.psi + turn), state.run)


@kernel
def motion(state: State, gains: Gains) -> Motion:
    """The state in common terms; the yaw is the one that the rear axle and the rectangle tell."""
    v = to_vehicle(state, gains)
    course = wrap(v.psi + v.beta)
    return Motion(v.X, v.Y, v.V, v.A, course, state.psi, wrap(course - state.psi), course_rate(state, gains))


@kernel
def innovation(state: State, measurement: Measurement, gains: Gains) -> Innovation:
    """Against the position; covariance as if a scan of usual length had passed."""
    l1, _, _ = chain_gains(gains.L1, gains.L2, gains.L3, SCAN)
    return _innovation(state, measurement, l1, gains)


def claim(gains: Gains, form: Any = "sampled", **asked: Any) -> Any:
    """What is claimed of the errors under these gains; `claim.Claim`, its region in `_high_gain_proof`."""
    from outrider.observers import _high_gain_proof

    return _high_gain_proof.claim(gains, form, **asked)


def certificate(gains: Gains = Gains()) -> Any:  # noqa: B008
    """Evidence that errors decay as they are sampled, with what proves it for the default gains."""
    from outrider import observers, proof_file

    return observers.certificate_of(proof_file.shipped("high_gain"), gains)


@kernel
def _innovation(s: State, y: Measurement, l1: float, gains: Gains) -> Innovation:
    """Covariance R / (1 - l1): the one for which l1 would be a Kalman filter's gain, at most WIDEST R."""
    wide, least = 1.0 / max(1.0 - l1, 1.0 / WIDEST), gains.noise**2
    return Innovation(y.x - s.X, y.y - s.Y, wide * (y.xx + least), wide * y.xy, wide * (y.yy + least))


@kernel
def _turned(s: State, dt: float, gains: Gains) -> float:
    """Yaw after dt: the rear axle follows the course, psi' = V sin(chi - psi) / l_r, course rate constant.

    In reverse that is unstable, and psi' = 2 c - V sin(chi - psi) / l_r goes the same way stably.
    """
    V = sqrt(s.dX * s.dX + s.dY * s.dY)
    sign = -1.0 if s.dX * cos(s.psi) + s.dY * sin(s.psi) < 0.0 else 1.0
    x = V * dt / gains.l_r
    drawn = -expm1(-x)
    part = drawn / x if x > 1e-9 else 1.0
    aside = wrap(atan2(sign * s.dY, sign * s.dX) - s.psi) if V > 0.0 else 0.0
    psi: float = wrap(s.psi + drawn * aside + (1.0 - sign * part) * dt * course_rate(s, gains))
    return psi


@kernel
def _rotated(s: State, angle: float) -> State:
    """Velocity and acceleration turned by an angle [rad]."""
    c, d = cos(angle), sin(angle)
    return State(
        s.X,
        c * s.dX - d * s.dY,
        c * s.ddX - d * s.ddY,
        s.Y,
        c * s.dY + d * s.dX,
        c * s.ddY + d * s.ddX,
        s.psi,
        s.run,
    )


@kernel
def _limited(s: State, reverse: float) -> State:
    """State within its limits; turned round where it reverses too fast."""
    V2, A2 = s.dX * s.dX + s.dY * s.dY, s.ddX * s.ddX + s.ddY * s.ddY
    v = V_MAX / sqrt(V2) if V2 > V_MAX**2 else 1.0
    a = A_MAX / sqrt(A2) if A2 > A_MAX**2 else 1.0
    psi = s.psi
    if reverse < inf and v * (s.dX * cos(psi) + s.dY * sin(psi)) < -reverse:
        psi += 2.0 * wrap(atan2(-s.dY, -s.dX) - psi) + pi  # slip mirrored
    return State(s.X, v * s.dX, a * s.ddX, s.Y, v * s.dY, a * s.ddY, wrap(psi), s.run)
