"""Whether a pose has become wrong, for instance because the robot was carried: told from its innovations."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

UNLIKELY = (0.0, 10.83, 13.82)  # chi2 of no, one, two ranges: one sample in 1000 of a right pose is above


class Gains(NamedTuple):
    """When it is told."""

    window: float = 1.0  # how long is looked back [s]
    least: float = 8.0  # samples with a range that this takes at least
    share: float = 0.7  # of them that must be unlikely [-]


def among(gains: Gains, strays: float) -> Gains:
    """The same where that share of ranges ends on something else: as many samples free of those."""
    clean = (1.0 - strays) ** 2
    return Gains(gains.window / clean, gains.least / clean, 1.0 - (1.0 - gains.share) * clean)


class Lost:
    """Watches an observer's innovations sample by sample.

    A wrong pose explains next to no sample for long, as the robot moves; an obstacle or a bad range spoils
    some. With the defaults one sample in five may be spoilt before a right pose is called wrong.
    """

    def __init__(self, gains: Gains | None = None) -> None:
        """Nothing seen yet."""
        self.gains = gains or Gains()
        self.reset()

    def reset(self) -> None:
        """Forget what was seen, as the pose is a new one."""
        self._seen: deque[tuple[float, bool]] = deque()
        self._age, self._bad = 0.0, 0

    def step(self, dt: float, distance: float, rays: int) -> bool:
        """Whether the pose is lost; dt [s] since the last sample.

        distance: squared innovation in standard deviations, as an observer's `distance`, over `rays` ranges;
        a sample without any says nothing.
        """
        self._age += dt if np.isfinite(dt) else 0.0
        if rays < 1:
            return False
        bad = not distance <= UNLIKELY[min(rays, 2)]
        self._seen.append((self._age, bad))
        self._bad += bad
        while len(self._seen) > self.gains.least and self._seen[0][0] < self._age - self.gains.window:
            self._bad -= self._seen.popleft()[1]
        full = len(self._seen) >= self.gains.least
        return full and self._bad >= self.gains.share * len(self._seen)
