"""When each sample was taken, on the host's clock, though its bytes came late.

A lidar takes samples at even steps of time, and says so only by their order. Bytes come later than the
samples, by an amount that is never less than what the line needs, and often more: USB hands them over in
lumps, the host is busy. So received - number * period is never too low, and its lowest value within a while
is the offset between the two clocks: the lower envelope. Late bytes do not enter it, however late.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from outrider.records import Array, Ints

WINDOW_S = 1.0  # the lowest value within this: drift of the sensor's crystal follows that fast
GRAIN_S = 0.001  # of two values so near in time only the lower is kept


class BeamTime:
    """Numbers of samples to times; `delay`: from the last sample of a packet to its last byte [s]."""

    def __init__(self, period: float, delay: float) -> None:
        self.period = period  # between two samples [s]
        self._delay = delay
        self._lowest: deque[tuple[float, float]] = deque()  # (time of the sensor, offset), offsets grow

    def reset(self) -> None:
        """Forget the offset, as after a long silence."""
        self._lowest.clear()

    def arrived(self, number: int, received: float) -> None:
        """A packet ending with sample `number` is whole at `received` [s]."""
        t = number * self.period
        offset = received - t
        lowest = self._lowest
        while lowest and lowest[-1][1] >= offset:
            lowest.pop()
        if not lowest or t - lowest[-1][0] >= GRAIN_S:
            lowest.append((t, offset))
        while lowest[0][0] < t - WINDOW_S:
            lowest.popleft()

    def number(self, received: float) -> float | None:
        """Which sample ends a packet that is whole at `received` [s]; None before the first packet."""
        return (received - self._lowest[0][1]) / self.period if self._lowest else None

    def at(self, number: Ints) -> Array:
        """Times of samples (n,), clock of the host [s]; at least one packet must have arrived."""
        return number * np.float64(self.period) + (self._lowest[0][1] - self._delay)
