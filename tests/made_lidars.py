"""Lidars that are not there, each in a process of its own, and what is seen through them."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

from outrider.records import LaserScan, Raw, Turn
from outrider.rplidar.emulator import Emulator
from outrider.rplidar.models import MODELS, Mode
from outrider.rplidar.protocol import Answer
from outrider.rplidar.scene import Scene
from outrider.rplidar.sensor import Sensor

STEPS = 45  # of the staircase that is seen all around
FOUR = (Answer.STANDARD, Answer.EXPRESS, Answer.DENSE, Answer.ULTRA_DENSE)


def staircase(angle):
    """Ranges [m] that are seen at angles counter-clockwise from ahead [rad]; no two steps are alike."""
    step = np.floor(np.mod(angle, 2.0 * np.pi) / (2.0 * np.pi) * STEPS)
    return 0.5 + 0.2013 * (step * 17 % STEPS)


def from_edge(angle):
    """How far angles lie from the nearest edge of the staircase [rad]."""
    width = 2.0 * np.pi / STEPS
    inside = np.mod(angle, width)
    return np.minimum(inside, width - inside)


def scans(beams=3600):
    """One scan of the staircase."""
    increment = 2.0 * np.pi / beams
    angle = -np.pi + (np.arange(beams) + 0.5) * increment
    ranges = staircase(angle).astype(np.float32)
    timing = (0.1 / beams, 0.1, 0.05, 40.0)
    yield LaserScan("/scan", "lidar", 0, 0, angle[0], increment, *timing, ranges, np.zeros(0, np.float32))


def with_all_answers(model):
    """The model, with a mode for each of the four answers."""
    rows = [(0, "Standard", 508.0), (1, "Express", 254.0), (2, "Dense", 254.0), (3, "UltraDense", 254.0)]
    if model.baud > 500_000:
        rows = [(0, "Standard", 125.0), (1, "Express", 62.5), (2, "Dense", 31.25), (3, "UltraDense", 31.25)]
    modes = (Mode(i, name, FOUR[i], us, 16.0) for i, name, us in rows)
    return model._replace(modes=tuple(modes))


class Lidar:
    """An emulator in its own process; with the model's own modes, or `mode` of `with_all_answers`."""

    def __init__(self, model, mode="", link="", before=()):
        self._process = subprocess.Popen(
            [sys.executable, __file__, model, mode, str(link), *before],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        self.port = self._process.stdout.readline().strip()
        assert self.port

    def order(self, text):
        """Make a fault, or ask for its state; what it says to that."""
        self._process.stdin.write(f"{text}\n")
        return self._process.stdout.readline().strip()

    def asleep(self, seconds):
        """The whole process is suspended for a while."""
        self._process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        self._process.send_signal(signal.SIGCONT)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.send_signal(signal.SIGCONT)
        self._process.kill()
        self._process.wait()
        self._process.stdin.close()
        self._process.stdout.close()


class Log:
    """What a source gave, and when; any thread may wait for more."""

    def __init__(self):
        self.events, self._more = [], threading.Condition()

    def put(self, event):
        with self._more:
            self.events.append((time.monotonic(), event))
            self._more.notify_all()

    def wait(self, fits, since=0.0, limit=10.0):
        """The first event that fits, not before `since`, and when it came."""
        end = time.monotonic() + limit
        with self._more:
            while True:
                found = next(((t, e) for t, e in self.events if t >= since and fits(e)), None)
                if found or time.monotonic() > end:
                    told = [
                        round(t - since, 2) if isinstance(e, Turn) else e.words
                        for t, e in self.events
                        if not isinstance(e, Raw)
                    ]
                    assert found, f"not within {limit} s; came: {told}"
                    return found
                self._more.wait(0.1)

    def of(self, kind):
        with self._more:
            return [event for _, event in self.events if isinstance(event, kind)]


def say(text):
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main(model, mode, link, *before):
    """The process of a `Lidar`."""
    known = with_all_answers(MODELS[model]) if mode else MODELS[model]
    sensor = Sensor(known, Scene(scans), mode or None)
    emulator = Emulator(sensor, Path(link) if link else None)
    for text in before:
        emulator.order(text)
    say(emulator.port)
    try:
        emulator.serve(orders=sys.stdin.fileno(), tell=say)
    finally:
        emulator.close()


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main(*sys.argv[1:])
