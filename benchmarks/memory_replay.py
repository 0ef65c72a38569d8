"""Whether memory stays flat: the demo's scans again and again, stamps running on; a line a minute of data.

python benchmarks/memory_replay.py 60 [--write]
"""

import argparse
import dataclasses
import os
import tempfile
import time
from pathlib import Path

from outrider import offline, simulate

PERIOD_NS = 100_000_000


def replay(minutes):
    """Messages of the demo scenario again and again, for `minutes` of data; each lap starts anew."""
    messages = list(simulate.record(simulate.load("demo")))
    lap = messages[-1].received_ns - messages[0].received_ns + PERIOD_NS
    for k in range(round(minutes * 60e9 / lap) + 1):
        for m in messages:
            shift = k * lap
            if m.received_ns - messages[0].received_ns + shift > minutes * 60e9:
                return
            yield dataclasses.replace(m, stamp_ns=m.stamp_ns + shift, received_ns=m.received_ns + shift)


def resident_mb():
    """Memory of this process that is in RAM [MB]; Linux."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


class Watch:
    """Prints minute of data, RSS, tracks now, highest identity, and scans a second of CPU."""

    def __init__(self):
        self.start, self.minute, self.scans, self.cpu = None, 0, 0, time.process_time()
        print(f"{'minute':>6}{'RSS MB':>9}{'tracks':>8}{'last id':>9}{'scans/CPU s':>13}")

    def __call__(self, frame):
        self.start = frame.t if self.start is None else self.start
        self.scans += 1
        if frame.t - self.start >= 60.0 * self.minute:
            rate = self.scans / max(time.process_time() - self.cpu, 1e-9)
            ids = frame.tracks.id
            newest = ids[-1] if len(ids) else 0
            print(f"{self.minute:6}{resident_mb():9.1f}{len(ids):8}{newest:9}{rate:13.0f}", flush=True)
            self.minute, self.scans, self.cpu = self.minute + 1, 0, time.process_time()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("minutes", type=float, nargs="?", default=10.0)
    parser.add_argument(
        "--write", action="store_true", help="write a run folder as well, as `outrider track` does"
    )
    options = parser.parse_args()
    watch = Watch()
    if not options.write:
        for frame in offline.track(replay(options.minutes)):
            watch(frame)
        return
    with tempfile.TemporaryDirectory() as folder:
        offline.run(replay(options.minutes), Path(folder) / "run", pictures=False, watch=watch)


if __name__ == "__main__":
    main()
