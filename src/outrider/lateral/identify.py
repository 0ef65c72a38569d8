"""A car from logs of its own sensors: steering gain and offset, tyre stiffness and grip of each axle.

    m ay = Ff + Fr,  Iz r' = lf Ff - lr Fr          the forces of the axles, from ay and r'
    Ff = tyre(delta + offset - (vy + lf r) / vx)    what they should be, with the steering gain in delta
    Fr = tyre(-(vy - lr r) / vx)

Least squares over both. Lateral velocity is the integral of ay - vx r less a drift, which is straight from
second to second: as much of an unknown as the car itself, and expected to be no more than DRIFT allows.
A measured vy says the same integral once more, with an ERROR of its own.
Of lateral motion only stiffness and inertia over mass can be told, so the mass, the inertia and the lengths
are taken as given.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.cars import Car, checked
from outrider.errors import InputError
from outrider.lateral import LONGEST_GAP
from outrider.lateral.estimators._tyre import RESIDUAL, G
from outrider.lateral.log import Log

Array = npt.NDArray[np.float64]

CUTOFF = 2.0  # faster motion is left out, as is vibration [Hz]
EVERY = 0.1  # one row of the least squares [s]
SLOWEST = 5.0  # slower driving is left out [m/s]
SHORTEST = 5.0  # and so is a shorter stretch [s]
LEAST = 30.0  # less driving says nothing [s]
TURNING = 0.5  # nor does driving with less rms of ay [m/s2]
MISFIT = 0.3  # expected misfit of an axle's force, over the mass, with a memory of 1 s [m/s2]
ERROR = 0.2  # expected error of a measured vy, with a memory of 1 s [m/s]
DRIFT = 0.2  # of the integral of ay - vx r: a random walk [m/s/sqrt(s)]
KNOT = 1.0  # the drift is straight in between [s]
PRIOR = {  # what is found, and its standard deviation beforehand: of the logarithm; of the offset [rad]
    "front_stiffness": 1.0,
    "rear_stiffness": 1.0,
    "steering_gain": 1.0,
    "front_grip": 0.3,
    "rear_grip": 0.3,
    "steering_offset": 0.05,
}


class Identified(NamedTuple):
    """A car, and how well it is known."""

    car: Car
    spread: dict[str, float]  # standard deviation of what was found, in units of the car's field
    misfit: float  # rms of both axles' force over the mass, model against log [m/s2]
    seconds: float  # of driving that were used [s]
    most: float  # |ay| that was seen at most, slower than CUTOFF: beyond, the car is a guess [m/s2]


class Stretch(NamedTuple):
    """Driving without a gap, smoothed: columns (n,), a row every `EVERY` s."""

    t: Array  # [s]
    vx: Array  # [m/s]
    r: Array  # [rad/s]
    turn: Array  # r' [rad/s2]
    ay: Array  # freed of roll [m/s2]
    steering: Array  # as logged
    vy: Array | None  # as measured [m/s]
    drifting: Array  # the integral of ay - vx r [m/s]
    hats: Any  # (n, knots) sparse: its drift, in terms of the drift at the knots


def identify(logs: Sequence[Log], car: Car, *, use_vy: bool = True, roll: bool = False) -> Identified:
    """The car of these logs; mass, inertia, lengths of `car` are kept, the rest is where the search begins.

    use_vy: measured vy is used in the logs that have it; else yaw rate, ay, steering and speed alone. roll:
    the roll gain is found as well; a scale error of the yaw rate or speed looks the same. InputError where
    there is too little driving.
    """
    if roll:
        car = car._replace(roll_gain=_roll_gain(_stretches(logs, car._replace(roll_gain=0.0), use_vy)))
    parts = _stretches(logs, car, use_vy)
    seconds = sum(len(part.t) for part in parts) * EVERY
    ay = np.concatenate([part.ay for part in parts]) if parts else np.zeros(1)
    size = float(np.sqrt(np.mean(ay * ay)))
    if seconds < LEAST or size < TURNING:
        raise InputError(
            f"{seconds:.0f} s of driving above {SLOWEST:g} m/s with all sensors, ay {size:.2g} m/s2 rms; "
            f"want {LEAST:g} s and {TURNING:g} m/s2: more logs with corners"
        )
    found, spread, misfit = _solve(parts, car._replace(steering_gain=_steering_gain(parts, car)))
    return Identified(checked(found, "identified"), spread, misfit, seconds, float(np.abs(ay).max()))


# ------------------------------------------------------------------ least squares


def _solve(parts: Sequence[Stretch], first: Car) -> tuple[Car, dict[str, float], float]:
    """Car, its standard deviations, and the misfit: least squares over the car and all drifts at once."""
    from scipy.optimize import least_squares

    weight = np.sqrt(EVERY) / MISFIT  # rows closer than the misfit's memory of 1 s count for less
    cuts = np.cumsum([len(PRIOR), *(part.hats.shape[1] for part in parts)])

    def forces(x: Array) -> list[Array]:
        car = _car(x, first)
        drifts = (x[a:b] for a, b in pairwise(cuts))
        return [
            _forces(part, car, part.drifting - part.hats @ z) for part, z in zip(parts, drifts, strict=True)
        ]

    def residuals(x: Array) -> Array:
        rows = [weight * force for force in forces(x)]
        rows.append(x[: len(PRIOR)] / list(PRIOR.values()))
        for a, b in pairwise(cuts):
            rows.append(np.diff(x[a:b]) / (DRIFT * np.sqrt(KNOT)))
        for part, (a, b) in zip(parts, pairwise(cuts), strict=True):
            if part.vy is not None:
                rows.append(np.sqrt(EVERY) / ERROR * (part.drifting - part.hats @ x[a:b] - part.vy))
        return np.concatenate(rows)

    start = np.zeros(cuts[-1])
    for part, a, b in zip(parts, cuts[:-1], cuts[1:], strict=True):
        start[a:b] = np.interp(KNOT * np.arange(b - a), part.t - part.t[0], part.drifting)
    scale = np.concatenate([np.full(len(PRIOR), 0.1), np.full(cuts[-1] - len(PRIOR), 0.3)])
    done = least_squares(
        residuals, start, jac_sparsity=_pattern(parts), x_scale=scale, max_nfev=100, method="trf"
    )
    found = _car(done.x, first)
    misfit = float(np.sqrt(np.mean(np.concatenate(forces(done.x)) ** 2)))
    return found, _spread(done.jac, found), misfit


def _spread(jacobian: Any, found: Car) -> dict[str, float]:
    """Standard deviations of what was found, from the sparse Jacobian of the weighted residuals."""
    from scipy.sparse.linalg import splu

    normal = (jacobian.T @ jacobian).tocsc()
    known = np.sqrt(np.diag(splu(normal).solve(np.eye(normal.shape[0], len(PRIOR)))))
    units = (1.0 if name == "steering_offset" else getattr(found, name) for name in PRIOR)
    return {name: float(s * unit) for name, s, unit in zip(PRIOR, known, units, strict=True)}


def _pattern(parts: Sequence[Stretch]) -> Any:
    """Which residual depends on which unknown, sparse."""
    from scipy import sparse

    drifts = sparse.block_diag([sparse.vstack([part.hats, part.hats]) for part in parts])
    walks = sparse.block_diag([_neighbours(part.hats.shape[1]) for part in parts])
    car = np.concatenate([np.ones((drifts.shape[0], len(PRIOR))), np.eye(len(PRIOR))])
    middle = sparse.csr_array((len(PRIOR), drifts.shape[1]))
    seen = sparse.block_diag([part.hats[: 0 if part.vy is None else None] for part in parts])
    blank = np.zeros((walks.shape[0] + seen.shape[0], len(PRIOR)))
    return sparse.hstack([np.concatenate([car, blank]), sparse.vstack([drifts, middle, walks, seen])])


def _neighbours(n: int) -> Any:
    """(n - 1, n) sparse: row i touches i and i + 1."""
    from scipy import sparse

    one = sparse.eye_array(n, format="csr")
    return one[: max(n - 1, 0)] + one[1:]


def _car(x: Array, first: Car) -> Car:
    """Car of the unknowns: logarithms against `first`, the offset as it is."""
    values = dict(zip(PRIOR, x[: len(PRIOR)].tolist(), strict=True))
    offset = first.steering_offset + values.pop("steering_offset")
    grown = {name: getattr(first, name) * float(np.exp(value)) for name, value in values.items()}
    return first._replace(steering_offset=offset, **grown)


def _forces(part: Stretch, car: Car, vy: Array) -> Array:
    """Misfit of both axles' force over the mass (2n,), log less model [m/s2]; vy (n,) [m/s]."""
    base, pull = car.front + car.rear, car.inertia / car.mass * part.turn
    front = car.steering_gain * part.steering + car.steering_offset - (vy + car.front * part.r) / part.vx
    rear = -(vy - car.rear * part.r) / part.vx
    a = _axle(front, car.front_stiffness / car.mass, car.front_grip * G * car.rear / base)
    b = _axle(rear, car.rear_stiffness / car.mass, car.rear_grip * G * car.front / base)
    return np.concatenate([(car.rear * part.ay + pull) / base - a, (car.front * part.ay - pull) / base - b])


def _axle(slip: Array, stiffness: float, limit: float) -> Array:
    """The tyre of `estimators._tyre.axle`, for arrays."""
    made: Array = limit * np.tanh((1.0 - RESIDUAL) * stiffness * slip / limit) + RESIDUAL * stiffness * slip
    return made


# ------------------------------------------------------------------ the logs, smoothed


def _stretches(logs: Sequence[Log], car: Car, use_vy: bool) -> list[Stretch]:
    """All stretches of driving forward without a gap."""
    parts = []
    for log in logs:
        samples, measured = log.samples(car), log.vy if use_vy else None
        whole = np.isfinite(samples).all(axis=1) & (log.vx >= SLOWEST)
        if measured is not None:
            whole &= np.isfinite(measured)
        rows = np.flatnonzero(whole)
        rows = rows[np.diff(log.t[rows], prepend=-np.inf) > 0.0]
        for run in np.split(rows, np.flatnonzero(np.diff(log.t[rows]) > LONGEST_GAP) + 1):
            if len(run) > 1 and log.t[run[-1]] - log.t[run[0]] >= SHORTEST:
                vy = None if measured is None else measured[run]
                parts.append(_stretch(log.t[run], samples[run, 1:4].T, log.steering[run], vy))
    return parts


def _stretch(t: Array, sensors: Array, steering: Array, vy: Array | None) -> Stretch:
    """One stretch on an even grid, smoothed without delay; sensors (3, n): vx, yaw rate, ay."""
    from scipy import sparse
    from scipy.signal import butter, sosfiltfilt

    step = float(np.clip(np.median(np.diff(t)), 1e-3, 0.5 * EVERY))
    every = max(round(EVERY / step), 1)
    grid = np.arange(t[0], t[-1], EVERY / every)
    vx, r, ay, wheel = (np.interp(grid, t, row) for row in (*sensors, steering))
    rate = ay - vx * r
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) * EVERY / every
    low = butter(2, CUTOFF, fs=every / EVERY, output="sos")

    def smooth(values: Array) -> Array:
        made: Array = sosfiltfilt(low, values)[::every]
        return made

    turn = np.gradient(r, EVERY / every)
    seen = None if vy is None else smooth(np.interp(grid, t, vy))
    place = (grid[::every] - grid[0]) / KNOT
    left, n = place.astype(int), len(place)
    share, at = place - left, np.arange(n)
    values, columns = np.concatenate([1.0 - share, share]), np.concatenate([left, left + 1])
    hats = sparse.csr_array((values, (np.concatenate([at, at]), columns)), shape=(n, int(left[-1]) + 2))
    vx, r, turn, ay, wheel = (smooth(row) for row in (vx, r, turn, ay, wheel))
    return Stretch(grid[::every], vx, r, turn, ay, wheel, seen, smooth(travelled), hats)


def _steering_gain(parts: Sequence[Stretch], car: Car) -> float:
    """A first guess: what the wheelbase asks for, over what was logged, where the car turns gently."""
    wheel = np.concatenate([part.steering for part in parts])
    curve = np.concatenate([part.r / part.vx for part in parts]) * (car.front + car.rear)
    wheel, curve = wheel - np.median(wheel), curve - np.median(curve)
    gain = float(wheel @ curve) / max(float(wheel @ wheel), 1e-12)
    if not gain > 1e-3:
        raise InputError(
            f"steering and yaw rate do not go together (gain {gain:.2g}); want steering positive to the left"
        )
    return gain


def _roll_gain(parts: Sequence[Stretch]) -> float:
    """Roll over ay [rad s2/m]: how much more the sensor reads than vy' + vx r, by least squares."""
    true = [part.vx * part.r + (0.0 if part.vy is None else np.gradient(part.vy, EVERY)) for part in parts]
    x, y = np.concatenate(true), np.concatenate([part.ay for part in parts])
    return (float(x @ y) / max(float(x @ x), 1e-12) - 1.0) / G
