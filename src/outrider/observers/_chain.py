"""Constant gains for a chain of three integrators, from poles in closed form: observer and smoother."""

from __future__ import annotations

from math import cos, exp, expm1, sqrt
from typing import Any, NamedTuple

from outrider.kernel import kernel


class Chain(NamedTuple):
    """Gains of one correction on offset, its rate and its second rate, each per step of the chain."""

    p: float
    v: float
    a: float


@kernel
def symmetric(d: float, shape: float) -> Any:
    """Elementary symmetric functions of the poles exp(-d), exp(-d (shape +- sqrt(shape^2 - 1)))."""
    real, w = exp(-d), sqrt(abs(shape * shape - 1.0))
    if shape < 1.0:
        both, product = 2.0 * exp(-d * shape) * cos(d * w), exp(-2.0 * d * shape)
    else:
        both, product = exp(-d * (shape - w)) + exp(-d * (shape + w)), exp(-2.0 * d * shape)
    return real + both, real * both + product, real * product


@kernel
def placed(d: float, shape: float, fade: float) -> Chain:
    """Gains that give (I - L H) F the poles of `symmetric`, F a triple integrator over a unit step.

    fade: the last component is multiplied by exp(-fade) meanwhile.
    """
    q1, q2, q3 = symmetric(d, shape)
    f, g, half = exp(-fade), 1.0, 0.5
    if fade > 1e-4:
        g = -expm1(-fade) / fade
        half = (1.0 - g) / fade
    p = 2.0 + f - q1  # gains of the predictor F L, by comparing coefficients
    a = (((f - q1) * f + q2) * f - q3) / (g * g)
    v = q2 - f - (1.0 + f) * (1.0 - p) - a * half
    a /= f
    v -= g * a
    return Chain(p - v - half * a, v, a)


@kernel
def impulse(p: float, v: float, a: float, d: float, shape: float) -> float:
    """Impulse on the last of three in the middle of a unit step that leaves them (p, v, a) off."""
    q1, q2, q3 = symmetric(d, shape)
    now, before, after = 1.0 - q3, 3.0 - q1, q2 - 3.0 * q3
    p, v = p - 0.5 * v + 0.125 * a, v - 0.5 * a  # driven back to the middle
    out: float = (before + after - 2.0 * now) * p + 0.5 * (after - before) * v + now * a
    return out
