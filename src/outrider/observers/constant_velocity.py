"""Constant-velocity observer: position, yaw and slip of a bicycle whose speed is given, gain from one LMI.

The "nonlinear observer" of the papers: a Jacobian polytope over a window of the course. The gain turns with
the estimate, or is that of the nearest of five sectors as in the source.
Differences: docs/observers/constant_velocity.md.
"""

from __future__ import annotations

from math import atan2, cos, expm1, hypot, inf, pi, sin
from typing import Any, NamedTuple

from outrider.kernel import kernel, wrap
from outrider.observers import Innovation, Measurement, Motion
from outrider.observers._measured import directed, heading_or, pointed, seen
from outrider.observers._path import chord, told, travel
from outrider.observers._sampled import chain_gains, heading_innovation, patient_huber

reference = (
    "R. Rajamani, W. Jeon, H. Movahedi and A. Zemouche, On the need for switched-gain observers for "
    "non-monotonic nonlinear systems, Automatica 114, 2020; its use for vehicles: Alai, Zemouche and "
    "Rajamani, Vehicle Trajectory Estimation Using a High-Gain Multi-Output Nonlinear Observer, eq. 11"
)

SLIP_MAX = pi / 9.0  # [rad]
SECTOR = 2.0 * pi / 5.0  # width of a sector of the switched gain: courses within 36 deg of its middle [rad]
V_MAX, A_MAX = 70.0, 100.0  # far beyond any vehicle: only keep numbers finite [m/s, m/s2]
GAP_MAX = 5.0  # after a longer step nothing is corrected [s]
SCAN = 0.1  # between two scans, where nothing says how long it was [s]
WIDEST = 20.0  # variance of an innovation over that of its measurement, at most [-]


class State(NamedTuple):
    """Estimate at the time of the last sample."""

    X: float  # body centre in W [m]
    Y: float  # [m]
    V: float  # along the course, negative when reversing; as given, or estimated [m/s]
    A: float  # [m/s2]
    psi: float  # yaw, in [-pi, pi) [rad]
    beta: float  # slip [rad]
    run: float  # samples in a row whose innovation was limited [-]


class Gains(NamedTuple):
    """Continuous gain L0 in the frame of the course, for one speed; and what the source leaves open."""

    L_x: float = 8.004  # along the course [1/s]
    L_y: float = 12.77  # across [1/s]
    L_psi: float = 4.52  # [rad/(m s)]
    L_beta: float = 1.508  # [rad/(m s)]
    speed: float = 10.0  # given speed, for which the gain was designed [m/s]
    speed_chain: float = 0.29  # time constant of the estimate of the speed; 0: the speed is as given [s]
    switched: float = 0.0  # 1: the gain of the nearest sector; 0: the gain turns with the course [-]
    floor: float = 3.5  # speed below which the gains of yaw and slip fade [m/s]
    l_r: float = 2.0  # body centre to rear axle [m]
    heading: float = 25.0  # correction of the yaw by the rectangle's heading; 0: none [1/s]
    heading_noise: float = 0.03  # standard deviation of a heading at which that is halved [rad]
    noise: float = 0.1  # standard deviation of a position, besides the measurement's own [m]
    huber: float = 4.0  # limit of the innovation in deviations, doubled by each in a row; 0: none [-]
    coast: float = 1.0  # time constant with which the acceleration fades while nothing is measured [s]
    reverse: float = 4.0  # what reverses faster is turned round, unless the heading is known [m/s]


# The gain is proven for 10 m/s, courses within 36 deg of the frame, turns up to 0.5 rad/s and a decay rate of
# 1.5/s, no pole beyond 10/s: design.constant_velocity. The source prints none.
DESIGNED = Gains()
SOURCE = Gains(speed_chain=0.0, switched=1.0, heading=0.0, huber=0.0)  # speed as given, gain by sector


class Sampled(NamedTuple):
    """Gains of one step; lateral: chain of offset, V chi and V^2 / l_r beta."""

    x: float  # [-]
    V: float  # [1/s]
    A: float  # [1/s2]
    y: float  # [-]
    chi: float  # [1/s]
    beta: float  # [1/s2]


@kernel
def sampled(dt: float, gains: Gains) -> Sampled:
    """Gains of one step of dt [s] with the poles, over this step, of the continuous observer.

    In the frame of the course e_x' = -L_x e_x; and across, with q = (e_y, V e_chi, V^2 / l_r e_beta), a chain
    q1' = q2 - L_y q1, q2' = q3 - V (L_psi + L_beta) q1, q3' = -V^2 / l_r L_beta q1.
    """
    g = gains
    y, chi, beta = chain_gains(
        g.L_y, g.speed * (g.L_psi + g.L_beta), g.speed * g.speed / g.l_r * g.L_beta, dt
    )
    if not g.speed_chain > 0.0:
        return Sampled(-expm1(-g.L_x * dt), 0.0, 0.0, y, chi, beta)
    r = 1.0 / g.speed_chain
    x, V, A = chain_gains(3.0 * r, 3.0 * r * r, r * r * r, dt)
    return Sampled(x, V, A, y, chi, beta)


@kernel
def start(y0: Measurement, y1: Measurement, dt: float, gains: Gains) -> State:
    """State at rest, or moving along the way from y0 to y1 where it is longer than the noise."""
    if not (seen(y0) and seen(y1)):
        y = y1 if seen(y1) else y0
        return _limited(State(y.x, y.y, 0.0, 0.0, heading_or(y, 0.0), 0.0, 0.0), gains, inf)
    dx, dy = y1.x - y0.x, y1.y - y0.y
    course = atan2(dy, dx)
    psi = heading_or(y1, heading_or(y0, course))
    V = 0.0
    if 0.0 < dt < inf and directed(dx, dy, y0, y1, gains.noise, 2.0):
        V = hypot(dx, dy) / dt
        if not gains.heading > 0.0:
            psi = course
        elif dx * cos(psi) + dy * sin(psi) < 0.0:
            V = -V
    return _limited(State(y1.x, y1.y, V, 0.0, psi, 0.0, 0.0), gains, inf)


@kernel
def step(state: State, previous: Measurement, measurement: Measurement, dt: float, gains: Gains) -> State:
    """State at the next sample: along its arc, then corrected in the frame of the course or the sector."""
    if not (seen(measurement) and dt <= GAP_MAX):
        return predict(state, dt, gains)
    if not dt > 0.0:
        return state
    g = gains
    s = _moved(state, state.V * dt + 0.5 * state.A * dt * dt, state.V + state.A * dt, state.A, g)
    k = sampled(dt, g)
    i = _innovation(s, measurement, k, g)
    w, run = patient_huber(i, g.huber, state.run)
    frame = s.psi + s.beta
    if g.switched > 0.0:
        frame = SECTOR * round(frame / SECTOR)
    c, d = cos(frame), sin(frame)
    ex, ey = w * (c * i.x + d * i.y), w * (c * i.y - d * i.x)
    slow = 1.0 / max(abs(s.V), g.floor)
    chi = min(max(k.chi * ey * s.V * slow * slow, -1.0), 1.0)  # k.chi / V, slower at low speed
    beta = k.beta * ey * g.l_r * abs(s.V) * slow**3  # k.beta l_r / V^2
    psi = s.psi + chi - beta
    known = g.heading > 0.0 and pointed(measurement)
    if known:
        e, trust = heading_innovation(psi, measurement, g.heading_noise, g.huber)
        turn = -expm1(-g.heading * trust * dt) * e
        psi += turn
        if s.V < 0.0:
            beta -= turn  # in reverse the slip gives way: the course is known better
    x, y = k.x * ex, k.y * ey
    s = State(
        s.X + c * x - d * y, s.Y + d * x + c * y, s.V + k.V * ex, s.A + k.A * ex, psi, s.beta + beta, run
    )
    return _limited(s, g, inf if known else g.reverse)


@kernel
def predict(state: State, dt: float, gains: Gains) -> State:
    """State after dt [s] on its arc, acceleration fading; a braking vehicle stops. Closed form."""
    if not 0.0 < dt < inf:
        return state
    way, V, A = travel(state.V, state.A, dt, gains.coast)
    return _moved(state, way, V, A, gains)


@kernel
def motion(state: State, gains: Gains) -> Motion:
    """The state in common terms."""
    s = state
    return told(s.X, s.Y, s.V, s.A, s.psi, s.beta, gains.l_r)


@kernel
def innovation(state: State, measurement: Measurement, gains: Gains) -> Innovation:
    """Against the position; covariance as if a scan of usual length had passed."""
    return _innovation(state, measurement, sampled(SCAN, gains), gains)


def claim(gains: Gains, form: Any = "sampled", **asked: Any) -> Any:
    """What is claimed of the errors under these gains; `claim.Claim`, see `_constant_velocity_proof`."""
    from outrider.observers import _constant_velocity_proof

    return _constant_velocity_proof.claim(gains, form, **asked)


def certificate(gains: Gains = Gains()) -> Any:  # noqa: B008
    """Proof that errors decay as they are sampled, with what proves it for the default gains."""
    from outrider import observers, proof_file

    return observers.certificate_of(proof_file.shipped("constant_velocity"), gains)


@kernel
def _innovation(s: State, y: Measurement, k: Sampled, gains: Gains) -> Innovation:
    """Covariance R / (1 - k): the one for which k would be a Kalman filter's gain, at most WIDEST R."""
    wide, least = 1.0 / max(1.0 - max(k.x, k.y), 1.0 / WIDEST), gains.noise**2
    return Innovation(y.x - s.X, y.y - s.Y, wide * (y.xx + least), wide * y.xy, wide * (y.yy + least))


@kernel
def _moved(s: State, way: float, V: float, A: float, gains: Gains) -> State:
    """State after `way` [m] along its arc, with speed and acceleration at its end."""
    dx, dy, turn = chord(way, s.psi + s.beta, sin(s.beta) / gains.l_r)
    return State(s.X + dx, s.Y + dy, V, A, wrap(s.psi + turn), s.beta, s.run)


@kernel
def _limited(s: State, gains: Gains, reverse: float) -> State:
    """State within its limits, speed as given where it is; turned round where it reverses too fast."""
    beta = min(max(s.beta, -SLIP_MAX), SLIP_MAX)
    if not gains.speed_chain > 0.0:
        return State(s.X, s.Y, gains.speed, 0.0, wrap(s.psi), beta, s.run)
    V, A = min(max(s.V, -V_MAX), V_MAX), min(max(s.A, -A_MAX), A_MAX)
    if V + reverse < 0.0:
        return State(s.X, s.Y, -V, -A, wrap(s.psi + 2.0 * beta + pi), -beta, s.run)
    return State(s.X, s.Y, V, A, wrap(s.psi), beta, s.run)
