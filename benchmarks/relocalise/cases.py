"""What is driven, who looks at it, and with which settings; tuning drives are never judged on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from outrider.relocalise import Array, particle, room
from outrider.relocalise.room import Room

TUNING, JUDGED = 100, 200  # seeds of the drives that are tuned and judged on
RUNS, TUNING_RUNS = 24, 8  # drives judged and tuned on
CLOUD_RUNS = {10.0: 12, 50.0: 4}  # judged with a particle filter, by rate
GUESS = np.array([0.25, 0.25, 0.2])  # standard deviations of where observers start, x, y [m], theta [rad]
CLOSE = (0.15, 0.1)  # success: within these of the truth or what looks the same [m, rad] ...
LAST = 2.0  # ... for so long at the end [s]


class Cell(NamedTuple):
    """A room, and how well and how often it is measured."""

    wall: str
    rate: float  # [Hz]
    sigma: float  # [m]
    runs: int = RUNS

    @property
    def room(self) -> Room:
        """The room as its sensors are here."""
        return room.load(self.wall)._replace(sigma=self.sigma)

    @property
    def label(self) -> str:
        """As a heading says it."""
        return f"{self.rate:.0f} Hz, {100.0 * self.sigma:.0f} cm"

    @property
    def window(self) -> float:
        """Over which range rates are measured [s]."""
        return 0.5 if self.sigma > 0.03 else 0.3


NOISE = tuple(Cell("ellipse", rate, sigma) for rate in (10.0, 50.0) for sigma in (0.01, 0.05))
ANYWHERE = (
    Cell("ellipse", 10.0, 0.01, 16),
    Cell("ellipse", 10.0, 0.05, 16),
    Cell("ellipse", 50.0, 0.02, 16),
    Cell("asymmetric", 10.0, 0.01, 12),
    Cell("asymmetric", 10.0, 0.05, 12),
    Cell("asymmetric", 50.0, 0.05, 12),
    Cell("rectangle", 10.0, 0.01, 16),
)


class Method(NamedTuple):
    """An observer, how it is told range rates, and between which gains its tuning may choose."""

    label: str
    observer: str
    rates: str = "none"  # exact, parabola, line, difference, none
    fixed: dict[str, float] = {}  # noqa: RUF012
    grid: dict[str, Array] = {}  # noqa: RUF012
    kappa: tuple[float, ...] = (0.0,)  # rates of the normalised form that are tried; 0: the gradient


GRADIENT = {"ks": np.logspace(-1.0, 3.0, 9), "ka": np.logspace(-3.0, 1.0, 9)}
NORMALISED = {"ks": np.array([1.0]), "ka": np.logspace(-2.5, 0.5, 5), "damping": np.logspace(-3.0, -0.5, 4)}
KAPPA = tuple(float(k) for k in np.logspace(-1.3, 1.2, 8))
PUBLISHED = {"feedforward": 0.0}
METHODS = (
    Method("published, true rates (no robot has them)", "wall_range", "exact", PUBLISHED, GRADIENT),
    Method("published, rates by a line", "wall_range", "line", PUBLISHED, GRADIENT),
    Method("published, rates by a parabola", "wall_range", "parabola", PUBLISHED, GRADIENT),
    Method("published, rates by difference", "wall_range", "difference", PUBLISHED, GRADIENT),
    Method("fed forward, true rates (no robot has them)", "wall_range", "exact", {}, GRADIENT),
    Method("fed forward, rates by a parabola", "wall_range", "parabola", {}, GRADIENT),
    Method("fed forward and normalised", "wall_range", "parabola", {}, NORMALISED, KAPPA),
    Method("fed forward, no rates (ka = 0)", "wall_range", "none", {}, {**GRADIENT, "ka": np.zeros(1)}),
    Method("`pose_ekf`", "pose_ekf"),
    Method("`pose_ekf`, odometry tuned", "pose_ekf", grid={"odometry": np.logspace(-3.0, -0.5, 11)}),
)

CLOUDS = (300, 1000, 5000)  # particles
WIDTHS = (0.02, 0.05, 0.1, 0.2, 0.3)  # of the likelihood, tried [m]
ODOMETRY = (0.02, 0.2)  # variance share, tried; the second is AMCL's
AMCL = particle.Gains(particles=5000.0, least=100.0, width=0.2)  # as it is published

BASIN = (  # label, observer, gains
    ("published 20, 20", "wall_range", {"ks": 20.0, "ka": 20.0, "feedforward": 0.0}),
    ("fed forward 20, 20", "wall_range", {"ks": 20.0, "ka": 20.0}),
    ("fed forward 5, 1", "wall_range", {"ks": 5.0, "ka": 1.0}),
    ("fed forward 1, 0.1", "wall_range", {"ks": 1.0, "ka": 0.1}),
    ("normalised, 5/s", "wall_range", {"ks": 1.0, "ka": 0.2, "kappa": 5.0}),
    ("fed forward 1, 0 (no rates)", "wall_range", {"ks": 1.0, "ka": 0.0}),
    ("fed forward 5, 0 (no rates)", "wall_range", {"ks": 5.0, "ka": 0.0}),
    ("`pose_ekf`, told 5 cm, no gate", "pose_ekf", {"range_floor": 0.05}),
    ("`pose_ekf`, told 30 cm, no gate", "pose_ekf", {"range_floor": 0.3}),
    ("`pose_ekf` as it comes", "pose_ekf", {}),
)
OPEN = {"gate": 1e6, "start_position": 1.5, "start_heading": 1.5}  # an EKF that is told nothing of its guess
BASE = np.array([1.6, -0.8, 0.3])  # where the base run starts, x, y [m], theta [rad]
OFF = np.array([0.3, -0.25, 0.3])  # of its guess
GUESSES, FAR = 300, 2.5  # number, and how far off at most [m]
STARTS, REPEATS = 6, 30  # of the comparison of motions
