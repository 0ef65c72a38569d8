"""Make every designed gain of the package anew, and every proof, and compare with what is shipped.

    python -m benchmarks.certificates.design_gains

Needs outrider[design]. Gains must agree within TOLERANCE (solvers differ in the last digits, and a gain is
shipped with four); shipped certificates must be proven by NumPy alone. Exit code 1 where they do not.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from math import radians

import numpy as np

from outrider import design, observers
from outrider.observers import high_gain, multi_stage

TOLERANCE = 0.01  # relative to the largest gain of its kind [-]


def speed() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Speed chain of multi_stage.DESIGNED: decay 1 /s, poles within 8 /s."""
    yield design.speed(1.0, 8.0).gain, np.array(multi_stage.DESIGNED[:4])


def table() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Orientation table of multi_stage.DESIGNED: decay 0.05 + 0.03 V, poles within 1 + V / 4, at speed V."""
    made = design.table(multi_stage.NOMINAL, (0.05, 0.03), (1.0, 0.25)).gain
    yield made[:, 0], np.array(multi_stage.OUR_PSI)
    yield made[:, 1], np.array(multi_stage.OUR_BETA)


def position() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Position observer of multi_stage.DESIGNED: decay 10 /s, pole within 20 /s."""
    yield design.position(10.0, 20.0).gain, multi_stage.DESIGNED.L_w * np.eye(2)


def high_gains() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """high_gain.DESIGNED: from 5 m/s, 3 m/s2 and 0.4 rad/s at most, decay 0.5 /s, poles within 8 /s."""
    made = design.high_gain(5.0, 3.0, 0.4, rate=0.5, fastest=8.0).gain
    yield made, np.array(high_gain.DESIGNED[:3])


def constant_velocity() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """constant_velocity's gain: 10 m/s, course within 36 deg, 0.5 rad/s, decay 1.5 /s, poles within 10 /s."""
    made = design.constant_velocity([10.0], radians(36.0), 0.5, rate=1.5, fastest=10.0).gain
    g = observers.get("constant_velocity").Gains()
    yield made, np.array([[g.L_x, 0.0], [0.0, g.L_y], [0.0, g.L_psi], [0.0, g.L_beta]])


SHIPPED: tuple[Callable[[], Iterator[tuple[np.ndarray, np.ndarray]]], ...] = (
    speed,
    table,
    position,
    high_gains,
    constant_velocity,
)


def compare(make: Callable[[], Iterator[tuple[np.ndarray, np.ndarray]]]) -> float:
    """Largest difference between designed anew and shipped, relative to the largest gain of its kind."""
    pairs = list(make())
    return max(float(np.abs(made - kept).max() / np.abs(kept).max()) for made, kept in pairs)


def main() -> int:
    """Print a line for each; 1 where something does not agree or is not proven."""
    wrong = 0
    for make in SHIPPED:
        off = compare(make)
        wrong += off > TOLERANCE
        print(f"{(make.__doc__ or '').strip():96} differs by {100.0 * off:.2f} %")
    for name in observers.names():
        certificate = observers.get(name).certificate()
        if certificate is not None:
            wrong += not certificate.proven()
            print(f"\n{certificate}")
    for gains in (multi_stage.Gains(), multi_stage.DESIGNED):
        anew = design.multi_stage(gains)
        print(f"\nsearched anew, table {gains.table:g}: margin {anew.margin():.1e}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
