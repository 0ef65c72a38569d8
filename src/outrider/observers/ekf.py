"""Extended Kalman filter on the kinematic bicycle, its path an exact arc; heading, Huber and hops as options.

The model is models/bicycle.py; what is chosen here, and why, is in docs/observers/ekf.md.
"""

from __future__ import annotations

from math import atan2, cos, exp, inf, sin
from typing import Any, NamedTuple

from outrider.kernel import from_row, kernel, matrix, to_row, wrap
from outrider.observers import Innovation, Measurement, Motion, Spread
from outrider.observers._bicycle import (
    PSI_KNOWN,
    aim,
    begin,
    bound,
    correct_heading,
    disturb,
    mirror,
    scatter,
    spread_of,
    turn_round,
)
from outrider.observers._gaussian import (
    cholesky,
    correct_two,
    look_back,
    pack,
    product,
    unpack,
)
from outrider.observers._measured import huber, pointed, seen
from outrider.observers._path import fade, told, travel

reference = (
    "A. H. Jazwinski, Stochastic Processes and Filtering Theory, Academic Press, 1970: section 8.3; "
    "bicycle: Alai & Rajamani 2023, IEEE Trans. Intelligent Vehicles, eq. 1-10; fading acceleration: "
    "R. A. Singer 1970, IEEE Trans. Aerospace and Electronic Systems 6(4), 473-483"
)

LONGEST = 60.0  # nothing is predicted further than this [s]
LOST = 3.0  # an innovation this wide is no chance [standard deviations]
REACH = 3.0  # deviations `hop` that the measured point is from the centre at most [-]


class State(NamedTuple):
    """Estimate at the time of the last sample, then the lower half of its covariance, row by row."""

    x: float  # body centre in W [m]
    y: float  # [m]
    V: float  # along the course, negative when reversing [m/s]
    A: float  # [m/s2]
    psi: float  # yaw, in [-pi, pi) [rad]
    beta: float  # slip [rad]
    u: float  # where on the body the measured point is: ahead of the centre [m]
    v: float  # to the left of it [m]
    xx: float
    yx: float
    yy: float
    Vx: float
    Vy: float
    VV: float
    Ax: float
    Ay: float
    AV: float
    AA: float
    psi_x: float
    psi_y: float
    psi_V: float
    psi_A: float
    psi_psi: float
    beta_x: float
    beta_y: float
    beta_V: float
    beta_A: float
    beta_psi: float
    beta_beta: float
    ux: float
    uy: float
    uV: float
    uA: float
    u_psi: float
    u_beta: float
    uu: float
    vx: float
    vy: float
    vV: float
    vA: float
    v_psi: float
    v_beta: float
    vu: float
    vv: float


class Gains(NamedTuple):
    """Noise of the model and of the sensor."""

    noise: float = 0.05  # standard deviation of a measured position, beside its own covariance [m]
    jerk: float = 2.0  # white noise on the acceleration's rate [m/s3/sqrt(Hz)]
    slip: float = 0.06  # on the slip's [rad/s/sqrt(Hz)]
    yaw: float = 0.15  # on the yaw's [rad/s/sqrt(Hz)]
    huber: float = 3.0  # limit of an innovation; 0: none [standard deviations]
    heading: float = 1.0  # whether the rectangle's heading is used: 1 yes, 0 no [-]
    heading_noise: float = 0.03  # its standard deviation, beside its own variance [rad]
    l_r: float = 2.0  # body centre to rear axle [m]
    coast: float = 1.0  # time constant with which the acceleration fades; 0: it stays [s]
    reverse: float = 4.0  # what reverses faster is turned round, unless `heading` is used [m/s]
    hop: float = 0.0  # standard deviation of the measured point about the centre; 0: it is the centre [m]
    hop_threshold: float = 3.5  # innovation at which the point has hopped [standard deviations]
    hop_time: float = 20.0  # time constant with which an offset is forgotten [s]


# The two filters that Alai & Rajamani 2023 compare with (fig. 10, 11): one trusts the sensor, one the model.
# The paper prints no covariance; the sensor's stated error, 2 cm, is the low one, the rest is chosen here.
LOW_NOISE = Gains(noise=0.02, jerk=5.0, slip=0.1, yaw=0.05, huber=0.0, heading=0.0, coast=0.0)
HIGH_NOISE = LOW_NOISE._replace(noise=0.5)


@kernel
def start(y0: Measurement, y1: Measurement, dt: float, gains: Gains) -> State:
    """State and covariance that two measurements give; the yaw is the heading's, else the way's if clear."""
    x, P = matrix(1, 8), matrix(8, 8)
    begin(x, P, y0, y1, dt, gains)
    if gains.hop > 0.0:  # the centre is as far from the measured point as that is from it
        h, c, s = gains.hop**2, cos(x[0, 4]), sin(x[0, 4])
        P[0, 0], P[1, 1], P[6, 6], P[7, 7] = P[0, 0] + h, P[1, 1] + h, h, h
        P[6, 0], P[6, 1], P[7, 0], P[7, 1] = -c * h, -s * h, s * h, -c * h
        mirror(P)
    bound(x, P)
    return _state(x, P)


@kernel
def step(state: State, previous: Measurement, measurement: Measurement, dt: float, gains: Gains) -> State:
    """Prediction over dt [s], then the correction by the position and the heading of the rectangle."""
    if gains.hop > 0.0:
        return _step(state, measurement, dt, gains, matrix(1, 8), matrix(8, 8), matrix(8, 8), matrix(8, 8))
    return _step(state, measurement, dt, gains, matrix(1, 6), matrix(6, 6), matrix(6, 6), matrix(6, 6))


@kernel
def _step(state: State, y: Measurement, dt: float, gains: Gains, x: Any, P: Any, F: Any, M: Any) -> State:
    if not 0.0 < dt < inf:
        return state
    _load(state, x, P)
    _advance(x, P, F, dt, gains)
    if seen(y):
        _correct(x, P, M, y, gains)
    bound(x, P)
    return _state(x, P)


@kernel
def predict(state: State, dt: float, gains: Gains) -> State:
    """State after dt [s] on its arc, and how uncertain it then is; a braking vehicle stops."""
    if not 0.0 < dt < inf:
        return state
    x, P, F = matrix(1, 8), matrix(8, 8), matrix(8, 8)
    _load(state, x, P)
    _advance(x, P, F, dt, gains)
    bound(x, P)
    return _state(x, P)


@kernel
def motion(state: State, gains: Gains) -> Motion:
    """The state in common terms."""
    s = state
    return told(s.x, s.y, s.V, s.A, s.psi, s.beta, gains.l_r)


@kernel
def innovation(state: State, measurement: Measurement, gains: Gains) -> Innovation:
    """Against the measured point; in its covariance also that this point may have hopped since."""
    x, P, G = matrix(1, 8), matrix(8, 8), matrix(8, 2)
    _load(state, x, P)
    i, h = _against(x, P, G, measurement, gains), gains.hop**2
    return Innovation(i.x, i.y, i.xx + h, i.xy, i.yy + h)


@kernel
def spread(state: State, gains: Gains) -> Spread:
    """Covariance of position and velocity: that of the state through the Jacobian of `motion`."""
    return spread_of(state)


@kernel
def smooth(state: State, later: State, dt: float, gains: Gains) -> State:
    """State with what `later`, dt [s] after it, knows of the motion; Rauch, Tung and Striebel 1965."""
    if not 0.0 < dt < inf:
        return later
    x, P, e, D = matrix(1, 6), matrix(6, 6), matrix(1, 6), matrix(6, 6)
    z, Z, F, G = matrix(1, 6), matrix(6, 6), matrix(6, 6), matrix(6, 6)
    _load(state, x, P)
    _load(later, z, Z)
    if state.V * later.V < 0.0 and cos(later.psi - state.psi) < 0.0:
        turn_round(x, P)  # as was found out since
    for i in range(6):
        e[0, i] = x[0, i]
        for j in range(6):
            D[i, j] = P[i, j]
    _advance(e, D, F, dt, gains)
    product(P, F, G)
    if not cholesky(D, F):
        return state
    for i in range(6):
        e[0, i] = z[0, i] - e[0, i]
        for j in range(6):
            D[i, j] = Z[i, j] - D[i, j]
    e[0, 4] = wrap(e[0, 4])
    look_back(x, P, G, e, D, F)
    bound(x, P)
    return _state(x, P)


def certificate() -> None:
    """None: the gain depends on the estimate, and nothing proves that it converges from everywhere."""


@kernel
def _advance(x: Any, P: Any, F: Any, dt: float, gains: Gains) -> None:
    """x, P after dt [s] on the arc of models.bicycle.arc; F: its Jacobian. The offset is forgotten slowly."""
    t = min(dt, LONGEST)
    V, A, psi, beta = x[0, 2], x[0, 3], x[0, 4], x[0, 5]
    a, v, d = fade(t, gains.coast)
    way, x[0, 2], x[0, 3] = travel(V, A, t, gains.coast)
    bend, twist = sin(beta) / gains.l_r, cos(beta) / gains.l_r  # curvature, and its change by the slip
    half = 0.5 * way * bend
    ch, sh = cos(half), sin(half)
    cm, sm = cos(psi + beta + half), sin(psi + beta + half)  # along the chord
    c1, s1 = cm * ch - sm * sh, sm * ch + cm * sh  # along the path at its end
    sinc, slope = _sinc(half, ch, sh)
    dx, dy, k = way * sinc * cm, way * sinc * sm, 0.5 * way * way * twist
    x[0, 0] += dx
    x[0, 1] += dy
    x[0, 4] = wrap(psi + 2.0 * half)
    n = P.shape[0]
    for i in range(n):
        for j in range(n):
            F[i, j] = 0.0
        F[i, i] = 1.0
    F[0, 2], F[0, 3], F[0, 4], F[0, 5] = t * c1, d * c1, -dy, k * (slope * cm - sinc * sm) - dy
    F[1, 2], F[1, 3], F[1, 4], F[1, 5] = t * s1, d * s1, dx, k * (slope * sm + sinc * cm) + dx
    F[2, 3], F[3, 3] = v, a
    F[4, 2], F[4, 3], F[4, 5] = t * bend, d * bend, way * twist
    for i in range(6, n):
        F[i, i] = exp(-t / gains.hop_time)
        x[0, i] *= F[i, i]
    _carry(F, P)
    disturb(P, t, V + 0.5 * A * v, twist, cm, sm, gains)


@kernel
def _carry(F: Any, P: Any) -> None:
    """Lower half of P <- F P F', by what of F is neither 0 nor 1; each row is used before it is changed."""
    n = P.shape[0]
    for j in range(n):
        P[0, j] += F[0, 2] * P[2, j] + F[0, 3] * P[3, j] + F[0, 4] * P[4, j] + F[0, 5] * P[5, j]
        P[1, j] += F[1, 2] * P[2, j] + F[1, 3] * P[3, j] + F[1, 4] * P[4, j] + F[1, 5] * P[5, j]
        P[4, j] += F[4, 2] * P[2, j] + F[4, 3] * P[3, j] + F[4, 5] * P[5, j]
        P[2, j] += F[2, 3] * P[3, j]
        for i in range(6, n):
            P[i, j] *= F[i, i]
        P[3, j] *= F[3, 3]
    for i in range(n):
        P[i, 0] += F[0, 2] * P[i, 2] + F[0, 3] * P[i, 3] + F[0, 4] * P[i, 4] + F[0, 5] * P[i, 5]
        P[i, 1] += F[1, 2] * P[i, 2] + F[1, 3] * P[i, 3] + F[1, 4] * P[i, 4] + F[1, 5] * P[i, 5]
        P[i, 4] += F[4, 2] * P[i, 2] + F[4, 3] * P[i, 3] + F[4, 5] * P[i, 5]
        P[i, 2] += F[2, 3] * P[i, 3]
        for j in range(6, n):
            P[i, j] *= F[j, j]
        P[i, 3] *= F[3, 3]


@kernel
def _sinc(h: float, c: float, s: float) -> tuple[float, float]:
    """sin(h) / h and its derivative, from h, cos(h), sin(h)."""
    if abs(h) < 1e-2:
        q = h * h
        return 1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0)), -h / 3.0 * (
            1.0 - q / 10.0 * (1.0 - q / 28.0)
        )
    return s / h, (c - s / h) / h


@kernel
def _correct(x: Any, P: Any, G: Any, y: Measurement, gains: Gains) -> None:
    """x, P by the measured point, then by the heading; G: scratch, as large as P."""
    i = _against(x, P, G, y, gains)
    if P.shape[0] > 6 and _square(i) > gains.hop_threshold**2:
        _draw(x, P, gains)
        i = _against(x, P, G, y, gains)
    if P[4, 4] > PSI_KNOWN**2 and x[0, 2] * x[0, 2] < P[2, 2] and _square(i) > LOST**2:
        aim(x, P, atan2(i.y, i.x))
        i = _against(x, P, G, y, gains)
    w = huber(i, gains.huber)
    correct_two(x, P, G, (i.x, i.y), (i.xx / w, i.xy / w, i.yy / w))
    if gains.heading > 0.0 and pointed(y):
        correct_heading(x, P, y, gains)
    elif x[0, 2] < -gains.reverse:
        turn_round(x, P)
    for k in range(6, P.shape[0]):
        x[0, k] = min(max(x[0, k], -REACH * gains.hop), REACH * gains.hop)


@kernel
def _against(x: Any, P: Any, G: Any, y: Measurement, gains: Gains) -> Innovation:
    """Of the measured point h = centre + R(psi) offset, and G = P H' (n, 2), H = dh/dx."""
    n = P.shape[0]
    xx, xy, yy = scatter(y, gains)
    for i in range(n):
        G[i, 0], G[i, 1] = P[i, 0], P[i, 1]
    if n == 6:
        return Innovation(y.x - x[0, 0], y.y - x[0, 1], xx + G[0, 0], xy + G[0, 1], yy + G[1, 1])
    c, s = cos(x[0, 4]), sin(x[0, 4])
    dx, dy = c * x[0, 6] - s * x[0, 7], s * x[0, 6] + c * x[0, 7]
    for i in range(n):
        G[i, 0] += -dy * P[i, 4] + c * P[i, 6] - s * P[i, 7]
        G[i, 1] += dx * P[i, 4] + s * P[i, 6] + c * P[i, 7]
    xx += G[0, 0] - dy * G[4, 0] + c * G[6, 0] - s * G[7, 0]
    xy += G[0, 1] - dy * G[4, 1] + c * G[6, 1] - s * G[7, 1]
    yy += G[1, 1] + dx * G[4, 1] + s * G[6, 1] + c * G[7, 1]
    return Innovation(y.x - x[0, 0] - dx, y.y - x[0, 1] - dy, xx, xy, yy)


@kernel
def _draw(x: Any, P: Any, gains: Gains) -> None:
    """Another point of the body is measured: nothing is known of its offset but `hop`; the motion stays."""
    for i in range(6, 8):
        x[0, i] = 0.0
        for j in range(8):
            P[i, j] = 0.0
            P[j, i] = 0.0
        P[i, i] = gains.hop**2


@kernel
def _square(i: Innovation) -> float:
    """Square of an innovation in standard deviations."""
    return (i.yy * i.x * i.x - 2.0 * i.xy * i.x * i.y + i.xx * i.y * i.y) / (i.xx * i.yy - i.xy * i.xy)


@kernel
def _load(state: State, x: Any, P: Any) -> None:
    """Mean (1, n) and covariance (n, n), as many as x has room for."""
    row = matrix(1, 44)[0]
    to_row(state, row)
    for i in range(x.shape[1]):
        x[0, i] = row[i]
    unpack(row, 8, P)


@kernel
def _state(x: Any, P: Any) -> State:
    """State of mean and covariance; zeros for what they do not have."""
    row = matrix(1, 44)[0]
    for i in range(x.shape[1]):
        row[i] = x[0, i]
    pack(P, row, 8)
    state: State = from_row(State, row)
    return state
