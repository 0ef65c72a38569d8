"""The path of a bicycle without measurements: fading acceleration, braking to a stop, the arc of a circle."""

from __future__ import annotations

from math import cos, exp, log1p, sin

from outrider.kernel import kernel, wrap
from outrider.observers import Motion


@kernel
def fade(t: float, T: float) -> tuple[float, float, float]:
    """What acceleration, speed and way become, t [s] after an acceleration of 1 that fades with T [s].

    T = 0: it stays. Singer 1970.
    """
    if not T > 0.0:
        return 1.0, t, 0.5 * t * t
    a, r = exp(-t / T), t / T
    if r < 0.01:  # without cancellation
        v = t * (1.0 - r / 2.0 * (1.0 - r / 3.0 * (1.0 - r / 4.0)))
        return a, v, 0.5 * t * t * (1.0 - r / 3.0 * (1.0 - r / 4.0 * (1.0 - r / 5.0)))
    v = T * (1.0 - a)
    return a, v, T * (t - v)


@kernel
def travel(V: float, A: float, t: float, T: float) -> tuple[float, float, float]:
    """Way [m], speed and acceleration after t [s] of `fade`; what brakes stops, and does not roll back."""
    a, v, d = fade(t, T)
    if V * A < 0.0 and abs(V) <= abs(A) * v:
        t = -T * log1p(V / (A * T)) if T > 0.0 else -V / A
        return V * t + A * fade(t, T)[2], 0.0, 0.0
    return V * t + A * d, V + A * v, A * a


@kernel
def chord(way: float, chi: float, curvature: float) -> tuple[float, float, float]:
    """Displacement (x, y) [m] and turn [rad] after `way` [m] on a circle, from the course chi [rad]."""
    half = 0.5 * way * curvature
    length = way * (sin(half) / half if abs(half) > 1e-4 else 1.0 - half * half / 6.0)
    return length * cos(chi + half), length * sin(chi + half), 2.0 * half


@kernel
def told(x: float, y: float, V: float, A: float, psi: float, beta: float, l_r: float) -> Motion:
    """State of a bicycle in common terms; yaw rate V sin(beta) / l_r."""
    return Motion(x, y, V, A, wrap(psi + beta), wrap(psi), beta, V * sin(beta) / l_r)
