"""Stone Soup's extended Kalman filter with its constant-turn and constant-acceleration models."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from math import inf
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from benchmarks.accuracy.peers import Start, from_velocity, samples, start
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantAcceleration
from stonesoup.models.transition.nonlinear import ConstantTurn
from stonesoup.predictor.kalman import ExtendedKalmanPredictor
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.updater.kalman import ExtendedKalmanUpdater

from outrider.compare import Estimate, Series
from outrider.records import Array

MANUAL = "Stone Soup 1.9, Dstl and contributors, tutorial 3: extended Kalman filter"
EPOCH = datetime(2000, 1, 1)


class Turn(NamedTuple):
    """Gains of the constant-turn model; state x, u, y, v, turn rate."""

    noise: float = 0.1  # of a position, beside what the measurement says of itself [m]
    acceleration: float = 1.0  # white acceleration [m2/s3]
    turn: float = 0.1  # white yaw acceleration [rad2/s3]


class Acceleration(NamedTuple):
    """Gains of the constant-acceleration model; state x, u, a, y, v, b."""

    noise: float = 0.1  # of a position, beside what the measurement says of itself [m]
    jerk: float = 3.0  # white jerk [m2/s5]


def _turn(gains: Turn, series: Series) -> Estimate:
    def begin(s: Start, r: float) -> tuple[list[float], list[float]]:
        q = 2.0 * r / s.dt**2 + 1.0
        return [s.p[0], s.v[0], s.p[1], s.v[1], 1e-6], [r, q, r, q, 0.1]

    model = ConstantTurn(np.array([gains.acceleration, gains.acceleration]), gains.turn)
    return _filtered(model, (0, 2), (0, 2, 1, 3), begin, gains.noise, series)


def _acceleration(gains: Acceleration, series: Series) -> Estimate:
    def begin(s: Start, r: float) -> tuple[list[float], list[float]]:
        q = 2.0 * r / s.dt**2 + 1.0
        return [s.p[0], s.v[0], 0.0, s.p[1], s.v[1], 0.0], [r, q, 9.0, r, q, 9.0]

    model = CombinedLinearGaussianTransitionModel([ConstantAcceleration(gains.jerk) for _ in "xy"])
    return _filtered(model, (0, 3), (0, 3, 1, 4), begin, gains.noise, series)


def _filtered(
    model: Any,
    seen: tuple[int, int],
    kept: tuple[int, ...],
    begin: Callable[[Start, float], tuple[list[float], list[float]]],
    noise: float,
    series: Series,
) -> Estimate:
    """Filter over a series; `seen`: the measured entries of the state, `kept`: x, y, u, v in it."""
    first, n = start(series), len(series.t)
    xs, Ps = np.full((n, 4), np.nan), np.full((n, 4, 4), np.nan)
    if first is None:
        return from_velocity(series, xs, Ps, 0.0)
    predictor, updater = ExtendedKalmanPredictor(model), ExtendedKalmanUpdater(None)
    x, variances = begin(first, noise**2 + 1e-4)
    stamp = EPOCH
    state: Any = GaussianState(np.array(x)[:, None], np.diag(variances), timestamp=stamp)
    xs[first.index], Ps[first.index] = _taken(state, kept)
    for k, dt, z, R in samples(series, first.index, noise, inf):
        stamp += timedelta(seconds=dt)
        try:
            state = predictor.predict(state, timestamp=stamp)
            if z is not None:
                sensor = LinearGaussian(len(x), seen, R)
                detection = Detection(z[:, None], timestamp=stamp, measurement_model=sensor)
                state = updater.update(SingleHypothesis(state, detection))
        except np.linalg.LinAlgError:  # numbers beyond bounds: the library stops here
            break
        xs[k], Ps[k] = _taken(state, kept)
    return from_velocity(series, xs, Ps, first.heading)


def _taken(state: Any, kept: tuple[int, ...]) -> tuple[Array, Array]:
    at = list(kept)
    x = np.asarray(state.state_vector, float).ravel()
    return x[at], np.asarray(state.covar, float)[np.ix_(at, at)]


turn = SimpleNamespace(Gains=Turn, reference=MANUAL, estimate=_turn)
acceleration = SimpleNamespace(Gains=Acceleration, reference=MANUAL, estimate=_acceleration)
