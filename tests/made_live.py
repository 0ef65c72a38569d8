"""Live sources and sinks made by hand for the tests: they wait for nothing but each other."""

import threading

import numpy as np

from outrider import scenario, simulate
from outrider.live import Silent, Trouble
from outrider.live.clock import now
from outrider.records import LaserScan, Turn

HEAD_ON = """
title = "A car comes straight at a standing rider"
duration_s = 4.0
vehicles = [{ name = "car", x_m = 40.0, y_m = 0.0, yaw_deg = 180.0, speed_mps = 8.0 }]
walls = [{ points_m = [[-20.0, 6.0], [60.0, 6.0]] }]
"""


def head_on():
    """Scans of a car that comes straight at a standing rider."""
    return [m for m in simulate.record(scenario.parse(HEAD_ON)) if isinstance(m, LaserScan)]


def turn_of(scan, offset=0.0, faults=()):
    """A recorded scan as a live sensor would have given it, `offset` [s] later."""
    n = len(scan.ranges)
    beam_t = scan.stamp_ns * 1e-9 + offset + scan.time_increment * np.arange(n)
    angle = scan.angle_min + scan.angle_increment * np.arange(n)
    ranges = np.where(np.isfinite(scan.ranges), scan.ranges, 0.0).astype(np.float32)
    quality = np.full(n, 40.0, np.float32)
    last = float(beam_t[-1]) if n else scan.stamp_ns * 1e-9 + offset
    return Turn(beam_t, angle, ranges, quality, scan.range_min, scan.range_max, last + 0.002, faults)


class Fed:
    """Source of some events, each handed over when the engine is through with the one before."""

    def __init__(self, events):
        self.about = {"sensor": "made by hand", "counts": {"fed": 0}}
        self.taken = threading.Semaphore(0)
        self.finished = False
        self.stopped = 0
        self._events, self._over = list(events), threading.Event()

    def start(self, put):
        self._thread = threading.Thread(target=self._feed, args=(put,), daemon=True)
        self._thread.start()

    def _feed(self, put):
        for event in self._events:
            if callable(event):
                event()
                continue
            put(event)
            self.about["counts"]["fed"] += 1
            if not isinstance(event, Trouble):
                self.taken.acquire(timeout=60.0)  # the engine may have to compile
            if self._over.is_set():
                break
        self.finished = True

    def stop(self):
        self.stopped += 1
        self._over.set()
        self.taken.release()
        self._thread.join()


class Kept(Silent):
    """Sink that keeps all it is told; `source` is told that it may go on."""

    def __init__(self, source=None):
        super().__init__()
        self.shots, self.raws, self.healths, self.order, self.closed = [], [], [], [], 0
        self._source = source

    def _took(self, kind):
        self.order.append(kind)
        if self._source is not None and kind != "health":
            self._source.taken.release()

    def shot(self, shot):
        self.shots.append(shot)
        self._took("shot")

    def raw(self, raw):
        self.raws.append(raw)
        self._took("raw")

    def health(self, health):
        self.healths.append((now(), health))
        self._took("health")

    def close(self):
        self.closed += 1
