"""What a bumpy ride does to bytes on their way, on request and repeatably."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

CUT = 3  # bytes that are left of a descriptor that was cut


def _seeded() -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(0))


@dataclass(slots=True)
class Faults:
    """What is wrong with the line now."""

    loss: float = 0.0  # share of the bytes that get lost
    garbage: int = 0  # bytes of noise that come before the next ones
    half: bool = False  # the next descriptor of a stream is cut, once
    silent: bool = False  # nothing gets through
    _random: np.random.Generator = field(default_factory=_seeded)

    def spoil(self, data: bytes) -> bytes:
        """What arrives of what was sent."""
        if self.silent:
            return b""
        if self.garbage:
            data, self.garbage = self.noise(self.garbage) + data, 0
        if self.loss:
            kept = self._random.random(len(data)) >= self.loss
            data = np.frombuffer(data, np.uint8)[kept].tobytes()
        return data

    def cut(self, descriptor: bytes) -> bytes:
        """The descriptor of a stream as it arrives."""
        if not self.half:
            return descriptor
        self.half = False
        return descriptor[:CUT]

    def noise(self, count: int) -> bytes:
        """So many bytes that mean nothing."""
        return self._random.bytes(count)
