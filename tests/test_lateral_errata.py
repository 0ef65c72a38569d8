"""What the page on lateral velocity says is wrong with the paper, computed anew and found on the page."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are, solve_discrete_are

from outrider import cars, lateral
from outrider.lateral import course, plant
from outrider.models.single_track import linear, sampled

pytestmark = pytest.mark.once

CAR = cars.load("b_class")
PAGE = (Path(__file__).parents[1] / "docs" / "lateral.md").read_text()
C = np.array([[0.0, 1.0]])
Q = np.diag([1000.0, 10.0])


def model(vx, dt=0.01):
    """A, B of eq. 11, and their exact step."""
    pairs = []
    for m in (linear(vx, CAR), sampled(linear(vx, CAR), dt)):
        pairs += [np.array([[m.a11, m.a12], [m.a21, m.a22]]), np.array([m.b1, m.b2])]
    return pairs


def gain(vx, dt=0.01):
    """L of the discrete Riccati equation, by SciPy."""
    F = model(vx, dt)[2]
    P = solve_discrete_are(F.T, C.T, Q, [[1.0]])
    return (F @ P @ C.T / (C @ P @ C.T + 1.0))[:, 0]


def radius(M):
    return np.abs(np.linalg.eigvals(M)).max()


def on_page(text):
    return text in PAGE


def test_f1_the_continuous_equation_makes_an_unstable_observer():
    F = model(10.0)[2]
    L = solve_continuous_are(F.T, C.T, Q, [[1.0]]) @ C.T
    assert on_page(f"L = ({L[0, 0]:.0f}, {L[1, 0]:.1f})")
    assert radius(F - L @ C) == pytest.approx(3.28, abs=0.005)
    assert on_page("−3.28")


def test_f3_the_gain_depends_on_the_rate():
    for dt, rate in ((0.001, "1 kHz"), (0.01, "100 Hz"), (0.02, "50 Hz")):
        L = gain(10.0, dt)
        assert on_page(f"({L[0]:.3f}, {L[1]:.3f}) at {rate}")


def test_f4_the_yaw_rate_says_little():
    A, _, F, _ = model(10.0)
    assert on_page(f"A21 = {A[1, 0]:.3f}")
    assert on_page(f"{radius(F - np.outer(gain(10.0), C)):.4f} where the model alone has")
    assert on_page(f"has {np.linalg.eigvals(F).real.min():.4f}")


def test_f8_small_alpha_is_unstable():
    for used in (1.0, 0.0):
        limits = []
        for vx in (6.0, 10.0, 20.0):
            A, _, F, G = model(vx)
            closed = F - np.outer(gain(vx) * [used, 1.0], C)
            low, high = 10.0, 1000.0
            while high - low > 1e-3:
                alpha = 0.5 * (low + high)
                stable = radius(closed - np.outer(G, A[0]) / alpha) < 1.0
                low, high = (low, alpha) if stable else (alpha, high)
            limits.append(f"{high:.1f}")
        assert on_page(", ".join(limits))


@pytest.mark.parametrize("friction", [1.0, 0.5])
def test_f5_without_the_gain_on_vy_noise_stays_out(friction):
    scheduled = lateral.get("scheduled")
    for noise, better in (("paper", True), ("none", False)):
        drive = plant.simulate(course.winding(5, length=1500.0), CAR, friction, noise, seed=5)
        error = {}
        for share in (0.0, 1.0):
            gains = lateral.gains_from(scheduled, {"share": share})
            track = lateral.estimate(scheduled, drive.samples(CAR), CAR, gains)
            error[share] = np.sqrt(np.mean((track.estimate[:, 0] - drive.vy) ** 2))
        if better:
            assert error[0.0] < 0.85 * error[1.0]
        else:
            assert error[0.0] < 1.05 * error[1.0]
