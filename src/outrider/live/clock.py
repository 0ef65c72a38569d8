"""The clock of the host: seconds since the epoch that never jump; and how a recording's clock runs beside it.

It goes on while the host sleeps, so that a suspended host shows as a gap.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

_SLEEPING = getattr(
    time, "CLOCK_BOOTTIME", None
)  # Linux: counts on in suspend, as the monotonic clock does not
_ticks: Callable[[], float] = time.monotonic if _SLEEPING is None else partial(time.clock_gettime, _SLEEPING)
_EPOCH = time.time() - _ticks()


def now() -> float:
    """Time since the epoch as it was when the program began, plus what has passed since [s]."""
    return _EPOCH + _ticks()


@dataclass(slots=True)
class Pace:
    """How the clock of the beams runs against that of the host; as it is made: they are the same.

    A recording is played from `begin` on at `speed` times its own pace.
    """

    speed: float = 1.0
    host: float = 0.0  # clock of the host ... [s]
    beams: float = 0.0  # ... when the clock of the beams shows this [s]

    def begin(self, t: float) -> None:
        """From now on: the clock of the beams shows t."""
        self.host, self.beams = now(), t

    def to_host(self, t: float) -> float:
        """When, on the clock of the host, that of the beams shows t [s]."""
        return self.host + (t - self.beams) / self.speed

    def to_beams(self, host: float) -> float:
        """What the clock of the beams shows at a time of the host [s]."""
        return self.beams + (host - self.host) * self.speed
