"""Unscented Kalman filter on the kinematic bicycle, its path an exact arc; heading and Huber as options.

The transform is written about the image of the mean, which keeps the covariance positive;
docs/observers/ukf.md.
"""

from __future__ import annotations

from math import atan2, cos, inf, sin, sqrt
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
    scatter,
    spread_of,
    turn_round,
)
from outrider.observers._gaussian import cholesky, correct_two, look_back, pack, unpack
from outrider.observers._measured import huber, pointed, seen
from outrider.observers._path import chord, fade, travel
from outrider.observers._path import told as in_common_terms

reference = (
    "E. A. Wan and R. van der Merwe, The Unscented Kalman Filter for Nonlinear Estimation, AS-SPCC 2000; "
    "smoothing: S. Sarkka 2008, IEEE Trans. Automatic Control 53(3), 845-849; bicycle: Alai & Rajamani 2023, "
    "IEEE Trans. Intelligent Vehicles, eq. 1-10"
)

LONGEST = 60.0  # nothing is predicted further than this [s]
LOST = 3.0  # an innovation this wide is no chance [standard deviations]


class State(NamedTuple):
    """Estimate at the time of the last sample, then the lower half of its covariance, row by row."""

    x: float  # body centre in W [m]
    y: float  # [m]
    V: float  # along the course, negative when reversing [m/s]
    A: float  # [m/s2]
    psi: float  # yaw, in [-pi, pi) [rad]
    beta: float  # slip [rad]
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


class Gains(NamedTuple):
    """Noise of the model and of the sensor, and how far out the sigma points lie."""

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
    alpha: float = 1.0  # sigma points lie alpha sqrt(6 + kappa) deviations out [-]
    beta: float = 2.0  # weight of the middle point in the covariance; 2 for a Gaussian, at least alpha^2 [-]
    kappa: float = -3.0  # 3 - 6: fourth moments of a Gaussian; above -6 [-]
    mean: float = 0.0  # the predicted mean is 0: the image of the mean, 1: the mean of the images [-]


@kernel
def start(y0: Measurement, y1: Measurement, dt: float, gains: Gains) -> State:
    """State and covariance that two measurements give; the yaw is the heading's, else the way's if clear."""
    x, P = matrix(1, 6), matrix(6, 6)
    begin(x, P, y0, y1, dt, gains)
    bound(x, P)
    return _state(x, P)


@kernel
def step(state: State, previous: Measurement, measurement: Measurement, dt: float, gains: Gains) -> State:
    """Prediction over dt [s], then the correction by the position and the heading of the rectangle."""
    if not 0.0 < dt < inf:
        return state
    x, P, L, D, y = matrix(1, 6), matrix(6, 6), matrix(6, 6), matrix(8, 6), measurement
    _load(state, x, P)
    _advance(x, P, L, D, dt, gains)
    told = gains.heading > 0.0 and pointed(y)
    if seen(y):
        _correct(x, P, L, y, gains)
        if told:
            correct_heading(x, P, y, gains)
        elif x[0, 2] < -gains.reverse:
            turn_round(x, P)
    bound(x, P)
    return _state(x, P)


@kernel
def predict(state: State, dt: float, gains: Gains) -> State:
    """State after dt [s] on its arc, and how uncertain it then is; a braking vehicle stops."""
    nothing = Measurement(inf, inf, 0.0, 0.0, 0.0, 0.0, inf, 0.0, 0.0)
    return step(state, nothing, nothing, dt, gains)


@kernel
def motion(state: State, gains: Gains) -> Motion:
    """The state in common terms."""
    s = state
    return in_common_terms(s.x, s.y, s.V, s.A, s.psi, s.beta, gains.l_r)


@kernel
def innovation(state: State, measurement: Measurement, gains: Gains) -> Innovation:
    """Against the position; its covariance: the state's and the sensor's."""
    s, y = state, measurement
    xx, xy, yy = scatter(y, gains)
    return Innovation(y.x - s.x, y.y - s.y, s.xx + xx, s.yx + xy, s.yy + yy)


@kernel
def spread(state: State, gains: Gains) -> Spread:
    """Covariance of position and velocity: that of the state through u = V cos(chi), v = V sin(chi)."""
    return spread_of(state)


@kernel
def smooth(state: State, later: State, dt: float, gains: Gains) -> State:
    """State with what `later`, dt [s] after it, knows; unscented Rauch-Tung-Striebel step, Sarkka 2008."""
    if not 0.0 < dt < inf:
        return later
    x, P, L, G, points = matrix(1, 6), matrix(6, 6), matrix(6, 6), matrix(6, 6), matrix(8, 6)
    e, D, x1, P1 = matrix(1, 6), matrix(6, 6), matrix(1, 6), matrix(6, 6)
    _load(state, x, P)
    _load(later, e, D)
    if state.V * later.V < 0.0 and cos(later.psi - state.psi) < 0.0:
        turn_round(x, P)  # as was found out since
    for i in range(6):
        x1[0, i] = x[0, i]
        for j in range(6):
            P1[i, j] = P[i, j]
    _advance(x1, P1, L, points, dt, gains)
    _between(L, points, gains, G)
    _root(P1, L)
    for i in range(6):
        e[0, i] -= x1[0, i]
        for j in range(6):
            D[i, j] -= P1[i, j]
    e[0, 4] = wrap(e[0, 4])
    look_back(x, P, G, e, D, L)
    bound(x, P)
    return _state(x, P)


def certificate() -> None:
    """None: the gain depends on the estimate, and nothing proves that it converges from everywhere."""


# ------------------------------------------------------------------ the filter's two halves


@kernel
def _advance(x: Any, P: Any, L: Any, D: Any, dt: float, gains: Gains) -> None:
    """Scaled unscented transform of x, P over dt [s], noise added; L (6, 6), D (8, 6): factor of P, images.

    With d the images of the points less that of the mean, w their weight and b = w sum(d): the covariance is
    w sum(d d') and, where the mean is that of the images, (beta - alpha^2) b b' more: the usual sums without
    a negative weight. The factor L has x and y last: so turning the world turns the points, and the last two
    pairs are only shifted, their images known. Where the vehicle stops, all points lose the same.
    """
    b = matrix(1, 6)
    _points(P, L)
    t, out = min(dt, LONGEST), gains.alpha**2 * (6.0 + gains.kappa)
    w, r = 0.5 / out, sqrt(out)
    a, v, s = fade(t, gains.coast)
    V, A, psi, beta = x[0, 2], x[0, 3], x[0, 4], x[0, 5]
    way, x[0, 2], x[0, 3] = travel(V, A, t, gains.coast)
    dx, dy, turn = chord(way, psi + beta, sin(beta) / gains.l_r)
    for k in range(8):
        i, h = (k, r) if k < 4 else (k - 4, -r)
        dV, dA, dpsi, dbeta = h * L[0, i], h * L[1, i], h * L[2, i], h * L[3, i]
        slip = beta + dbeta
        ux, uy, u = chord(way + dV * t + dA * s, psi + dpsi + slip, sin(slip) / gains.l_r)
        D[k, 0], D[k, 1] = h * L[4, i] + (ux - dx), h * L[5, i] + (uy - dy)
        D[k, 2], D[k, 3], D[k, 4], D[k, 5] = dV + dA * v, dA * a, dpsi + (u - turn), dbeta
        for j in range(6):
            b[0, j] += w * D[k, j]
    m = 1.0 if gains.mean > 0.0 else 0.0
    _sum(P, L, D, b, w, m * (gains.beta - gains.alpha**2))
    x[0, 0] += dx + m * b[0, 0]
    x[0, 1] += dy + m * b[0, 1]
    x[0, 4] = wrap(psi + turn + m * b[0, 4])
    chi = psi + beta + 0.5 * turn
    disturb(P, t, V + 0.5 * A * v, cos(beta) / gains.l_r, cos(chi), sin(chi), gains)


@kernel
def _points(P: Any, L: Any) -> None:
    """Factor L (6, 6) of P in the order V, A, psi, beta, x, y."""
    M = matrix(6, 6)
    for i in range(4):
        for j in range(i + 1):
            M[i, j] = P[i + 2, j + 2]
    for i in range(2):
        for j in range(4):
            M[i + 4, j] = P[i, j + 2]
        for j in range(i + 1):
            M[i + 4, j + 4] = P[i, j]
    _root(M, L)


@kernel
def _root(P: Any, L: Any) -> None:
    """Cholesky factor L of P (6, 6), P made a little larger where rounding has left it without one."""
    larger = 1e-12
    while not cholesky(P, L) and larger < 1e12:
        for i in range(6):
            P[i, i] += larger * (1.0 + P[i, i])
        larger *= 100.0


@kernel
def _sum(P: Any, L: Any, D: Any, b: Any, w: float, bb: float) -> None:
    """Lower half of P from images D (8, 6) of weight w, the shifted ones, and bb times the square of b."""
    for i in range(6):
        for j in range(i + 1):
            total = 0.0
            for k in range(8):
                total += D[k, i] * D[k, j]
            P[i, j] = w * total + bb * b[0, i] * b[0, j]
    P[0, 0] += L[4, 4] ** 2
    P[1, 0] += L[5, 4] * L[4, 4]
    P[1, 1] += L[5, 4] ** 2 + L[5, 5] ** 2


@kernel
def _between(L: Any, D: Any, gains: Gains, G: Any) -> None:
    """G (6, 6): covariance of what was and of what it becomes."""
    w = 0.5 / sqrt(gains.alpha**2 * (6.0 + gains.kappa))
    for i in range(6):
        row = (i + 4) % 6
        for j in range(6):
            total = 0.0
            for k in range(min(row + 1, 4)):
                total += L[row, k] * (D[k, j] - D[k + 4, j])
            G[i, j] = w * total
    for i in range(2):
        for j in range(2):
            G[i, j] += L[4 + i, 4] * L[4 + j, 4] + L[4 + i, 5] * L[4 + j, 5]


@kernel
def _correct(x: Any, P: Any, G: Any, y: Measurement, gains: Gains) -> None:
    """x, P by the position, of which the state says enough without points; G: scratch."""
    r = scatter(y, gains)
    ex, ey, xx, xy, yy = y.x - x[0, 0], y.y - x[0, 1], P[0, 0] + r[0], P[1, 0] + r[1], P[1, 1] + r[2]
    far = (yy * ex * ex - 2.0 * xy * ex * ey + xx * ey * ey) / (xx * yy - xy * xy)
    if far > LOST**2 and P[4, 4] > PSI_KNOWN**2 and x[0, 2] * x[0, 2] < P[2, 2]:
        aim(x, P, atan2(ey, ex))
    for i in range(6):
        G[i, 0], G[i, 1] = P[i, 0], P[i, 1]
    w = huber(Innovation(ex, ey, xx, xy, yy), gains.huber)
    correct_two(x, P, G, (ex, ey), (xx / w, xy / w, yy / w))


# ------------------------------------------------------------------ state


@kernel
def _load(state: State, x: Any, P: Any) -> None:
    """Mean (1, 6) and covariance (6, 6) of a state."""
    row = matrix(1, 27)[0]
    to_row(state, row)
    for i in range(6):
        x[0, i] = row[i]
    unpack(row, 6, P)


@kernel
def _state(x: Any, P: Any) -> State:
    """State of mean and covariance."""
    row = matrix(1, 27)[0]
    for i in range(6):
        row[i] = x[0, i]
    pack(P, row, 6)
    state: State = from_row(State, row)
    return state
