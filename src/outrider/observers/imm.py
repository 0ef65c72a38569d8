"""Interacting multiple models: straight at constant speed, or a coordinated turn; Blom and Bar-Shalom 1988.

The two motions are in _turning.py; they have no yaw and no acceleration, how these are found is in
docs/observers/imm.md.
"""

from __future__ import annotations

from math import asin, atan2, ceil, cos, exp, inf, pi, sin, sqrt
from typing import Any, NamedTuple

from outrider.kernel import from_row, kernel, matrix, to_row, wrap
from outrider.observers import Innovation, Measurement, Motion, Spread
from outrider.observers._bicycle import PSI_KNOWN, SLIP_MAX, V_MAX, V_START, heading_scatter, scatter
from outrider.observers._gaussian import limit, pack, unpack
from outrider.observers._measured import directed, pointed, seen
from outrider.observers._turning import back_round, back_straight, correct, go_round, go_straight, mean, mix

reference = (
    "H. A. P. Blom and Y. Bar-Shalom 1988, IEEE Trans. Automatic Control 33(8), 780-783; coordinated turn: "
    "Bar-Shalom, Li and Kirubarajan 2001, section 11.7; smoothing: C.-J. Kim 1994, J. Econometrics 60, 1-22"
)

LONGEST = 60.0  # nothing is predicted further than this [s]
LEAP = 0.2  # the motions mix at least this often [s]
WIDEST = (1e6, 1e6, V_MAX**2, V_MAX**2, 10.0)  # variances at most
MOST_SLIP = sin(SLIP_MAX)
W_MAX, A_MAX = 10.0, 100.0  # far beyond any vehicle: only keep numbers finite [rad/s, m/s2]
A_START = 3.0  # deviation of what acceleration there is at the start [m/s2]
GATE = 2.0  # standard deviations a way must be long to have a direction [-]
DRIFT = 0.1  # of the yaw, beside the turn rate [rad/sqrt(s)]
FRESH = 0.01  # variance of the yaw at most as small as this when it is measured anew [rad2]


class State(NamedTuple):
    """Each motion's estimate with the lower half of its covariance, and what is common to both."""

    sx: float  # straight: body centre in W [m]
    sy: float  # [m]
    su: float  # its velocity [m/s]
    sv: float  # [m/s]
    sxx: float
    syx: float
    syy: float
    sux: float
    suy: float
    suu: float
    svx: float
    svy: float
    svu: float
    svv: float
    tx: float  # turning: body centre in W [m]
    ty: float  # [m]
    tu: float  # its velocity [m/s]
    tv: float  # [m/s]
    tw: float  # its turn rate [rad/s]
    txx: float
    tyx: float
    tyy: float
    tux: float
    tuy: float
    tuu: float
    tvx: float
    tvy: float
    tvu: float
    tvv: float
    twx: float
    twy: float
    twu: float
    twv: float
    tww: float
    turning: float  # probability that it turns, in [0, 1]
    psi: float  # yaw, in [-pi, pi) [rad]
    psi_psi: float  # its variance, if it were measured anew each time [rad2]
    A: float  # acceleration along the course [m/s2]
    age: float  # time since the last measurement [s]


class Gains(NamedTuple):
    """Noise of the two motions and of the sensor, and how often one becomes the other."""

    noise: float = 0.08  # standard deviation of a measured position, beside its own covariance [m]
    straight: float = 1.8  # white noise on the acceleration when going straight [m/s2/sqrt(Hz)]
    turning: float = 1.0  # when turning [m/s2/sqrt(Hz)]
    turn_rate: float = 0.2  # on the rate of the turn rate [rad/s2/sqrt(Hz)]
    turn: float = 0.4  # standard deviation of the turn rate with which a turn begins [rad/s]
    begin: float = 0.3  # probability a second that a turn begins [1/s]
    end: float = 0.6  # that it ends [1/s]
    huber: float = 3.0  # limit of an innovation; 0: none [standard deviations]
    heading: float = 1.0  # whether the rectangle's heading is used: 1 yes, 0 no [-]
    heading_noise: float = 0.03  # its standard deviation, beside its own variance [rad]
    l_r: float = 2.0  # body centre to rear axle; 0: the yaw is the course [m]
    settle: float = 0.5  # time constant of the acceleration, the smoothed derivative of the speed [s]
    reverse: float = 4.0  # what reverses faster is turned round, unless `heading` is used [m/s]


@kernel
def start(y0: Measurement, y1: Measurement, dt: float, gains: Gains) -> State:
    """Both motions from two measurements; the yaw is the heading's, else the way's."""
    x, P, z, Z = matrix(1, 5), matrix(5, 5), matrix(1, 5), matrix(5, 5)
    y, h = y1 if seen(y1) else y0, y1 if pointed(y1) else y0
    x[0, 0], x[0, 1] = y.x, y.y
    P[0, 0], P[1, 0], P[1, 1] = scatter(y, gains)
    P[2, 2], P[3, 3], P[4, 4] = V_START**2, V_START**2, max(gains.turn**2, 1e-12)
    psi, variance = 0.0, 1.0
    if seen(y0) and seen(y1) and 0.0 < dt < inf:
        dx, dy, t = y1.x - y0.x, y1.y - y0.y, max(dt, 1e-6)
        xx, xy, yy = scatter(y0, gains)
        a = (0.5 * A_START * t) ** 2
        x[0, 2], x[0, 3] = dx / t, dy / t
        P[2, 0], P[2, 1], P[3, 0], P[3, 1] = P[0, 0] / t, P[1, 0] / t, P[1, 0] / t, P[1, 1] / t
        P[2, 2], P[3, 2], P[3, 3] = (
            (P[0, 0] + xx) / t**2 + a,
            (P[1, 0] + xy) / t**2,
            (P[1, 1] + yy) / t**2 + a,
        )
        psi = atan2(dy, dx)
        variance = FRESH if directed(dx, dy, y0, y1, gains.noise, GATE) else 1.0
    if gains.heading > 0.0 and pointed(h):
        psi, variance = wrap(h.heading), min(heading_scatter(h, gains), 1.0)
    for i in range(5):
        z[0, i] = x[0, i]
        for j in range(i + 1):
            P[j, i], Z[i, j], Z[j, i] = P[i, j], P[i, j], P[i, j]
    change = gains.begin + gains.end
    turning = gains.begin / change if change > 0.0 else 0.5
    return _state(x, P, z, Z, turning, psi, variance, 0.0, 0.0)


@kernel
def step(state: State, previous: Measurement, measurement: Measurement, dt: float, gains: Gains) -> State:
    """Mixing and both predictions over dt [s], then what the measurement says."""
    if not 0.0 < dt < inf:
        return state
    x, P, z, Z = matrix(1, 5), matrix(5, 5), matrix(1, 5), matrix(5, 5)
    F, M, t, y = matrix(5, 5), matrix(5, 5), min(dt, LONGEST), measurement
    _load(state, x, P, z, Z, gains.turn)
    p, psi, n = state.turning, state.psi, ceil(t / LEAP)
    h = t / n
    for _ in range(n):
        w = p * z[0, 4]
        p = _mixed(p, x, P, z, Z, h, gains)
        go_straight(x, P, F, h, gains.straight, gains.turn)
        go_round(z, Z, F, h, gains.turning, gains.turn_rate)
        psi += 0.5 * h * (w + p * z[0, 4])
    A, age = state.A * exp(-t / gains.settle), min(state.age + t, LONGEST)
    variance = min(max(state.psi_psi, FRESH) + DRIFT**2 * t, 3.0)
    if seen(y):
        p, psi, variance, A = _measured(x, P, z, Z, F, M, y, p, psi, variance, A, age, gains)
        age = 0.0
    return _state(x, P, z, Z, p, psi, variance, A, age)


@kernel
def predict(state: State, dt: float, gains: Gains) -> State:
    """State after dt [s] without a measurement: both motions go on and mix."""
    nothing = Measurement(inf, inf, 0.0, 0.0, 0.0, 0.0, inf, 0.0, 0.0)
    return step(state, nothing, nothing, dt, gains)


@kernel
def motion(state: State, gains: Gains) -> Motion:
    """The mean of both motions in common terms."""
    x, P = matrix(1, 5), matrix(5, 5)
    _mean_of(state, x, P)
    u, v, psi = x[0, 2], x[0, 3], state.psi
    V = _speed(u, v, psi)
    chi = wrap(atan2(v, u) + (pi if V < 0.0 else 0.0)) if V * V > 0.0 else psi
    return Motion(x[0, 0], x[0, 1], V, state.A, chi, psi, wrap(chi - psi), x[0, 4])


@kernel
def innovation(state: State, measurement: Measurement, gains: Gains) -> Innovation:
    """Against the mean position; its covariance: both motions', how far they are apart, and the sensor's."""
    x, P, y = matrix(1, 5), matrix(5, 5), measurement
    _mean_of(state, x, P)
    xx, xy, yy = scatter(y, gains)
    return Innovation(y.x - x[0, 0], y.y - x[0, 1], P[0, 0] + xx, P[1, 0] + xy, P[1, 1] + yy)


@kernel
def spread(state: State, gains: Gains) -> Spread:
    """Covariance of position and velocity of the mixture."""
    x, P = matrix(1, 5), matrix(5, 5)
    _mean_of(state, x, P)
    return Spread(P[0, 0], P[1, 0], P[1, 1], P[2, 0], P[2, 1], P[2, 2], P[3, 0], P[3, 1], P[3, 2], P[3, 3])


@kernel
def smooth(state: State, later: State, dt: float, gains: Gains) -> State:
    """State with what `later`, dt [s] after it, knows: a step back for each pair of motions, Kim 1994."""
    if not 0.0 < dt < inf:
        return later
    x, P, z, Z = matrix(1, 5), matrix(5, 5), matrix(1, 5), matrix(5, 5)
    o, O, n, N = matrix(1, 5), matrix(5, 5), matrix(1, 5), matrix(5, 5)
    t = min(dt, LONGEST)
    p = _looked_back(state, later, x, P, z, Z, t, gains)
    mean(x, P, z, Z, p, o, O)
    _mean_of(later, n, N)
    psi, A = state.psi if cos(later.psi - state.psi) >= 0.0 else state.psi + pi, later.A  # known since
    then = state.psi_psi + DRIFT**2 * t + t * t * O[4, 4]  # variance of the yaw, as foretold
    K = state.psi_psi / then
    psi += K * wrap(later.psi - 0.5 * t * (o[0, 4] + n[0, 4]) - psi)
    variance = state.psi_psi + K * K * (later.psi_psi - then)
    gained = _gained(o[0, 2], o[0, 3], n[0, 2], n[0, 3], later.psi)
    A += (1.0 - exp(-t / gains.settle)) * (gained / t - A)
    return _state(x, P, z, Z, p, psi, variance, A, state.age)


def certificate() -> None:
    """None: the gain depends on the estimate, and nothing proves that it converges from everywhere."""


# ------------------------------------------------------------------ which motion


@kernel
def _changes(t: float, gains: Gains) -> tuple[float, float]:
    """Probabilities that within t [s] straight becomes turning, and turning straight: a Markov process."""
    change = gains.begin + gains.end
    if not change > 0.0:
        return 0.0, 0.0
    share = (1.0 - exp(-change * t)) / change
    return gains.begin * share, gains.end * share


@kernel
def _mixed(p: float, x: Any, P: Any, z: Any, Z: Any, t: float, gains: Gains) -> float:
    """Probability of turning t [s] later; x, P and z, Z become what each motion begins with. p: it was."""
    begins, ends = _changes(t, gains)
    to, away = p * (1.0 - ends) + (1.0 - p) * begins, p * ends + (1.0 - p) * (1.0 - begins)
    mix(x, P, z, Z, p * ends / away if away > 0.0 else 0.0, (1.0 - p) * begins / to if to > 0.0 else 0.0)
    return to


@kernel
def _looked_back(s: State, later: State, x: Any, P: Any, z: Any, Z: Any, t: float, gains: Gains) -> float:
    """Probability of turning, x, P and z, Z of s with what `later` knows: each pair of motions, Kim 1994."""
    e, D, f, E = matrix(1, 5), matrix(5, 5), matrix(1, 5), matrix(5, 5)
    o, O, r, R = matrix(1, 5), matrix(5, 5), matrix(1, 5), matrix(5, 5)
    p, q, (begins, ends) = s.turning, later.turning, _changes(t, gains)
    to, away = p * (1.0 - ends) + (1.0 - p) * begins, p * ends + (1.0 - p) * (1.0 - begins)
    begun = q * (1.0 - p) * begins / to if to > 0.0 else 0.0
    ended = (1.0 - q) * p * ends / away if away > 0.0 else 0.0
    now = min(max(q - begun + ended, 0.0), 1.0)
    _load(s, x, P, z, Z, gains.turn)
    _load(s, o, O, r, R, gains.turn)
    _load(later, e, D, f, E, gains.turn)
    back_straight(x, P, e, D, t, gains.straight, gains.turn)
    back_straight(r, R, e, D, t, gains.straight, gains.turn)
    back_round(o, O, f, E, t, gains.turning, gains.turn_rate)
    back_round(z, Z, f, E, t, gains.turning, gains.turn_rate)
    mix(x, P, o, O, begun / (1.0 - now) if now < 1.0 else 0.0, 0.0)
    mix(z, Z, r, R, ended / now if now > 0.0 else 0.0, 0.0)
    return now


# ------------------------------------------------------------------ what comes after


@kernel
def _measured(
    x: Any,
    P: Any,
    z: Any,
    Z: Any,
    O: Any,
    M: Any,
    y: Measurement,
    p: float,
    psi: float,
    variance: float,
    A: float,
    age: float,
    gains: Gains,
) -> tuple[float, float, float, float]:
    """Both motions corrected; how likely turning now is, yaw, its variance, acceleration. O, M: scratch."""
    o, told = matrix(1, 5), gains.heading > 0.0 and pointed(y)
    u, v = x[0, 2] + p * (z[0, 2] - x[0, 2]), x[0, 3] + p * (z[0, 3] - x[0, 3])
    more = correct(z, Z, M, y, told, gains.l_r, gains) - correct(x, P, M, y, told, 0.0, gains)
    p = p / (p + (1.0 - p) * exp(min(max(-more, -700.0), 700.0))) if p > 0.0 else 0.0
    mean(x, P, z, Z, p, o, O)
    if told:
        r = heading_scatter(y, gains)
        psi += variance / (variance + r) * wrap(y.heading - psi)
        variance *= r / (variance + r)
    front, variance = _facing(o, O, psi, variance, told, gains)
    if cos(front - psi) < 0.0:  # it was taken for the rear
        A = -A
    gained = _gained(u, v, o[0, 2], o[0, 3], front)
    return p, front, variance, A + (1.0 - exp(-age / gains.settle)) * gained / age


@kernel
def _speed(u: float, v: float, psi: float) -> float:
    """Length of the velocity (u, v), negative where it is against the yaw."""
    V = sqrt(u * u + v * v)
    return V if u * cos(psi) + v * sin(psi) >= 0.0 else -V


@kernel
def _gained(u0: float, v0: float, u: float, v: float, psi: float) -> float:
    """By how much the velocity has grown along the course of (u, v)."""
    V = _speed(u, v, psi)
    return ((u - u0) * u + (v - v0) * v) / V if V * V > 0.0 else 0.0


@kernel
def _facing(x: Any, P: Any, psi: float, variance: float, told: bool, gains: Gains) -> tuple[float, float]:
    """Yaw and its variance, of which psi and `variance` are known, from the velocity: course less slip.

    sin(slip) = l_r w / V on a circle. A front that is not known is where the body goes.
    """
    u, v, l, V = x[0, 2], x[0, 3], gains.l_r, _speed(x[0, 2], x[0, 3], psi)
    square = V * V
    if not square > 1e-12:
        return psi, variance
    across = (P[2, 2] * v * v - 2.0 * P[3, 2] * u * v + P[3, 3] * u * u) / square
    unknown = variance > PSI_KNOWN**2 and square > GATE * GATE * across
    if V < 0.0 and not told and (unknown or square > gains.reverse**2):
        psi, V = psi + pi, -V
    chi = atan2(v, u) + (pi if V < 0.0 else 0.0)
    beta = asin(min(max(l * x[0, 4] / V, -MOST_SLIP), MOST_SLIP))
    gain = variance * square / (variance * square + across + l * l * P[4, 4])
    return psi + gain * wrap(chi - beta - psi), (1.0 - gain) * variance


# ------------------------------------------------------------------ state


@kernel
def _load(s: State, x: Any, P: Any, z: Any, Z: Any, turn: float) -> None:
    """Straight x, P and turning z, Z; to the first, which has none, a turn rate 0 of deviation `turn`."""
    row = matrix(1, 39)[0]
    to_row(s, row)
    unpack(row, 4, P)  # its last row is not in the state
    unpack(row, 19, Z)
    for i in range(5):
        x[0, i], z[0, i] = row[i], row[14 + i]
        P[i, 4], P[4, i] = 0.0, 0.0
    x[0, 4], P[4, 4] = 0.0, turn * turn


@kernel
def _mean_of(s: State, o: Any, O: Any) -> None:
    """Mean (1, 5) and covariance (5, 5) of both motions together."""
    x, P, z, Z = matrix(1, 5), matrix(5, 5), matrix(1, 5), matrix(5, 5)
    _load(s, x, P, z, Z, 0.0)
    mean(x, P, z, Z, s.turning, o, O)


@kernel
def _state(
    x: Any, P: Any, z: Any, Z: Any, turning: float, psi: float, variance: float, A: float, age: float
) -> State:
    """State of both motions, within their limits."""
    row = matrix(1, 39)[0]
    for i in range(5):
        limit(P, i, WIDEST[i])
        limit(Z, i, WIDEST[i])
        most = V_MAX if i < 4 else W_MAX
        if i > 1:
            x[0, i], z[0, i] = min(max(x[0, i], -most), most), min(max(z[0, i], -most), most)
    pack(P, row, 4)  # its last row is written over
    pack(Z, row, 19)
    for i in range(4):
        row[i] = x[0, i]
    for i in range(5):
        row[14 + i] = z[0, i]
    row[34], row[35], row[36] = turning, wrap(psi), variance
    row[37], row[38] = min(max(A, -A_MAX), A_MAX), age
    state: State = from_row(State, row)
    return state
