"""FilterPy 2 as its manual has it: extended and unscented filter of the bicycle, and an IMM of two models."""

from __future__ import annotations

from math import cos, hypot, inf, sin
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from benchmarks.accuracy.peers import Start, from_velocity, halves, samples, start
from filterpy.kalman import (
    ExtendedKalmanFilter,
    IMMEstimator,
    KalmanFilter,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
)

from outrider.compare import Estimate, Series
from outrider.geometry import wrap
from outrider.records import Array

MANUAL = "R. Labbe, FilterPy 2.0, and Kalman and Bayesian Filters in Python"
X, Y, V, A, PSI, BETA = range(6)


class Bicycle(NamedTuple):
    """Noise of the bicycle model and its measurement."""

    noise: float = 0.1  # of a position, beside what the measurement says of itself [m]
    jerk: float = 3.0  # white jerk [m/s3 sqrt(s)]
    slip: float = 0.1  # random walk of the slip [rad/sqrt(s)]
    yaw: float = 0.1  # random walk of the yaw [rad/sqrt(s)]
    heading_noise: float = 0.05  # of a heading, beside what the measurement says of itself [rad]
    l_r: float = 2.0  # body centre to rear axle [m]


# ------------------------------------------------------------------ the bicycle


def moved(x: Array, dt: float, l_r: float) -> Array:
    """State (6,) after dt [s] at constant acceleration and slip, the chord along the mean course."""
    way = x[V] * dt + 0.5 * x[A] * dt * dt
    turn = way * sin(x[BETA]) / l_r
    chi = x[PSI] + x[BETA] + 0.5 * turn
    return np.array(
        [x[X] + way * cos(chi), x[Y] + way * sin(chi), x[V] + x[A] * dt, x[A], x[PSI] + turn, x[BETA]]
    )


def jacobian(x: Array, dt: float, l_r: float) -> Array:
    """Derivative (6, 6) of `moved`."""
    way = x[V] * dt + 0.5 * x[A] * dt * dt
    k, dk = sin(x[BETA]) / l_r, cos(x[BETA]) / l_r
    chi = x[PSI] + x[BETA] + 0.5 * way * k
    c, s = cos(chi), sin(chi)
    along = np.array([0.0, 0.0, dt, 0.5 * dt * dt, 0.0, 0.0])
    turned = along * k
    turned[BETA] = way * dk
    course = 0.5 * turned
    course[[PSI, BETA]] += 1.0
    F = np.eye(6)
    F[X] += c * along - way * s * course
    F[Y] += s * along + way * c * course
    F[V, A] = dt
    F[PSI] += turned
    return F


def noise(dt: float, gains: Bicycle) -> Array:
    """Covariance (6, 6) that dt [s] adds."""
    Q = np.zeros((6, 6))
    Q[V : A + 1, V : A + 1] = gains.jerk**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    Q[PSI, PSI], Q[BETA, BETA] = gains.yaw**2 * dt, gains.slip**2 * dt
    return Q


def begin(s: Start, gains: Bicycle) -> tuple[Array, Array]:
    """State and covariance from two samples."""
    way = np.array([cos(s.heading), sin(s.heading)])
    x = np.array([*s.p, float(s.v @ way), 0.0, s.heading, 0.0])
    r = gains.noise**2 + 1e-4
    slow = hypot(*s.v) * s.dt < 3.0 * r**0.5
    return x, np.diag([r, r, 2.0 * r / s.dt**2 + 1.0, 9.0, 1.0 if slow else 0.1, 0.04])


def selected(n: int) -> Array:
    """H (n, 6): position, and heading where n = 3."""
    return np.eye(6)[[X, Y, PSI][:n]]


def residual(a: Array, b: Array) -> Array:
    """a - b, the heading wrapped."""
    e = np.subtract(a, b)
    e[2:] = wrap(e[2:])
    return e


def told(series: Series, x: Array, P: Array, l_r: float) -> Estimate:
    """Estimate from states (n, 6) and covariances (n, 6, 6)."""
    chi = x[:, PSI] + x[:, BETA]
    c, s = np.cos(chi), np.sin(chi)
    rate = x[:, V] * np.sin(x[:, BETA]) / l_r
    motion = np.column_stack(
        [x[:, X], x[:, Y], x[:, V], x[:, A], wrap(chi), wrap(x[:, PSI]), x[:, BETA], rate]
    )
    G = np.zeros((len(x), 4, 6))
    G[:, 0, X] = G[:, 1, Y] = 1.0
    G[:, 2, V], G[:, 3, V] = c, s
    for angle in (PSI, BETA):
        G[:, 2, angle], G[:, 3, angle] = -x[:, V] * s, x[:, V] * c
    return Estimate(motion, halves(G @ P @ G.transpose(0, 2, 1)))


class _Extended(ExtendedKalmanFilter):  # type: ignore[misc]
    """Predicts the state with the nonlinear model, as the manual says."""

    def predict_x(self, u: Any = 0) -> None:
        self.x = moved(self.x, self.dt, self.l_r)


def _ekf(gains: Bicycle, series: Series) -> Estimate:
    first, n = start(series), len(series.t)
    xs, Ps = np.full((n, 6), np.nan), np.full((n, 6, 6), np.nan)
    if first is not None:
        f = _Extended(6, 2)
        f.l_r = gains.l_r
        f.x, f.P = begin(first, gains)
        xs[first.index], Ps[first.index] = f.x, f.P
        for k, dt, z, R in samples(series, first.index, gains.noise, gains.heading_noise):
            f.dt, f.F, f.Q = dt, jacobian(f.x, dt, gains.l_r), noise(dt, gains)
            f.predict()
            if z is not None:
                H = selected(len(z))
                f.update(z, lambda x, H=H: H, lambda x, H=H: H @ x, R=R, residual=residual)
            xs[k], Ps[k] = f.x, f.P
    return told(series, xs, Ps, gains.l_r)


def _ukf(gains: Bicycle, series: Series) -> Estimate:
    first, n = start(series), len(series.t)
    xs, Ps = np.full((n, 6), np.nan), np.full((n, 6, 6), np.nan)
    if first is not None:
        points = MerweScaledSigmaPoints(6, alpha=0.1, beta=2.0, kappa=-3.0)
        f = UnscentedKalmanFilter(
            6, 2, 0.1, hx=None, fx=lambda x, dt: moved(x, dt, gains.l_r), points=points, residual_z=residual
        )
        f.x, f.P = begin(first, gains)
        xs[first.index], Ps[first.index] = f.x, f.P
        for k, dt, z, R in samples(series, first.index, gains.noise, gains.heading_noise):
            f.Q = noise(dt, gains)
            try:
                f.predict(dt)
                if z is not None:
                    near = z.copy()
                    near[2:] = f.x[PSI] + wrap(z[2:] - f.x[PSI])
                    H = selected(len(z))
                    f.update(near, R=R, hx=lambda x, H=H: H @ x)
            except np.linalg.LinAlgError:  # the covariance is no longer positive: the library stops here
                break
            xs[k], Ps[k] = f.x, f.P
    return told(series, xs, Ps, gains.l_r)


# ------------------------------------------------------------------ interacting models


class Interacting(NamedTuple):
    """Noise of constant velocity and of constant turn rate, and how often they change."""

    noise: float = 0.1  # of a position, beside what the measurement says of itself [m]
    straight: float = 1.0  # white acceleration of the first [m/s2 sqrt(s)]
    turning: float = 1.0  # of the second [m/s2 sqrt(s)]
    turn: float = 0.5  # white yaw acceleration of the second [rad/s2 sqrt(s)]
    stay: float = 0.05  # probability of a change of model from sample to sample [-]


class _Turning(KalmanFilter):  # type: ignore[misc]
    """Constant turn rate; state x, y, u, v, turn rate. F is the derivative, the state moves on its arc."""

    def predict(self, u: Any = None, **rest: Any) -> None:
        x, dt = self.x, self.dt
        self.x, self.F = turned(x, dt)
        self.P = self.F @ self.P @ self.F.T + self.Q


def turned(s: Array, dt: float) -> tuple[Array, Array]:
    """State (5,) after dt [s] on an arc, and its derivative (5, 5)."""
    x, y, u, v, w = s
    a = w * dt
    c, sn = cos(a), sin(a)
    if abs(a) > 1e-4:
        p, q = sn / w, (1.0 - c) / w
        dp, dq = (dt * c - p) / w, (dt * sn - q) / w
    else:
        p, q, dp, dq = dt, 0.5 * w * dt * dt, -w * dt**3 / 3.0, 0.5 * dt * dt
    F = np.eye(5)
    F[:2, 2:4] = [[p, -q], [q, p]]
    F[2:4, 2:4] = [[c, -sn], [sn, c]]
    F[:4, 4] = [dp * u - dq * v, dq * u + dp * v, -dt * (sn * u + c * v), dt * (c * u - sn * v)]
    moved = np.array([x + p * u - q * v, y + q * u + p * v, c * u - sn * v, sn * u + c * v, w])
    return moved, F


def _white(dt: float, q: float, turn: float) -> Array:
    """Covariance (5, 5) that dt [s] of white acceleration and yaw acceleration adds."""
    Q = np.zeros((5, 5))
    block = q**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    for i in (0, 1):
        Q[np.ix_([i, i + 2], [i, i + 2])] = block
    Q[4, 4] = turn**2 * dt
    return Q


def _imm(gains: Interacting, series: Series) -> Estimate:
    first, n = start(series), len(series.t)
    xs, Ps = np.full((n, 4), np.nan), np.full((n, 4, 4), np.nan)
    heading = 0.0
    if first is not None:
        heading = first.heading
        r = gains.noise**2 + 1e-4
        filters = [KalmanFilter(5, 2), _Turning(5, 2)]
        for f in filters:
            f.x = np.array([*first.p, *first.v, 0.0])
            f.P = np.diag([r, r, *2 * [2.0 * r / first.dt**2 + 1.0], 0.1])
            f.H = np.eye(2, 5)
        change = gains.stay
        imm = IMMEstimator(filters, [0.5, 0.5], np.array([[1.0 - change, change], [change, 1.0 - change]]))
        xs[first.index], Ps[first.index] = imm.x[:4], imm.P[:4, :4]
        for k, dt, z, R in samples(series, first.index, gains.noise, inf):
            filters[0].F = np.eye(5)
            filters[0].F[[0, 1], [2, 3]] = dt
            filters[0].F[4, 4] = 0.0
            filters[0].Q, filters[1].Q = (
                _white(dt, gains.straight, 0.1),
                _white(dt, gains.turning, gains.turn),
            )
            filters[1].dt = dt
            imm.predict()
            if z is not None:
                for f in filters:
                    f.R = R
                imm.update(z)
            xs[k], Ps[k] = imm.x[:4], imm.P[:4, :4]
    return from_velocity(series, xs, Ps, heading)


ekf = SimpleNamespace(Gains=Bicycle, reference=MANUAL, estimate=_ekf)
ukf = SimpleNamespace(Gains=Bicycle, reference=MANUAL, estimate=_ukf)
imm = SimpleNamespace(Gains=Interacting, reference=MANUAL, estimate=_imm)
