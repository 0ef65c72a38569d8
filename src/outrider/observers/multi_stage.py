"""Multi-stage observer: speed, orientation and position in cascade, driven by the way from sample to sample.

Alai & Rajamani 2023 in continuous time, integrated from sample to sample along the line between them.
What differs from the paper, and why, is in docs/observers/multi_stage.md.
"""

from __future__ import annotations

from math import atan2, ceil, cos, hypot, inf, pi, sin
from typing import Any, NamedTuple

from outrider.kernel import kernel, rk4, wrap
from outrider.observers import Innovation, Measurement, Motion
from outrider.observers._measured import directed, heading_or, pointed, seen
from outrider.observers._path import chord, told, travel
from outrider.observers._sampled import LEAST_DT

reference = (
    "H. Alai and R. Rajamani, Multi-Stage Estimation Algorithm for Target Vehicle Trajectory Tracking with "
    "Applications to E-Scooter Protection, IEEE Transactions on Intelligent Vehicles, 2023: "
    "eq. 12-14 and 27 (speed), 19 and 40 with Table I (orientation), 23 and 64 (position)"
)

NOMINAL = (1.0, 1.5, *(float(v) for v in range(2, 21)))  # speeds of Table I [m/s]
# fmt: off
L_PSI = (  # L_z(1) [1/s]
    0.89, 0.98, 1.37, 1.76, 2.52, 3.67, 5.47, 8.05, 9.70, 5.58, 6.08,
    6.60, 7.14, 7.70, 8.27, 8.84, 9.42, 9.99, 10.49, 10.97, 11.44,
)
L_BETA = (  # L_z(2) [1/s]
    0.25, 0.27, 0.30, 0.33, 0.37, 0.50, 0.70, 0.99, 1.17, 0.66, 0.68,
    0.71, 0.74, 0.77, 0.79, 0.82, 0.85, 0.88, 0.89, 0.91, 0.92,
)
# fmt: on

SLIP_MAX = pi / 9.0  # eq. 8 [rad]
V_MAX, A_MAX, J_MAX = (
    70.0,
    100.0,
    1000.0,
)  # far beyond any vehicle: only keep numbers finite [m/s, m/s2, m/s3]
GAP_MAX = 5.0  # over a longer gap nothing is read from the line between two samples [s]
HEADING_VARIANCE = 0.01  # at which the gain on the rectangle's heading is halved [rad2]


class State(NamedTuple):
    """Estimate at the time of the last sample."""

    S: float  # path coordinate minus that of the last sample [m]
    V: float  # speed along the course, negative when reversing [m/s]
    A: float  # [m/s2]
    J: float  # [m/s3]
    psi: float  # yaw, in [-pi, pi) [rad]
    beta: float  # slip [rad]
    x: float  # body centre in W [m]
    y: float  # [m]


class Gains(NamedTuple):
    """Published gains, and what the paper leaves open."""

    L_S: float = 4.61  # speed observer, eq. 36 [1/s]
    L_V: float = 12.24  # [1/s2]
    L_A: float = 9.83  # [1/s3]
    L_J: float = 4.16  # [1/s4]
    L_w: float = 20.0  # position observer, eq. 77 [1/s]
    l_r: float = 2.0  # body centre to rear axle, eq. 10 [m]
    speed: float = 1.0  # the poles of the speed observer times this [-]
    orientation: float = 1.0  # both columns of the table times this [-]
    heading: float = 30.0  # correction of the yaw by the rectangle's heading; 0: as published [1/s]
    noise: float = 0.02  # least standard deviation of a measured position [m]
    gate: float = 2.0  # a way shorter than this many standard deviations has no direction [-]
    coast: float = 1.0  # time constant with which the acceleration fades while nothing is measured [s]
    reverse: float = 4.0  # what reverses faster is turned round, unless `heading` is used [m/s]
    psi_0: float = 0.0  # orientation gains psi_0 + psi_V |V|, beta_0 + beta_V |V| [1/s]
    psi_V: float = 0.0  # 0: those of Table I instead [1/m]
    beta_0: float = 0.0  # [1/s]
    beta_V: float = 0.0  # [1/m]


# Proven from 1 to 20 m/s with a decay rate of 0.05/s: design.multi_stage.
DESIGNED = Gains(
    10.55, 38.64, 58.24, 31.34, L_w=19.56, psi_0=0.6419, psi_V=0.278, beta_0=0.3545, beta_V=0.04631
)


class Output(NamedTuple):
    """What the observers are driven by between two samples."""

    S: float  # way since the last sample [m]
    alpha: float  # course of the way [rad]
    psi: float  # heading of the rectangle [rad]
    x: float  # position [m]
    y: float  # [m]


class Coefficients(NamedTuple):
    """Gains of one sample; 0 where a correction is held."""

    L_S: float
    L_V: float
    L_A: float
    L_J: float
    L_psi: float
    L_beta: float
    L_heading: float
    L_w: float
    l_r: float


@kernel
def rhs(s: State, y: Output, c: Coefficients) -> State:
    """State's derivative: model plus gain times innovation; eq. 27, 40, 64."""
    eS = y.S - s.S
    chi = s.psi + s.beta
    e = wrap(y.alpha - chi)
    beta = min(max(s.beta, -SLIP_MAX), SLIP_MAX)
    return State(
        s.V + c.L_S * eS,
        s.A + c.L_V * eS,
        s.J + c.L_A * eS,
        c.L_J * eS,
        s.V * sin(beta) / c.l_r + c.L_psi * e + c.L_heading * wrap(y.psi - s.psi),
        c.L_beta * e,
        s.V * cos(chi) + c.L_w * (y.x - s.x),
        s.V * sin(chi) + c.L_w * (y.y - s.y),
    )


@kernel
def start(y0: Measurement, y1: Measurement, dt: float, gains: Gains) -> State:
    """State at rest, or moving forward along the way from y0 to y1 where it is longer than the noise."""
    if not (seen(y0) and seen(y1)):
        y = y1 if seen(y1) else y0
        return State(0.0, 0.0, 0.0, 0.0, heading_or(y, 0.0), 0.0, y.x, y.y)
    dx, dy = y1.x - y0.x, y1.y - y0.y
    alpha = atan2(dy, dx)
    if 0.0 < dt < inf and directed(dx, dy, y0, y1, gains.noise, gains.gate):
        V = min(hypot(dx, dy) / dt, V_MAX)
        return State(0.0, V, 0.0, 0.0, wrap(alpha), 0.0, y1.x, y1.y)
    return State(0.0, 0.0, 0.0, 0.0, heading_or(y1, heading_or(y0, wrap(alpha))), 0.0, y1.x, y1.y)


@kernel
def step(state: State, previous: Measurement, measurement: Measurement, dt: float, gains: Gains) -> State:
    """State at the next sample: RK4, inputs on the line between the two samples, sub-step <= 0.5 / gain."""
    if not (seen(measurement) and dt <= GAP_MAX):
        return predict(state, dt, gains)
    if not dt > 0.0:
        return state
    before = previous if seen(previous) else _stand_in(state, measurement)
    dx, dy = measurement.x - before.x, measurement.y - before.y
    chi = state.psi + state.beta + 0.5 * dt * state.V * sin(state.beta) / gains.l_r
    way = dx * cos(chi) + dy * sin(chi)  # signed: projected on the course half way
    aside = dy * cos(chi) - dx * sin(chi)
    e = atan2(aside, way) if way >= 0.0 else atan2(-aside, -way)  # from the course axis, in [-pi/2, pi/2]
    moved = hypot(dx, dy) <= V_MAX * dt + gains.noise  # or the point has jumped
    clear = moved and directed(dx, dy, before, measurement, gains.noise, gains.gate)
    c = _coefficients(state, measurement, moved, clear, gains)
    psi0 = heading_or(before, heading_or(measurement, state.psi))
    turn = wrap(heading_or(measurement, psi0) - psi0)
    y = Output(0.0, chi + e, psi0, before.x, before.y)
    d = max(dt, LEAST_DT)
    rate = Output(way / d, 0.0, turn / d, dx / d, dy / d)
    fastest = max(c.L_S, c.L_w, abs(c.L_psi + c.L_beta) + c.L_heading)
    s = rk4(rhs, state, y, rate, c, dt, min(max(ceil(2.0 * dt * fastest), 4), 1000))
    reverse = inf if c.L_heading > 0.0 else gains.reverse  # a heading in use says where the front is
    return _limited(s, s.S - way if moved else state.S, reverse)


@kernel
def predict(state: State, dt: float, gains: Gains) -> State:
    """State after dt [s] on its arc, acceleration fading, no jerk; a braking vehicle stops. Closed form."""
    if not 0.0 < dt < inf:
        return state
    D, V, A = travel(state.V, state.A, dt, gains.coast)
    dx, dy, turn = chord(D, state.psi + state.beta, sin(state.beta) / gains.l_r)
    s = State(0.0, V, A, 0.0, state.psi + turn, state.beta, state.x + dx, state.y + dy)
    return _limited(s, 0.0, inf)


@kernel
def motion(state: State, gains: Gains) -> Motion:
    """The state in common terms."""
    s = state
    return told(s.x, s.y, s.V, s.A, s.psi, s.beta, gains.l_r)


@kernel
def innovation(state: State, measurement: Measurement, gains: Gains) -> Innovation:
    """Against the position; its covariance: the sensor's, and one sample of the position observer's noise."""
    y, least = measurement, gains.noise**2
    xx, yy = 2.0 * max(y.xx, least), 2.0 * max(y.yy, least)
    return Innovation(y.x - state.x, y.y - state.y, xx, 2.0 * y.xy, yy)


def claim(gains: Gains, form: Any = "continuous", **asked: Any) -> Any:
    """What is claimed of the errors of the whole cascade; `claim.Claim`, its region in `_cascade`."""
    from outrider.observers import _cascade

    return _cascade.claim(gains, form, **asked)


def certificate(gains: Gains = Gains()) -> Any:  # noqa: B008
    """Proof that the whole cascade is stable with the default gains or DESIGNED; what it says for others."""
    from outrider import observers, proof_file

    lined = gains.psi_V > 0.0
    return observers.certificate_of(
        proof_file.shipped("multi_stage.designed" if lined else "multi_stage"), gains
    )


@kernel
def _coefficients(
    state: State, measurement: Measurement, moved: bool, clear: bool, gains: Gains
) -> Coefficients:
    """Gains of this sample: the line, or the table at the nearest nominal speed; mirrored when reversing."""
    i = 0
    while i + 1 < len(NOMINAL) and abs(NOMINAL[i + 1] - abs(state.V)) < abs(NOMINAL[i] - abs(state.V)):
        i += 1
    L_psi, L_beta = gains.orientation * L_PSI[i], gains.orientation * L_BETA[i]
    if gains.psi_V > 0.0:
        L_psi = gains.orientation * (gains.psi_0 + gains.psi_V * abs(state.V))
        L_beta = gains.orientation * (gains.beta_0 + gains.beta_V * abs(state.V))
    if state.V < 0.0:  # the same poles as forward, where the published signs would be unstable
        L_psi, L_beta = L_psi + 2.0 * L_beta, -L_beta
    if not clear:
        L_psi, L_beta = 0.0, 0.0
    L_heading = 0.0
    if pointed(measurement):
        L_heading = gains.heading * HEADING_VARIANCE / (HEADING_VARIANCE + measurement.heading_variance)
    k = gains.speed if moved else 0.0
    return Coefficients(
        gains.L_S * k,
        gains.L_V * k**2,
        gains.L_A * k**3,
        gains.L_J * k**4,
        L_psi,
        L_beta,
        L_heading,
        gains.L_w,
        gains.l_r,
    )


@kernel
def _stand_in(s: State, y: Measurement) -> Measurement:
    """Measurement at the estimate itself, with the covariance of y."""
    return Measurement(s.x, s.y, y.xx, y.xy, y.yy, s.psi, inf, y.length, y.width)


@kernel
def _limited(s: State, S: float, reverse: float) -> State:
    """State within its limits, path coordinate S; turned round where it reverses too fast."""
    V, A = min(max(s.V, -V_MAX), V_MAX), min(max(s.A, -A_MAX), A_MAX)
    J, beta = min(max(s.J, -J_MAX), J_MAX), min(max(s.beta, -SLIP_MAX), SLIP_MAX)
    if s.V + reverse < 0.0:
        return State(-S, -V, -A, -J, wrap(s.psi + 2.0 * beta + pi), -beta, s.x, s.y)
    return State(S, V, A, J, wrap(s.psi), beta, s.x, s.y)
