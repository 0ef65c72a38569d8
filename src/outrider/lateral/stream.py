"""Sample by sample, as the car drives: the same rules and the same figures as for a whole log."""

from __future__ import annotations

from math import isfinite, nan
from typing import Any, NamedTuple

from outrider.cars import Car
from outrider.lateral import LEAST_SPEED, LONGEST_GAP, Estimate, Estimator, Sample


class Memory(NamedTuple):
    """What is kept from one sample to the next; `FIRST` before there is any."""

    state: Any  # of the estimator, None before the first usable sample
    since: float  # time since the last sample that the state took [s]
    estimate: Estimate  # the last one; NaN before the first
    held: bool  # the last sample added nothing to it


FIRST = Memory(None, 0.0, Estimate(nan, nan, nan), True)


def advance(estimator: Estimator, memory: Memory, sample: Sample, car: Car, design: Any) -> Memory:
    """Memory after one more sample, `sample.dt` [s] after the last whether that was usable or not.

    design: `estimator.prepare(car, gains, dt)`, once. A sample that is slower than LEAST_SPEED or lacks
    anything but ay leaves the estimate; after LONGEST_GAP without one the estimator starts anew.
    """
    timed = isfinite(sample.dt) and sample.dt > 0.0
    since = memory.since + sample.dt if timed else memory.since
    whole = isfinite(sample.vx) and isfinite(sample.yaw_rate) and isfinite(sample.steering)
    good = whole and (timed or memory.state is None)
    moving = good and abs(sample.vx) >= LEAST_SPEED
    still = getattr(estimator, "still", None)
    if not moving and (still is None or not good):
        return memory._replace(since=since, held=True)
    now = sample._replace(dt=since)
    if memory.state is None or (moving and since > LONGEST_GAP):
        state = estimator.start(now, car, design)
    elif moving:
        state = estimator.step(memory.state, now, car, design)
    else:
        state = still(memory.state, now, car, design)  # type: ignore[misc]
    said = estimator.output(state, now, car, design) if moving else memory.estimate
    return Memory(state, 0.0, said, not moving)
