"""One step of a sampled observer: gains of a chain, doubt in a sample."""

from __future__ import annotations

from math import acos, cos, exp, expm1, pi, sin, sqrt

from outrider.kernel import kernel, wrap
from outrider.observers import Innovation, Measurement
from outrider.observers._measured import huber

LEAST_DT = 1e-9  # a shorter step is taken to be this long, where gains are divided by it [s]


@kernel
def chain_gains(L1: float, L2: float, L3: float, dt: float) -> tuple[float, float, float]:
    """Gains (l1 [-], l2 [1/s], l3 [1/s2]) of x+ = x- + l (y - x-_1) for x1' = x2, x2' = x3, x3' = 0.

    The poles over a step of dt [s] are exp(lambda dt), lambda those of the continuous observer: the roots of
    s^3 + L1 s^2 + L2 s + L3. With q = 1 - exp(lambda dt) and e1, e2, e3 the elementary symmetric functions of
    the three q: l1 = e1 - e2 + e3, l2 = (e2 - 3/2 e3) / dt, l3 = e3 / dt^2. No differences of near numbers.
    """
    d = max(dt, LEAST_DT)
    m = L1 / 3.0  # s = t - m:  t^3 + p t + r = 0
    p = L2 - L1 * m
    r = m * (2.0 * m * m - L2) + L3
    D = 0.25 * r * r + p * p * p / 27.0
    if D > 0.0:  # one real root and a pair
        A = (0.5 * abs(r) + sqrt(D)) ** (1.0 / 3.0)
        if r > 0.0:
            A = -A
        B = -p / (3.0 * A)
        q = -expm1((A + B - m) * d)
        sigma, half = (-0.5 * (A + B) - m) * d, 0.25 * sqrt(3.0) * (A - B) * d
        turned = 2.0 * exp(sigma) * sin(half) ** 2
        total, product = 2.0 * (turned - expm1(sigma)), expm1(sigma) ** 2 + 2.0 * turned
    else:
        R = sqrt(max(-p / 3.0, 0.0))
        third = acos(min(max(-0.5 * r / R**3, -1.0), 1.0)) / 3.0 if R > 1e-60 else 0.0
        q = -expm1((2.0 * R * cos(third) - m) * d)
        q2 = -expm1((2.0 * R * cos(third - 2.0 * pi / 3.0) - m) * d)
        q3 = -expm1((2.0 * R * cos(third + 2.0 * pi / 3.0) - m) * d)
        total, product = q2 + q3, q2 * q3
    e2, e3 = q * total + product, q * product
    return q + total - e2 + e3, (e2 - 1.5 * e3) / d, e3 / (d * d)


@kernel
def patient_huber(innovation: Innovation, k: float, run: float) -> tuple[float, float]:
    """Weight of an innovation, and how many in a row were limited; k [-] doubles with each of them.

    So one wild sample moves little, and a vehicle that is really elsewhere is found within a few samples.
    """
    w = huber(innovation, k * 2.0 ** min(run, 30.0) if run > 0.0 else k)
    return w, run + 1.0 if w < 1.0 else 0.0


@kernel
def heading_innovation(psi: float, y: Measurement, noise: float, k: float) -> tuple[float, float]:
    """Measured heading minus psi [rad], within k [-] deviations where k > 0, and its trust in (0, 1].

    Trust: noise^2 over noise^2 and the heading's own variance; noise [rad].
    """
    variance = noise * noise + y.heading_variance
    trust = noise * noise / variance if variance > 0.0 else 1.0
    e = wrap(y.heading - psi)
    most = k * sqrt(variance) if k > 0.0 else pi
    return min(max(e, -most), most), trust
