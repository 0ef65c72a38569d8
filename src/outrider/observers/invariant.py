"""Invariant observer: constant gains in the frame of the course, in time along it, in arc length across it.

Our own. An error seen from the vehicle evolves alike whatever its heading, so one set of gains serves all
headings and one certificate covers them (`_invariant_proof`). Equations: docs/observers/invariant.md.
"""

from __future__ import annotations

from math import asin, atan2, cos, exp, expm1, hypot, inf, log1p, pi, sin, sqrt
from typing import Any, NamedTuple

from outrider.kernel import kernel, wrap
from outrider.observers import Innovation, Measurement, Motion
from outrider.observers._chain import Chain, impulse, placed
from outrider.observers._measured import directed, heading_or, pointed, seen

reference = (
    "none but the docs of outrider; rests on P. R. Kalata, The Tracking Index, IEEE Trans. Aerospace and "
    "Electronic Systems, 1984 (constant gains); S. Bonnabel, P. Martin and P. Rouchon, Symmetry-Preserving "
    "Observers, IEEE Trans. Automatic Control, 2008 (error in the moving frame)"
)

SHAPE_ALONG, SHAPE_ACROSS = 0.8, 0.5  # damping of the pair of poles beside the real one [-]
NOMINAL = 0.1, 10.0  # deviation of a position and speed at which `tau` and `arc` hold [m, m/s]
NOMINAL_HEADING = 0.1  # deviation of a heading at which `turn` and `yaw` hold [rad]
V_MAX, A_MAX, SLIP_MAX = 70.0, 100.0, pi / 6.0  # far beyond any vehicle [m/s, m/s2, rad]
REVERSE = 4.0  # nothing reverses faster where no heading says so [m/s]
GATE = 2.0  # a way shorter than this many standard deviations has no direction [-]
CONTRARY = 3.0  # headings in a row that point backwards until the estimate is turned round
RUN_MAX = 30.0  # saturated corrections are counted up to here
LONG, GAP, FAR_R = 1e3, 10.0, 1e6  # an age, a gap, a variance count as no greater [s, s, m2]
SHORT = 1e-4  # and a gap as no shorter [s]


class State(NamedTuple):
    """Estimate at the time of the last sample."""

    x: float  # body centre in W [m]
    y: float  # [m]
    chi: float  # course, in [-pi, pi) [rad]
    V: float  # along the course, negative when reversing [m/s]
    A: float  # [m/s2]
    k: float  # curvature of the path [1/m]
    beta: float  # slip, course minus yaw [rad]
    age: float  # since the first sample, or since the gains were opened again [s]
    blind: float  # since the last correction [s]
    run: float  # saturated corrections in a row
    contrary: float  # headings in a row that pointed backwards


class Gains(NamedTuple):
    """Time constants and lengths in which errors decay, and limits."""

    tau: float = 0.28  # along: position, speed, acceleration [s]
    arc: float = 2.3  # across: offset, course, curvature, by the position [m]
    turn: float = 7.0  # course and curvature, by the heading [m]
    yaw: float = 0.1  # yaw, by the heading [s]
    share: float = 0.15  # part of the course's correction by the position that the yaw takes too [-]
    cross: float = 0.25  # correction of the offset by the heading, relative to that of the course [-]
    relax: float = 5.0  # slip goes over to that of a rolling rear axle within this length [m]
    v0: float = 0.7  # standing, a vehicle counts as moving this fast in arc length [m/s]
    heading: float = 1.0  # 1: the rectangle's heading is used, 0: it is not [-]
    noise: float = 0.03  # standard deviation of a position besides the measured covariance [m]
    heading_noise: float = 0.09  # of a heading besides the measured variance [rad]
    huber: float = 4.0  # an innovation counts as no longer, 0: no limit [standard deviations]
    widen: float = 2.0  # the limit grows by this factor with each saturated sample in a row [-]
    ramp: float = 1.0  # no time constant is longer than this part of the time since the start; 0: off [-]
    coast: float = 1.0  # time constant with which the acceleration fades [s]
    lag: float = 1.0  # time constants of the smoothing, relative to those of the observer [-]
    l_r: float = 2.0  # body centre to rear axle [m]


class Correction(NamedTuple):
    """Gains of one sample; those of a rate per second or per metre."""

    along: Chain  # of the position along on place, speed, acceleration
    across: Chain  # of the position across on offset, course, curvature
    offset: float  # of the heading on the offset [m/rad]
    course: float  # on the course [-]
    curvature: float  # on the curvature [1/m]
    yaw: float  # on the yaw [-]


@kernel
def correction(
    dt: float, V: float, age: float, along: float, across: float, heading: float, gains: Gains
) -> Correction:
    """Gains dt [s] after the last correction at speed V; variances along, across [m2], of the heading [rad2].

    A noisy sensor lengthens the memory by the cube root of its deviation, as a Kalman filter's.
    """
    dt, speed = min(max(dt, SHORT), GAP), abs(V) + gains.v0
    age = max(age, dt)
    ds = speed * dt
    tau = gains.tau * (along / NOMINAL[0] ** 2) ** (1.0 / 6.0)
    arc = gains.arc * (across / NOMINAL[0] ** 2) ** (1.0 / 6.0) * (speed / NOMINAL[1]) ** (1.0 / 3.0)
    deviation = max(sqrt(heading), 1e-3) / NOMINAL_HEADING
    turn, yaw = gains.turn * sqrt(deviation), gains.yaw * deviation
    if gains.ramp > 0.0:
        wide = gains.ramp * age
        tau, arc, turn, yaw = min(tau, wide), min(arc, speed * wide), min(turn, speed * wide), min(yaw, age)
    s = placed(dt / tau, SHAPE_ALONG, dt / gains.coast)
    n = placed(ds / arc, SHAPE_ACROSS, 0.0)
    left = exp(-ds / turn)
    course = 1.0 - left * left
    return Correction(
        Chain(s.p, s.v / dt, s.a / (dt * dt)),
        Chain(n.p, n.v / ds, n.a / (ds * ds)),
        gains.cross * n.p * arc * course,
        course,
        (1.0 - left) ** 2 / ds,
        -expm1(-dt / yaw),
    )


@kernel
def start(y0: Measurement, y1: Measurement, dt: float, gains: Gains) -> State:
    """State on the line from y0 to y1, along the heading where it is known; at rest where nothing is."""
    if not (seen(y0) and seen(y1)):
        y = y1 if seen(y1) else y0
        return State(y.x, y.y, heading_or(y, 0.0), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if not 0.0 < dt < inf:
        return State(y1.x, y1.y, heading_or(y1, 0.0), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    dx, dy = y1.x - y0.x, y1.y - y0.y
    way = wrap(atan2(dy, dx))
    chi, V = way, 0.0
    if gains.heading > 0.0 and pointed(y1):
        chi = heading_or(y1, way)
        V = (dx * cos(chi) + dy * sin(chi)) / dt
    elif directed(dx, dy, y0, y1, gains.noise, GATE):
        V = hypot(dx, dy) / dt
    return _limited(State(y1.x, y1.y, chi, V, 0.0, 0.0, 0.0, dt, 0.0, 0.0, 0.0), gains)


@kernel
def step(state: State, previous: Measurement, measurement: Measurement, dt: float, gains: Gains) -> State:
    """State at the next sample: driven along its arc, then corrected in the frame of its course."""
    y = measurement
    if not (seen(y) and 0.0 < dt < inf):
        return predict(state, dt, gains)
    s = _limited(_driven(state, dt, gains), gains)
    c, n = cos(s.chi), sin(s.chi)
    along, across = c * (y.x - s.x) + n * (y.y - s.y), c * (y.y - s.y) - n * (y.x - s.x)
    r_along, r_across = _variances(y, s.chi, gains)
    r_heading = NOMINAL_HEADING**2
    if pointed(y):
        r_heading = min(y.heading_variance, FAR_R) + gains.heading_noise**2
    L = correction(s.blind, s.V, s.age, r_along, r_across, r_heading, gains)
    square = along * along * (1.0 - L.along.p) / r_along + across * across * (1.0 - L.across.p) / r_across
    limit, u, run = gains.huber * gains.widen**s.run, 1.0, 0.0
    if gains.huber > 0.0 and square > limit * limit:
        u, run = limit / sqrt(square), min(s.run + 1.0, RUN_MAX)
    return _corrected(s, u * along, u * across, y, sqrt(r_heading), L, run, gains)


@kernel
def _corrected(
    s: State,
    along: float,
    across: float,
    y: Measurement,
    sigma: float,
    L: Correction,
    run: float,
    gains: Gains,
) -> State:
    """State after an innovation along and across [m], and that of the heading, of deviation sigma [rad]."""
    points = gains.heading > 0.0 and pointed(y)
    side = max(-1.0, min(1.0, 1.0 + 2.0 * s.V / gains.v0))  # in reverse the course turns the other way
    e, left, contrary = 0.0, 1.0, s.contrary
    if points:
        whole = wrap(y.heading - s.chi + s.beta)
        back = (
            abs(whole) > 0.5 * pi
        )  # which axis the body has is told well, which end is its front not always
        contrary = contrary + 1.0 if back else 0.0
        whole = wrap(whole + pi) if back else whole
        most = gains.huber * sigma if gains.huber > 0.0 else inf
        e = min(max(whole, -most), most)
        left = 1.0 - L.course * (e / whole if e != whole else 1.0)  # what the heading leaves to the position
    by_place = side * left * L.across.v * across
    turned, yawed = by_place + L.course * e, gains.share * by_place + L.yaw * e
    bend = left * L.across.a * across + side * L.curvature * e
    offset = L.across.p * across + side * L.offset * e
    c, n = cos(s.chi), sin(s.chi)
    after = State(
        s.x + c * L.along.p * along - n * offset,
        s.y + n * L.along.p * along + c * offset,
        s.chi + turned,
        s.V + L.along.v * along,
        s.A + L.along.a * along,
        s.k + bend,
        s.beta + turned - yawed,
        s.age,
        0.0,
        run,
        contrary,
    )
    backwards = contrary >= CONTRARY if points else after.V < -REVERSE
    return _limited(_turned_round(after) if backwards else after, gains)


@kernel
def predict(state: State, dt: float, gains: Gains) -> State:
    """State after dt [s] on its arc, the acceleration fading; a braking vehicle stops. Closed form."""
    if not 0.0 < dt < inf:
        return state
    V, A, T = state.V, state.A, gains.coast
    stop = inf
    if V * A < 0.0 and -V / (A * T) < 1.0:
        stop = -T * log1p(V / (A * T))  # when it stands
    s = _driven(state, min(dt, stop), gains)
    if stop <= dt:
        s = State(
            s.x, s.y, s.chi, 0.0, 0.0, s.k, s.beta, s.age + dt - stop, s.blind + dt - stop, s.run, s.contrary
        )
    return _limited(s, gains)


@kernel
def smooth(state: State, later: State, dt: float, gains: Gains) -> State:
    """State with what `later`, dt [s] after it, knows: driven back from it, without what came new.

    A steady Rauch-Tung-Striebel smoother has the poles of its filter, which fixes its gains: what came new is
    an impulse of jerk and one of turning half way. The yaw keeps what its own step knew of it.
    """
    if not 0.0 < dt < inf:
        return state
    p = _driven(state, dt, gains)
    c, n = cos(p.chi), sin(p.chi)
    dx, dy = later.x - p.x, later.y - p.y
    V = later.V if abs(later.V) > 0.1 else 0.1
    speed = abs(later.V) + gains.v0
    ds, way = speed * dt, V * dt
    arc = gains.lag * gains.arc * (speed / NOMINAL[1]) ** (1.0 / 3.0)
    jerk = impulse(
        c * dx + n * dy,
        (later.V - p.V) * dt,
        (later.A - p.A) * dt * dt,
        dt / gains.lag / gains.tau,
        SHAPE_ALONG,
    )
    bend = impulse(
        c * dy - n * dx, wrap(later.chi - p.chi) * way, (later.k - p.k) * way * way, ds / arc, SHAPE_ACROSS
    )
    m = _driven(later, -0.5 * dt, gains)
    jerk, bend = jerk / (dt * dt), bend / (ds * ds)
    m = State(m.x, m.y, m.chi, m.V, m.A - jerk, m.k - bend, m.beta, m.age, m.blind, m.run, m.contrary)
    b = _driven(m, -0.5 * dt, gains)
    g = exp(-dt / gains.yaw)
    yaw = state.chi - state.beta + g * wrap(later.chi - later.beta - p.chi + p.beta)
    beta = wrap(b.chi - yaw)
    s = State(b.x, b.y, b.chi, b.V, b.A, b.k, beta, state.age, state.blind, state.run, state.contrary)
    return _limited(s, gains)


@kernel
def motion(state: State, gains: Gains) -> Motion:
    """The state in common terms."""
    s = state
    return Motion(s.x, s.y, s.V, s.A, wrap(s.chi), wrap(s.chi - s.beta), s.beta, s.V * s.k)


@kernel
def innovation(state: State, measurement: Measurement, gains: Gains) -> Innovation:
    """Against the position; covariance R / (1 - L), with which a Kalman filter would choose the gain L."""
    s, y = state, measurement
    r_along, r_across = _variances(y, s.chi, gains)
    L = correction(s.blind, s.V, s.age, r_along, r_across, NOMINAL_HEADING**2, gains)
    a, b = r_along / max(1.0 - L.along.p, 1e-2), r_across / max(1.0 - L.across.p, 1e-2)
    c, n = cos(s.chi), sin(s.chi)
    xx, xy, yy = c * c * a + n * n * b, c * n * (a - b), n * n * a + c * c * b
    return Innovation(y.x - s.x, y.y - s.y, xx, xy, yy)


def claim(gains: Gains, form: Any = "sampled", **asked: Any) -> Any:
    """What is claimed of the errors under these gains; `claim.Claim`, its region in `_invariant_proof`."""
    from outrider.observers import _invariant_proof

    return _invariant_proof.claim(gains, form, **asked)


def certificate(gains: Gains = Gains()) -> Any:  # noqa: B008
    """Proof that errors decay as they are sampled, with what proves it for the default gains."""
    from outrider import observers, proof_file

    return observers.certificate_of(proof_file.shipped("invariant"), gains)


@kernel
def _variances(y: Measurement, chi: float, gains: Gains) -> Any:
    """Of a position along and across the course chi [m2]."""
    c, n = cos(chi), sin(chi)
    along = y.xx * c * c + 2.0 * y.xy * c * n + y.yy * n * n
    across = y.xx * n * n - 2.0 * y.xy * c * n + y.yy * c * c
    least = max(gains.noise, 1e-3) ** 2
    return _variance(along) + least, _variance(across) + least


@kernel
def _variance(r: float) -> float:
    """A variance that may not be one: negative is none, not a number is no knowledge [m2]."""
    return max(r, 0.0) if r < FAR_R else FAR_R


@kernel
def _driven(s: State, dt: float, gains: Gains) -> State:
    """State dt [s] later, or earlier, on its arc of curvature k; the acceleration fades, the slip relaxes."""
    T = gains.coast
    gone = -expm1(-dt / T)
    D = s.V * dt + s.A * T * (dt - T * gone)  # way
    half = 0.5 * D * s.k  # half the turn
    chord = D * (sin(half) / half if abs(half) > 1e-6 else 1.0 - half * half / 6.0)
    rolling = asin(min(max(gains.l_r * s.k, -0.5), 0.5))
    beta = s.beta
    if dt > 0.0:
        beta = rolling + (beta - rolling) * exp(-abs(D) / gains.relax)
    return State(
        s.x + chord * cos(s.chi + half),
        s.y + chord * sin(s.chi + half),
        s.chi + 2.0 * half,
        s.V + s.A * T * gone,
        s.A * (1.0 - gone),
        s.k,
        beta,
        s.age + dt,
        s.blind + dt,
        s.run,
        s.contrary,
    )


@kernel
def _turned_round(s: State) -> State:
    """The same motion with the front at the other end."""
    return State(s.x, s.y, s.chi + pi, -s.V, -s.A, -s.k, s.beta, s.age, s.blind, s.run, 0.0)


@kernel
def _limited(s: State, gains: Gains) -> State:
    """State within its limits."""
    k = sin(SLIP_MAX) / gains.l_r
    return State(
        s.x,
        s.y,
        wrap(s.chi),
        min(max(s.V, -V_MAX), V_MAX),
        min(max(s.A, -A_MAX), A_MAX),
        min(max(s.k, -k), k),
        min(max(s.beta, -SLIP_MAX), SLIP_MAX),
        min(s.age, LONG),
        min(s.blind, LONG),
        s.run,
        s.contrary,
    )
