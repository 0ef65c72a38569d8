"""What a lidar on a bumpy ride sends: scans of a street again and again, and one fault after the other.

Time is given by hand, so that a day passes in minutes: the sensor's, and that of whoever reads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from outrider import scenario, simulate
from outrider.records import LaserScan, Turn
from outrider.rplidar.decoder import BEHIND, Decoder
from outrider.rplidar.faults import Faults
from outrider.rplidar.models import MODELS, Mode, Model
from outrider.rplidar.protocol import Answer, Command, Request, express_request, motor_request
from outrider.rplidar.scene import Scene
from outrider.rplidar.sensor import BOOT_S, Sensor

STREET = """
title = "A rider who waits at a street; cars come from ahead, from behind and from the side"
duration_s = 12.0
vehicles = [
  { name = "oncoming", x_m = 45.0, y_m = 0.4, yaw_deg = 180.0, speed_mps = 8.0 },
  { name = "overtaking", x_m = -40.0, y_m = 2.5, yaw_deg = 0.0, speed_mps = 9.0 },
  { name = "crossing", x_m = 12.0, y_m = -5.5, yaw_deg = 90.0, speed_mps = 1.0 },
]
walls = [
  { points_m = [[-20.0, 7.0], [40.0, 7.0]] },
  { points_m = [[-20.0, -7.0], [40.0, -7.0], [40.0, 7.0]] },
  { points_m = [[-20.0, -7.0], [-20.0, 7.0]] },
]
sensor = { clockwise = true }
"""
STEP_S = 0.025  # bytes are read this often
GOOD_S = 6.0  # between the end of a fault and the next one
LIDARS = ("A1 Standard", "A1 Express", "C1 DenseBoost", "S3 DenseBoost")  # in turn: 81, 82, 85, 86
SAMPLES = 500  # a turn of the last one, which has 3200: so that a day passes in minutes


class Lidar(NamedTuple):
    """One lidar and the way it scans."""

    name: str
    model: Model
    mode: Mode


def lidars() -> list[Lidar]:
    """One of each answer that is decoded."""
    found = []
    for name in LIDARS:
        model = MODELS[name.split()[0]]
        mode = next(mode for mode in model.modes if mode.name == name.split()[1])
        mode = mode._replace(sample_us=max(mode.sample_us, 1e5 / SAMPLES))
        found.append(Lidar(name, model._replace(modes=(*model.modes[: mode.id], mode)), mode))
    return found


def street() -> Scene:
    """Scans of the street, over and over again."""
    scans = [m for m in simulate.record(scenario.parse(STREET)) if isinstance(m, LaserScan)]
    return Scene(lambda: iter(scans))


class Ride:
    """A lidar that is read, and what goes wrong with it; `recover` is when good bytes came again."""

    def __init__(self) -> None:
        self.t, self._shift = 0.0, 1.7e9
        self._scene = street()
        self.faults = Faults()
        self._counted: dict[str, int] = {}  # by the decoders before this one
        self.lidars = lidars()
        self.decoder: Decoder | None = None
        self._plug(self.lidars[0])

    @property
    def host(self) -> float:
        """The clock of who reads [s]."""
        return self.t + self._shift

    def plug(self, lidar: Lidar) -> Iterator[list[Turn]]:
        """Another lidar is plugged in after half a second; whoever reads knows which."""
        self.t += 0.5
        self._plug(lidar)
        yield []

    def _plug(self, lidar: Lidar) -> None:
        self._counted = self.counts
        self.sensor = Sensor(lidar.model, self._scene, lidar.mode.name)
        self.decoder = Decoder(lidar.mode, lidar.model.baud, lidar.model.range_min, BEHIND)
        self._lidar = lidar
        self._begin()

    @property
    def counts(self) -> dict[str, int]:
        """What all decoders have counted."""
        own = {} if self.decoder is None else self.decoder.counts
        return {name: self._counted.get(name, 0) + own.get(name, 0) for name in {**self._counted, **own}}

    def _begin(self) -> None:
        """Start the motor and ask for samples, as whoever reads does."""
        if (
            motor := motor_request(self.sensor.motor, 660 if self.sensor.motor == "pwm" else 600)
        ) is not None:
            self.sensor.hear(motor.pack(), self.t)
        mode = self._lidar.mode
        ask = Request(Command.SCAN) if mode.answer == Answer.STANDARD else express_request(mode.id)
        self._read(self.faults.cut(self.sensor.hear(ask.pack(), self.t)))

    def _read(self, data: bytes) -> list[Turn]:
        return self.decoder.feed(data, self.host) if data else []

    def step(self) -> list[Turn]:
        """A little further: the turns that are whole then."""
        self.t += STEP_S
        return self._read(self.faults.spoil(self.sensor.due(self.t)))

    # ------------------------------------------------------------------ faults; turns while each lasts

    def _for(self, seconds: float) -> Iterator[list[Turn]]:
        for _ in range(round(seconds / STEP_S)):
            yield self.step()

    def lose_bytes(self) -> Iterator[list[Turn]]:
        """30 % of the bytes for three seconds."""
        self.faults.loss = 0.3
        yield from self._for(3.0)
        self.faults.loss = 0.0

    def lose_all(self) -> Iterator[list[Turn]]:
        """Nothing comes for five seconds."""
        self.faults.silent = True
        yield from self._for(5.0)
        self.faults.silent = False

    def lose_a_little(self) -> Iterator[list[Turn]]:
        """Nothing comes for 0.2 s, as when a buffer overflows."""
        self.faults.silent = True
        yield from self._for(0.2)
        self.faults.silent = False

    def noise(self) -> Iterator[list[Turn]]:
        """A lump of bytes that mean nothing."""
        self.faults.garbage = 3000
        yield self.step()

    def half_a_descriptor(self) -> Iterator[list[Turn]]:
        """The stream begins anew, and what announces it is cut."""
        self.faults.half = True
        self.sensor.hear(Request(Command.STOP).pack(), self.t)
        yield from self._for(0.1)
        self._begin()

    def suspend(self) -> Iterator[list[Turn]]:
        """The host sleeps for five seconds, and what was sent is lost."""
        self.t += 5.0
        yield self.step()

    def clock_ahead(self) -> Iterator[list[Turn]]:
        """The clock of the host goes on by an hour."""
        self._shift += 3600.0
        yield self.step()

    def clock_back(self) -> Iterator[list[Turn]]:
        """The clock of the host goes back by a quarter of a second."""
        self._shift -= 0.25
        yield self.step()

    def slow(self) -> Iterator[list[Turn]]:
        """A turn takes twice as long for five seconds."""
        self.sensor.slowed = 2.0
        yield from self._for(5.0)
        self.sensor.slowed = 1.0

    def stall(self) -> Iterator[list[Turn]]:
        """The motor is blocked for three seconds; then the lidar is reset and begins again."""
        self.sensor.blocked = True
        yield from self._for(3.0)
        self.sensor.blocked = False
        self.sensor.hear(Request(Command.RESET).pack(), self.t)
        yield from self._for(BOOT_S + 0.1)
        self._begin()


FAULTS: tuple[Callable[[Ride], Iterator[list[Turn]]], ...] = (
    *(Ride.lose_bytes, Ride.noise, Ride.half_a_descriptor, Ride.lose_all, Ride.slow),
    *(Ride.suspend, Ride.clock_ahead, Ride.lose_a_little, Ride.clock_back, Ride.stall),
)
