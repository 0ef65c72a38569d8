"""How long something took, over days: a histogram of fixed size."""

from __future__ import annotations

import math
from array import array

LEAST_S, STEP, BINS = 1e-5, 1.02, 1000  # 10 us to over an hour, each bin 2 % wider than the one before


class Latency:
    """Times [s]; quantiles are right within 2 %, memory stays the same."""

    def __init__(self) -> None:
        self._counts = array("q", [0]) * BINS
        self.count = 0
        self.largest = 0.0

    def add(self, seconds: float) -> None:
        """One more; less than 10 us counts as that."""
        k = math.ceil(math.log(max(seconds, LEAST_S) / LEAST_S) / math.log(STEP))
        self._counts[min(k, BINS - 1)] += 1
        self.count += 1
        self.largest = max(self.largest, seconds)

    def quantile(self, share: float) -> float | None:
        """The time that `share` of all took at most [s]; None where there were none."""
        if not self.count:
            return None
        seen, wanted = 0, math.ceil(share * self.count)
        for k, count in enumerate(self._counts):
            seen += count
            if seen >= wanted:
                return min(LEAST_S * STEP**k, self.largest)
        return self.largest

    def as_dict(self) -> dict[str, float | int | None]:
        """For the summary: how many, median, 99 % and largest [ms]."""
        ms = {"p50_ms": self.quantile(0.5), "p99_ms": self.quantile(0.99), "max_ms": self.quantile(1.0)}
        return {"n": self.count, **{k: None if v is None else round(1e3 * v, 3) for k, v in ms.items()}}
