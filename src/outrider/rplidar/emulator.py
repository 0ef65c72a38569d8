"""A lidar that is not there: a sensor behind a pseudo-terminal, with faults on request.

The pseudo-terminal carries bytes whatever its speed; that speed is looked at, and where it is not the
model's, what goes over the line is noise, as it is with a real one. Linux; elsewhere every speed is right.
"""

from __future__ import annotations

import fcntl
import math
import os
import select
import struct
import sys
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from outrider.errors import InputError, OutputError
from outrider.rplidar.faults import Faults
from outrider.rplidar.sensor import Sensor

TICK_S = 0.002  # bytes are sent this often, as a USB bridge does
IDLE_S = 0.05  # and it is looked for requests so often while nothing is sent
TAKEN = 4096  # most bytes taken at once
TCGETS2, TERMIOS2 = 0x802C542A, struct.Struct("4I20s2I")  # Linux: settings of a line with its speeds
FAULTS = {
    "loss": "SHARE of the bytes get lost from now on; 0: none",
    "garbage": "N bytes of noise come before the next ones",
    "half": "the next descriptor of a stream is cut",
    "pause": "SECONDS without a byte",
    "stall": "the motor is blocked for SECONDS; then RESET helps",
    "slow": "a turn takes FACTOR times as long",
    "unplug": "the port is gone for SECONDS",
    "baud": "the sensor speaks at so many BAUD",
    "state": "tell what the sensor does",
}


class Emulator:
    """A sensor at a pseudo-terminal; used by one thread, closed at the end."""

    def __init__(self, sensor: Sensor, link: Path | None = None, speed: float = 1.0) -> None:
        """`link`: a symbolic link that is made to wherever the pseudo-terminal is; `speed`: of its clock.

        Raises OutputError where the link cannot be made.
        """
        if not 0.0 < speed < float("inf"):
            raise InputError(f"speed {speed:g}: want a number above 0, such as 1.0")
        self.sensor, self.faults = sensor, Faults()
        self.dropped = 0  # bytes that nobody took
        self._link, self._speed, self._epoch = link, speed, time.monotonic()
        self._later: list[tuple[float, Callable[[], None]]] = []  # when, what
        self._master = self._slave = -1
        self._plug()

    @property
    def port(self) -> str:
        """Path by which a reader finds it."""
        return str(self._link or self._name)

    def close(self) -> None:
        """Take the pseudo-terminal and its link away; a second call does nothing."""
        for end in (self._master, self._slave):
            if end >= 0:
                os.close(end)
        self._master = self._slave = -1
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()

    def serve(
        self,
        seconds: float = float("inf"),
        orders: int | None = None,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        """Behave like a lidar, for so long or for ever.

        `orders`: a file descriptor from which lines for `order` come; at its end it is listened to no longer.
        `tell` is given the answers.
        """
        end, heard = time.monotonic() + seconds, b""
        while time.monotonic() < end:
            self._step()
            watched = [fd for fd in (self._master, orders) if fd is not None and fd >= 0]
            ready = select.select(watched, [], [], TICK_S if self.sensor.mode else IDLE_S)[0]
            if self._master in ready:
                self._hear()
            if orders in ready and orders is not None:
                got = os.read(orders, TAKEN)
                orders = orders if got else None
                *lines, heard = (heard + got).split(b"\n")
                for text in lines:
                    said = self.order(text.decode("utf-8", "replace"))
                    if tell is not None:
                        tell(said)

    def order(self, text: str) -> str:
        """Do one of FAULTS, such as "unplug 1.5"; what was done, or what the sensor does, in one line.

        An order that is not known does nothing, and is answered with those that are.
        """
        name, _, number = text.strip().partition(" ")
        try:
            value = float(number or 0.0)
            if not math.isfinite(value):
                raise ValueError(number)
            self._orders[name](value)
        except (KeyError, ValueError):
            return f"{text.strip()!r}: want " + "; ".join(f"{name}: {what}" for name, what in FAULTS.items())
        mode = self.sensor.mode.name if self.sensor.mode else "none"
        return f"{name}: mode {mode}, rpm {self.sensor.rpm}, status {self.sensor.health.status}"

    # ------------------------------------------------------------------ faults

    @property
    def _orders(self) -> dict[str, Callable[[float], None]]:
        faults, sensor = self.faults, self.sensor
        return {
            "loss": lambda share: setattr(faults, "loss", min(max(share, 0.0), 1.0)),
            "garbage": lambda count: setattr(faults, "garbage", min(max(int(count), 0), TAKEN)),
            "half": lambda _: setattr(faults, "half", True),
            "pause": lambda seconds: self._for_a_while(faults, "silent", seconds),
            "stall": lambda seconds: self._for_a_while(sensor, "blocked", seconds),
            "slow": lambda factor: setattr(sensor, "slowed", min(max(factor, 0.1), 10.0)),
            "unplug": self._unplug,
            "baud": lambda baud: setattr(sensor, "model", sensor.model._replace(baud=max(int(baud), 1))),
            "state": lambda _: None,
        }

    def _for_a_while(self, owner: Any, name: str, seconds: float) -> None:
        setattr(owner, name, True)
        self._later.append((time.monotonic() + seconds, lambda: setattr(owner, name, False)))

    def _unplug(self, seconds: float) -> None:
        self.close()
        self._later.append((time.monotonic() + seconds, self._plug))
        self._later.append((time.monotonic() + seconds, lambda: self.sensor.power_up(self._now)))

    def _plug(self) -> None:
        """A new pseudo-terminal, and the link to it."""
        self.close()
        self._master, self._slave = os.openpty()  # our own end of the slave keeps it alive between readers
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._name = os.ttyname(self._slave)
        if self._link is not None:
            try:
                if self._link.is_symlink():
                    self._link.unlink()
                self._link.symlink_to(self._name)
            except OSError as error:
                self.close()
                raise OutputError(
                    f"{self._link}: no link can be made ({error.strerror}); name another"
                ) from error

    # ------------------------------------------------------------------ bytes

    @property
    def _now(self) -> float:
        return (time.monotonic() - self._epoch) * self._speed

    def _step(self) -> None:
        """Send what is due, then do what was put off until now."""
        if self._master >= 0:
            self._send(self.faults.spoil(self.sensor.due(self._now)))
        now = time.monotonic()
        ripe = [act for at, act in self._later if at <= now]
        self._later = [item for item in self._later if item[0] > now]
        for act in ripe:
            act()

    def _hear(self) -> None:
        data = os.read(self._master, TAKEN)
        if not self._same_speed():
            return
        before = self.sensor.mode
        said = self.sensor.hear(data, self._now)
        begins = before is None and self.sensor.mode is not None
        self._send(self.faults.spoil(self.faults.cut(said) if begins else said))

    def _send(self, data: bytes) -> None:
        """Into the line; what does not fit because nobody reads gets lost, as it does on a real one."""
        if not self._same_speed():
            data = self.faults.noise(len(data))
        sent = 0
        with suppress(BlockingIOError):
            sent = os.write(self._master, data) if data else 0
        self.dropped += len(data) - sent

    def _same_speed(self) -> bool:
        """Whether the reader has set the speed that the model speaks; True where it cannot be told."""
        if not sys.platform.startswith("linux"):
            return True
        settings = bytearray(TERMIOS2.size)
        try:
            fcntl.ioctl(self._master, TCGETS2, settings)
        except OSError:
            return True
        return bool(TERMIOS2.unpack(settings)[-1] == self.sensor.model.baud)
