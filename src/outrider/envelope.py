"""Guaranteed bounds: how far any estimate can be from the truth, if the sensor is wrong by at most d.

Assumed of the centre p(t) of a road user: every measurement y of it is within d, its acceleration within a,
its speed within s. Two measurements, T apart, then give its velocity at the later one,

    v1 = (y1 - y0) / T     up to     2 d / T + a T / 2,

which is least at T = 2 sqrt(d / a): 2 sqrt(a d). No estimator can promise less (Landau 1913; docs/bounds.md).
Every pair of the last measurements gives such a disc, and the truth is in all of them: whatever an observer
says, its velocity is wrong by at most its distance from the middle of a disc plus the radius.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from outrider import settings
from outrider.certificate import Bound, Certificate, peak
from outrider.compiler import compiled
from outrider.errors import InputError
from outrider.kernel import kernel
from outrider.records import Array, Bools, Ints

LOOKS = 16  # measurements remembered of a track
ROUNDING = 1e-9  # a measurement contradicts only if it is farther than that beyond what is possible [-, m]
PACE, WEIGHT = 0.8, 0.5  # of the certificate: rate a step, and weight of a look over that of the one after it


class Limits(NamedTuple):
    """What is assumed, full-size lengths."""

    position: float  # |measured - true centre| <= d [m]
    acceleration: float  # |acceleration of the centre| <= a [m/s2]
    speed: float  # |velocity of the centre| <= s [m/s]


def limits(envelope: settings.Envelope) -> Limits | None:
    """What the settings assume; None where they ask for no bounds."""
    e = envelope
    return Limits(e.position_m, e.acceleration_mps2, e.speed_mps) if e.position_m > 0.0 else None


def check(given: settings.Settings) -> None:
    """InputError for limits that cannot be, or alerts that would act on bounds that nobody keeps."""
    for name in given.envelope.__struct_fields__:
        value = getattr(given.envelope, name)
        least = value >= 0.0 if name == "position_m" else value > 0.0
        if not (least and value < np.inf):
            want = "0 (no bounds) or a positive number" if name == "position_m" else "a positive number"
            raise InputError(f"envelope.{name} is {value}: want {want}")
    if given.alert.act_on == "earliest" and limits(given.envelope) is None:
        raise InputError(
            "alert.act_on is earliest, but nothing is bounded: set envelope.position_m to the largest error "
            "of a measured centre, such as 0.1"
        )


# ------------------------------------------------------------------ at run time


def look(looks: Array, rows: Ints, t: Array, W_y: Array, assumed: Limits) -> Bools:
    """Take what was measured of tracks into `looks` (n, LOOKS, 3), and say whose assumptions broke, (n,).

    looks: time [s] and centre [m] of the last measurements, newest first, NaN where there is none; changed in
    place. rows (k,): the tracks seen; t (n,) [s], W_y (n, 2) [m]. A measurement that cannot be, after those
    before, means that an assumption failed then or now: nothing but that measurement is kept.
    """
    broken = np.zeros(len(looks), np.bool_)
    if len(rows):
        _look(looks, rows, t, W_y, assumed, broken)
    return broken


def bounds(looks: Array, t: float, W_p: Array, W_v: Array, assumed: Limits) -> Array:
    """(n, 2) how far estimates of centre [m] and velocity [m/s] at t [s] can be from the truth; inf: any far.

    looks: see `look`. W_p (n, 2) [m], W_v (n, 2) [m/s]: the estimates, by whatever observer.
    """
    out = np.full((len(looks), 2), np.inf)
    if len(looks):
        _bounds(looks, t, W_p, W_v, assumed, out)
    return out


@kernel
def velocity(looks: Any, k: int, c: Limits) -> Any:
    """Disc (x, y, radius) [m/s] with the velocity at the newest look, by the k-th before; 0: by top speed."""
    if k == 0:
        return 0.0, 0.0, c.speed
    T = looks[0, 0] - looks[k, 0]
    radius = 2.0 * c.position / T + 0.5 * c.acceleration * T
    return (looks[0, 1] - looks[k, 1]) / T, (looks[0, 2] - looks[k, 2]) / T, radius


@kernel
def _reach(k: int, radius: float, ahead: float, c: Limits) -> Any:
    """Radii [m, m/s] of where a body is, and how fast, `ahead` [s] after a velocity within `radius`."""
    more = c.acceleration * abs(ahead) if k else 0.0  # the top speed holds then as now
    return c.position + (radius + 0.5 * more) * abs(ahead), radius + more


@kernel
def _possible(looks: Any, t: float, x: float, y: float, c: Limits) -> Any:
    """Whether a measurement (x, y) at t can follow those before."""
    ahead = t - looks[0, 0]
    for k in range(LOOKS):
        if looks[k, 0] != looks[k, 0]:
            break
        vx, vy, radius = velocity(looks, k, c)
        far = np.hypot(x - looks[0, 1] - vx * ahead, y - looks[0, 2] - vy * ahead)
        most = _reach(k, radius, ahead, c)[0] + c.position
        if far > most + ROUNDING * (1.0 + abs(x) + abs(y) + most):
            return False
    return True


@compiled
def _look(looks: Array, rows: Ints, t: Array, W_y: Array, c: Limits, broken: Bools) -> None:
    for i in rows:
        x, y = W_y[i, 0], W_y[i, 1]
        if looks[i, 0, 0] == looks[i, 0, 0]:
            broken[i] = t[i] > looks[i, 0, 0] and not _possible(looks[i], t[i], x, y, c)
            if broken[i] or t[i] <= looks[i, 0, 0]:
                looks[i] = np.nan
        for k in range(LOOKS - 1, 0, -1):
            looks[i, k] = looks[i, k - 1]
        looks[i, 0, 0], looks[i, 0, 1], looks[i, 0, 2] = t[i], x, y


@compiled
def _bounds(looks: Array, t: float, W_p: Array, W_v: Array, c: Limits, out: Array) -> None:
    for i in range(len(looks)):
        ahead = t - looks[i, 0, 0]
        for k in range(LOOKS):
            if looks[i, k, 0] != looks[i, k, 0]:
                break
            vx, vy, radius = velocity(looks[i], k, c)
            position, speed = _reach(k, radius, ahead, c)
            x, y = looks[i, 0, 1] + vx * ahead, looks[i, 0, 2] + vy * ahead
            far, fast = np.hypot(W_p[i, 0] - x, W_p[i, 1] - y), np.hypot(W_v[i, 0] - vx, W_v[i, 1] - vy)
            if far + position < out[i, 0]:  # never where it is NaN
                out[i, 0] = far + position
            if fast + speed < out[i, 1]:
                out[i, 1] = fast + speed


# ------------------------------------------------------------------ beforehand


def steps(position: float, acceleration: float, dt: float) -> int:
    """How many steps of dt [s] lie between the two measurements that bound the velocity best."""
    T = dt * np.arange(1, LOOKS)
    return 1 + int(np.argmin(2.0 * position / T + 0.5 * acceleration * T))


def certificate(position: float, acceleration: float, dt: float = 0.1) -> Certificate:
    """Proof of the bounds in steady state, measured every dt [s] within d [m], |acceleration| <= a [m/s2].

    The error's states are the errors of the last LOOKS measurements: from one to the next they move on by one
    place, and the oldest is forgotten, whatever dt is. So one P proves the decay for all time steps, and the
    bounds are sums of impulse responses that end. That of the speed is 2 / T by position and T / 2 by
    acceleration, T = `steps` * dt. InputError for a number that is not positive.
    """
    for name, value in (("position", position), ("acceleration", acceleration), ("dt", dt)):
        if not 0.0 < value < np.inf:
            raise InputError(f"{name} is {value}: want a positive number")
    m = steps(position, acceleration, dt)
    A, B = np.eye(LOOKS, k=-1), np.eye(LOOKS, 1)
    here, across, pushed = np.zeros((3, 1, LOOKS))
    here[0, 0] = 1.0
    across[0, [0, m]] = np.array([1.0, -1.0]) / (m * dt)
    pushed[0, :m] = dt * (m - 0.5 - np.arange(m)) / m  # integral over a step of (s - t0) / T, newest first
    kinds = (("position", "position", here), ("speed", "position", across), ("speed", "acceleration", pushed))
    exact = [Bound(of, by, peak(A, B, C, "sampled"), True, A=A[None], B=B[None], C=C) for of, by, C in kinds]
    return Certificate(
        observer="envelope",
        form="sampled",
        matrices=A[None],
        P=np.diag(WEIGHT ** np.arange(LOOKS)),
        rate=PACE,
        region={"error of a position [m]": (0.0, position), "acceleration [m/s2]": (0.0, acceleration)},
        assumptions=(
            f"The bounds are those of measurements every {dt:g} s; the decay is the same for any time step.",
            "An acceleration counts by its weighted mean over a step, which the worst one reaches.",
            "The times of the measurements are exact.",
        ),
        bounds=tuple(exact),
    )
