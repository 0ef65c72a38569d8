"""One step of a filter as FilterPy and Stone Soup do it, on irregular time steps.

`filterpy(kind)` and `stonesoup(kind)` give what it is and work(), which predicts and corrects once. The kind
is our observer's where the library has it, with the model of the accuracy benchmark; else a Kalman filter
of constant acceleration. Jacobians are given, measurements made beforehand: the time is the library's.
"""

from __future__ import annotations

import datetime
import warnings
from collections.abc import Callable, Iterator
from itertools import count
from typing import Any

import numpy as np
from benchmarks.accuracy.peers_filterpy import Bicycle, jacobian, moved, noise, residual, selected, turned

Work = Callable[[], None]

I6, R = np.eye(6), np.diag([0.0025, 0.0025, 0.0025])  # [m2, m2, rad2]
ONCE, TWICE, SAME_AXIS = np.eye(6, k=2), np.eye(6, k=4), np.tile(np.eye(2), (3, 3))
GAINS = Bicycle()
FIRST = [0.0, 0.0, 8.0, 0.0, 0.0, 0.0]  # x, y, speed, acceleration, yaw, slip


def samples() -> Iterator[tuple[float, Any]]:
    """(dt [s], position and heading (3,)) for ever: straight on at 8 m/s, with noise of 5 cm and 0.05 rad."""
    rng = np.random.default_rng(2)
    dt, scatter = rng.uniform(0.08, 0.12, 1000), rng.normal(0.0, 0.05, (1000, 3))
    x = 0.0
    for k in count():
        x += 8.0 * dt[k % 1000]
        yield float(dt[k % 1000]), scatter[k % 1000] + np.array([x, 0.0, 0.0])


def accelerated(dt: float) -> tuple[Any, Any]:
    """Transition and noise (6, 6) over dt [s] at constant acceleration: x, y, their first two rates."""
    g = np.array([0.5 * dt * dt, 0.5 * dt * dt, dt, dt, 1.0, 1.0])
    return I6 + dt * ONCE + 0.5 * dt * dt * TWICE, np.outer(g, g) * SAME_AXIS


# ------------------------------------------------------------------ FilterPy


def filterpy(kind: str) -> tuple[str, Work]:
    """What it is, and one step of it."""
    makers = {"ekf": _filterpy_ekf, "ukf": _filterpy_ukf, "imm": _filterpy_imm}
    return makers.get(kind, _filterpy_kalman)(samples())


def _filterpy_kalman(given: Any) -> tuple[str, Work]:
    from filterpy.kalman import KalmanFilter

    f = KalmanFilter(dim_x=6, dim_z=2)
    f.H, f.R = I6[:2], R[:2, :2]

    def work() -> None:
        dt, z = next(given)
        F, Q = accelerated(dt)
        f.predict(F=F, Q=Q)
        f.update(z[:2, None])

    return "Kalman, constant acceleration", work


def _filterpy_ekf(given: Any) -> tuple[str, Work]:
    from filterpy.kalman import ExtendedKalmanFilter

    class Extended(ExtendedKalmanFilter):  # type: ignore[misc]
        def predict_x(self, u: float) -> None:
            self.x = moved(self.x, u, GAINS.l_r)

    f, H = Extended(dim_x=6, dim_z=3), selected(3)
    f.x, f.R = np.array(FIRST), R

    def work() -> None:
        dt, z = next(given)
        f.F, f.Q = jacobian(f.x, dt, GAINS.l_r), noise(dt, GAINS)
        f.predict(dt)
        f.update(z, lambda x: H, lambda x: H @ x, residual=residual)

    return "EKF, bicycle", work


def _filterpy_ukf(given: Any) -> tuple[str, Work]:
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    H, points = selected(3), MerweScaledSigmaPoints(6, alpha=0.1, beta=2.0, kappa=-3.0)
    f = UnscentedKalmanFilter(
        6, 3, 0.1, hx=lambda x: H @ x, fx=lambda x, dt: moved(x, dt, GAINS.l_r), points=points
    )
    f.x, f.R, f.residual_z = np.array(FIRST), R, residual

    def work() -> None:
        dt, z = next(given)
        f.Q = noise(dt, GAINS)
        f.predict(dt=dt)
        f.update(z)

    return "UKF, bicycle", work


def _filterpy_imm(given: Any) -> tuple[str, Work]:
    from filterpy.kalman import IMMEstimator, KalmanFilter

    class Turning(KalmanFilter):  # type: ignore[misc]
        def predict(self, u: Any = None) -> None:
            self.x, self.F = turned(self.x, self.dt)
            self.P = self.F @ self.P @ self.F.T + self.Q

    straight, turning = KalmanFilter(dim_x=5, dim_z=2), Turning(dim_x=5, dim_z=2)
    for f in (straight, turning):
        f.H, f.R, f.x = np.eye(2, 5), R[:2, :2], np.array([0.0, 0.0, 8.0, 0.0, 0.0])
    imm = IMMEstimator([straight, turning], [0.5, 0.5], np.array([[0.95, 0.05], [0.05, 0.95]]))

    def work() -> None:
        dt, z = next(given)
        F, Q = accelerated(dt)
        straight.F, straight.Q = F[:5, :5] * [1, 1, 1, 1, 0], Q[:5, :5]
        turning.dt, turning.Q = dt, Q[:5, :5]
        imm.predict()
        imm.update(z[:2])

    return "IMM, constant velocity and turn", work


# ------------------------------------------------------------------ Stone Soup


def stonesoup(kind: str) -> tuple[str, Work]:
    """What it is, and one step of it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        what, predictor, updater, state = _soup(kind)
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis

    given, n = samples(), updater.measurement_model.ndim_meas

    def work() -> None:
        nonlocal state
        dt, z = next(given)
        t = state.timestamp + datetime.timedelta(seconds=dt)
        seen = Detection(z[:n, None], timestamp=t, measurement_model=updater.measurement_model)
        state = updater.update(SingleHypothesis(predictor.predict(state, timestamp=t), seen))

    return what, work


def _soup(kind: str) -> Any:
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel as Combined
    from stonesoup.models.transition.linear import ConstantAcceleration
    from stonesoup.predictor import kalman as predictors
    from stonesoup.types.state import GaussianState
    from stonesoup.updater import kalman as updaters

    prefix = {"ekf": "Extended", "ukf": "Unscented"}.get(kind, "")
    if prefix:
        model, mapping, x = _soup_bicycle(), (0, 1, 4), FIRST
    else:
        model, mapping, x = Combined([ConstantAcceleration(1.0)] * 2), (0, 3), [0.0] * 6
    n = len(mapping)
    measured = LinearGaussian(ndim_state=6, mapping=mapping, noise_covar=R[:n, :n])
    return (
        f"{kind.upper()}, bicycle" if prefix else "Kalman, constant acceleration",
        getattr(predictors, f"{prefix}KalmanPredictor")(model),
        getattr(updaters, f"{prefix}KalmanUpdater")(measured),
        GaussianState(np.array(x)[:, None], I6, timestamp=datetime.datetime(2026, 1, 1)),
    )


def _soup_bicycle() -> Any:
    from stonesoup.models.base import TimeVariantModel
    from stonesoup.models.transition.nonlinear import GaussianTransitionModel
    from stonesoup.types.array import CovarianceMatrix, StateVector, StateVectors

    class Transition(GaussianTransitionModel, TimeVariantModel):  # type: ignore[misc]
        ndim_state = 6

        def function(self, state: Any, noise: Any = False, time_interval: Any = None, **_: Any) -> Any:
            dt, columns = time_interval.total_seconds(), np.asarray(state.state_vector, float).T
            after = [moved(x, dt, GAINS.l_r) for x in columns]
            return StateVector(after[0]) if len(after) == 1 else np.array(after).T.view(StateVectors)

        def jacobian(self, state: Any, time_interval: Any = None, **_: Any) -> Any:
            x = np.asarray(state.state_vector, float)[:, 0]
            return jacobian(x, time_interval.total_seconds(), GAINS.l_r)

        def covar(self, time_interval: Any = None, **_: Any) -> Any:
            return CovarianceMatrix(noise(time_interval.total_seconds(), GAINS))

    return Transition()
