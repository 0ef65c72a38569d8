"""python -m benchmarks.soak: a day of scans with faults; keeps figures in benchmarks/results/soak.json."""

from __future__ import annotations

import argparse
import json
import math
import platform
import sys
import time
from collections.abc import Iterator
from itertools import cycle
from pathlib import Path
from typing import Any

from benchmarks.soak.ride import FAULTS, GOOD_S, LIDARS, Ride
from benchmarks.soak.watch import GROWTH, WITHIN_S, Memory, Recoveries, Watch

from outrider.live.engine import Live
from outrider.records import Turn
from outrider.settings import Settings

DAY = 864_000  # scans at 10 Hz
LOOK = 6_000  # scans between two looks at memory: ten minutes
EACH = 36_000  # scans of one lidar before another is plugged in: an hour
RESULTS = Path(__file__).resolve().parents[1] / "results" / "soak.json"


class Nothing:
    """A source that is not asked: events are handed over by hand."""

    about: dict[str, Any] = {"sensor": "emulated", "counts": {}}  # noqa: RUF012
    finished = False

    def start(self, put: Any) -> None:
        """Nothing."""

    def stop(self) -> None:
        """Nothing."""


def soak(scans: int, wall_s: float = math.inf, look: int = LOOK) -> Iterator[dict[str, Any]]:
    """So many scans, or as many as fit into `wall_s` of the clock on the wall; the figures so far, at each
    look at memory and at the end.
    """
    ride, watch, recoveries, memory = Ride(), Watch(), Recoveries(), Memory(look)
    live = Live(Nothing(), [watch], Settings())
    live.warm()
    begun, cpu, swaps = time.monotonic(), time.process_time(), 0
    kinds = cycle(FAULTS)
    while watch.scans < scans and time.monotonic() - begun < wall_s:
        if watch.scans >= (swaps + 1) * min(EACH, scans // len(LIDARS)):
            swaps += 1
            kind, lasting = "another lidar", ride.plug(ride.lidars[swaps % len(LIDARS)])
        else:
            fault = next(kinds)
            kind, lasting = fault.__name__.replace("_", " "), fault(ride)
        for turns in lasting:
            hand(turns, live)
        good, well = ride.host, None
        while ride.host - good < GOOD_S:
            hand(ride.step(), live)
            if well is None and watch.well > good:
                well = watch.well - good
        recoveries.add(kind, well)
        if memory.look(watch.scans) or watch.scans >= scans or time.monotonic() - begun >= wall_s:
            wall, used = time.monotonic() - begun, time.process_time() - cpu
            yield {
                "scans": watch.scans,
                "hours": round(ride.t / 3600.0, 2),
                "wall_s": round(wall, 1),
                "cpu_s": round(used, 1),
                "cpu_ms_a_scan": round(1e3 * used / watch.scans, 2),
                "python": platform.python_version(),
                "machine": platform.machine(),
                "memory": memory.as_dict(),
                "recovery": recoveries.as_dict(),
                "watched": watch.as_dict(),
                "decoded": ride.counts,
            }


def hand(turns: list[Turn], live: Live) -> None:
    """Each turn through tracker and alert."""
    for turn in turns:
        live.take(turn)


def failures(figures: dict[str, Any]) -> list[str]:
    """What a soak has shown that must not be, in words."""
    missed = figures["recovery"]["missed"].items()
    wrong = [f"not well within {WITHIN_S:g} s after: {kind}, {times} times" for kind, times in missed]
    if abs(figures["memory"]["growth"]) > GROWTH:
        wrong.append(f"memory has changed by {100.0 * figures['memory']['growth']:.1f} %")
    if figures["watched"]["backward"]:
        wrong.append(f"{figures['watched']['backward']} scans were not later than the one before")
    return wrong


def main() -> int:
    """Parse, ride, keep; 1 where something was not as it must be."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__)
    parser.add_argument("--scans", type=int, default=DAY, help="how many; a day at 10 Hz unless told")
    parser.add_argument("--minutes", type=float, default=math.inf, help="no longer than that on the wall")
    parser.add_argument("--results", type=Path, default=RESULTS)
    given = parser.parse_args()
    wrong: list[str] = []
    for figures in soak(given.scans, 60.0 * given.minutes):
        wrong = failures(figures)
        given.results.write_text(json.dumps(figures | {"failures": wrong}, indent=1) + "\n")
        memory = figures["memory"]["last_mb"]
        print(f"{figures['scans']:7} scans, {memory:.1f} MB, {figures['wall_s']:.0f} s", *wrong, flush=True)
    print("\n".join(wrong) or "as it must be")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
