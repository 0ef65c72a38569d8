"""One step of a filter as FilterPy and Stone Soup do it: irregular time steps, a measured position each.

`filterpy(kind)` and `stonesoup(kind)` give work(), which predicts and corrects once. The kind is that of our
observer where the library has it with the same model; else a constant-acceleration Kalman filter. Models are
written as fast as plain Python allows, Jacobians are given, so that the library's own cost is what is seen.
"""

from __future__ import annotations

import datetime
import warnings
from collections.abc import Callable
from itertools import count
from math import cos, sin
from typing import Any

import numpy as np

Work = Callable[[], None]

I6, H6 = np.eye(6), np.eye(2, 6)  # position first
ONCE, TWICE, SAME_AXIS = np.eye(6, k=2), np.eye(6, k=4), np.tile(np.eye(2), (3, 3))
R = 0.0025 * np.eye(2)  # [m2]
RATES = np.diag([1e-4, 1e-4, 1e-3, 1e-3, 1.0, 1.0])  # process noise of the bicycle, per second
L_R = 2.0  # body centre to rear axle [m]
BICYCLE = [0.0, 0.0, 0.0, 0.0, 8.0, 0.0]  # x, y, yaw, slip, speed, acceleration


def bicycle(x: Any, dt: float) -> Any:
    """State (6,) after dt [s]."""
    px, py, psi, beta, V, A = x
    chi = psi + beta
    turn = dt * V * sin(beta) / L_R
    return np.array([px + dt * V * cos(chi), py + dt * V * sin(chi), psi + turn, beta, V + dt * A, A])


def bicycle_jacobian(x: Any, dt: float) -> Any:
    """Derivative (6, 6) of `bicycle`."""
    _, _, psi, beta, V, _ = x
    c, s = dt * cos(psi + beta), dt * sin(psi + beta)
    F = I6.copy()
    F[0, 2] = F[0, 3] = -V * s
    F[1, 2] = F[1, 3] = V * c
    F[0, 4], F[1, 4], F[4, 5] = c, s, dt
    F[2, 3], F[2, 4] = dt * V * cos(beta) / L_R, dt * sin(beta) / L_R
    return F


def acceleration_model(dt: float) -> tuple[Any, Any]:
    """Transition and process noise (6, 6) of constant acceleration: x, y, their first and second rates."""
    F = I6 + dt * ONCE + 0.5 * dt * dt * TWICE
    g = np.array([0.5 * dt * dt, 0.5 * dt * dt, dt, dt, 1.0, 1.0])
    return F, np.outer(g, g) * SAME_AXIS


def velocity_model(dt: float, rate: float) -> tuple[Any, Any]:
    """Transition and process noise (6, 6) of a velocity that turns at `rate` [rad/s]; two states idle."""
    c, s = cos(rate * dt), sin(rate * dt)
    a, b = (s / rate, (1.0 - c) / rate) if rate else (dt, 0.0)
    F = I6.copy()
    F[:4, 2:4] = [[a, -b], [b, a], [c, -s], [s, c]]
    g = np.array([0.5 * dt * dt, 0.5 * dt * dt, dt, dt, 0.0, 0.0])
    return F, np.outer(g, g) * SAME_AXIS


def samples() -> Any:
    """(dt [s], position (2,)) for ever: straight on at 8 m/s, with noise of 5 cm."""
    rng = np.random.default_rng(2)
    dt, noise = rng.uniform(0.08, 0.12, 1000), rng.normal(0.0, 0.05, (1000, 2))
    x = 0.0
    for k in count():
        x += 8.0 * dt[k % 1000]
        yield float(dt[k % 1000]), noise[k % 1000] + np.array([x, 0.0])


# ------------------------------------------------------------------ FilterPy


def filterpy(kind: str) -> tuple[str, Work]:
    """What it is, and one step of it."""
    return _FILTERPY.get(kind, _filterpy_kalman)(samples())


def _filterpy_kalman(given: Any) -> tuple[str, Work]:
    from filterpy.kalman import KalmanFilter

    f = KalmanFilter(dim_x=6, dim_z=2)
    f.H, f.R = H6, R

    def work() -> None:
        dt, z = next(given)
        F, Q = acceleration_model(dt)
        f.predict(F=F, Q=Q)
        f.update(z[:, None])

    return "Kalman, constant acceleration", work


def _filterpy_ekf(given: Any) -> tuple[str, Work]:
    from filterpy.kalman import ExtendedKalmanFilter

    class Bicycle(ExtendedKalmanFilter):  # type: ignore[misc]
        def predict_x(self, u: float) -> None:
            self.x = bicycle(self.x, u)

    f = Bicycle(dim_x=6, dim_z=2)
    f.x, f.R = np.array(BICYCLE), R

    def work() -> None:
        dt, z = next(given)
        f.F, f.Q = bicycle_jacobian(f.x, dt), RATES * dt
        f.predict(dt)
        f.update(z, lambda x: H6, lambda x: x[:2])

    return "EKF, bicycle", work


def _filterpy_ukf(given: Any) -> tuple[str, Work]:
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    points = MerweScaledSigmaPoints(6, alpha=0.5, beta=2.0, kappa=0.0)
    f = UnscentedKalmanFilter(6, 2, 0.1, hx=lambda x: x[:2], fx=bicycle, points=points)
    f.x, f.R = np.array(BICYCLE), R

    def work() -> None:
        dt, z = next(given)
        f.Q = RATES * dt
        f.predict(dt=dt)
        f.update(z)

    return "UKF, bicycle", work


def _filterpy_imm(given: Any) -> tuple[str, Work]:
    from filterpy.kalman import IMMEstimator, KalmanFilter

    filters = [KalmanFilter(dim_x=6, dim_z=2) for _ in range(2)]
    for f in filters:
        f.H, f.R, f.x = H6, R, np.zeros((6, 1))
    f = IMMEstimator(filters, [0.5, 0.5], np.array([[0.95, 0.05], [0.05, 0.95]]))

    def work() -> None:
        dt, z = next(given)
        for one, rate in zip(filters, (0.0, 0.3), strict=True):
            one.F, one.Q = velocity_model(dt, rate)
        f.predict()
        f.update(z[:, None])

    return "IMM, constant velocity and turn", work


_FILTERPY: dict[str, Any] = {"ekf": _filterpy_ekf, "ukf": _filterpy_ukf, "imm": _filterpy_imm}


# ------------------------------------------------------------------ Stone Soup


def stonesoup(kind: str) -> tuple[str, Work]:
    """What it is, and one step of it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        what, predictor, updater, state = _soup(kind)
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis

    given = samples()

    def work() -> None:
        nonlocal state
        dt, z = next(given)
        t = state.timestamp + datetime.timedelta(seconds=dt)
        seen = Detection(z[:, None], timestamp=t, measurement_model=updater.measurement_model)
        state = updater.update(SingleHypothesis(predictor.predict(state, timestamp=t), seen))

    return what, work


def _soup(kind: str) -> Any:
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel as Combined
    from stonesoup.models.transition.linear import ConstantAcceleration
    from stonesoup.predictor import kalman as predictors
    from stonesoup.types.state import GaussianState
    from stonesoup.updater import kalman as updaters

    first = datetime.datetime(2026, 1, 1)
    by_kind = {"ekf": "Extended", "ukf": "Unscented"}
    prefix = by_kind.get(kind, "")
    if prefix:
        model, mapping, x = _soup_bicycle(), (0, 1), BICYCLE
    else:
        model, mapping, x = Combined([ConstantAcceleration(1.0)] * 2), (0, 3), [0.0] * 6
    measured = LinearGaussian(ndim_state=6, mapping=mapping, noise_covar=R)
    return (
        f"{kind.upper()}, bicycle" if prefix else "Kalman, constant acceleration",
        getattr(predictors, f"{prefix}KalmanPredictor")(model),
        getattr(updaters, f"{prefix}KalmanUpdater")(measured),
        GaussianState(np.array(x)[:, None], np.eye(6), timestamp=first),
    )


def _soup_bicycle() -> Any:
    from stonesoup.models.base import TimeVariantModel
    from stonesoup.models.transition.nonlinear import GaussianTransitionModel
    from stonesoup.types.array import CovarianceMatrix, StateVector

    class Bicycle(GaussianTransitionModel, TimeVariantModel):  # type: ignore[misc]
        ndim_state = 6

        def function(self, state: Any, noise: Any = False, time_interval: Any = None, **_: Any) -> Any:
            columns = np.asarray(state.state_vector, float).T
            moved = [bicycle(x, time_interval.total_seconds()) for x in columns]
            return (
                StateVector(moved[0]) if len(moved) == 1 else np.array(moved).T.view(type(state.state_vector))
            )

        def jacobian(self, state: Any, time_interval: Any = None, **_: Any) -> Any:
            x = np.asarray(state.state_vector, float)[:, 0]
            return bicycle_jacobian(x, time_interval.total_seconds())

        def covar(self, time_interval: Any = None, **_: Any) -> Any:
            return CovarianceMatrix(RATES * time_interval.total_seconds())

    return Bicycle()
