"""An open port with a lidar behind it that is asked and answers; every wait has an end."""

from __future__ import annotations

import time
from contextlib import suppress

from outrider.rplidar import ports
from outrider.rplidar.models import Mode, nearest_model, old_modes
from outrider.rplidar.ports import Setback
from outrider.rplidar.protocol import (
    MODE_KEYS,
    Answer,
    Command,
    Conf,
    Health,
    Info,
    Motor,
    Reply,
    Request,
    SampleRate,
    conf_request,
    motor_request,
    parse_conf,
    take_reply,
)

ANSWER_S = 0.25  # a reply comes within some ms; the USB bridge and a busy host are given the rest
QUIET_S = 0.02  # nothing came for so long: what was sent before STOP is through
STOPPING_S = 0.1  # at most, until then
GATHER_S = 0.002  # bytes are let gather so long, so that they are not decoded one by one
STORED = 4096  # most bytes taken at once
MODES_MAX = 16  # replies have no checksum: a number beyond is noise
RPM, PWM = 600, 660  # usual speed of the motor, where the lidar does not tell


class Line:
    """A lidar's end of a serial port; the motor is at rest until `start_motor`."""

    def __init__(self, port: str, baud: int) -> None:
        """Open it; raises Setback."""
        self.port, self.baud = port, baud
        self._serial = ports.opened(port, baud)
        self._buffer = bytearray()
        self.heard = 0  # bytes that came in answer to questions
        self._motor: Motor | None = None

    def close(self) -> None:
        """Leave the sensor at rest, as far as it can still be told, and free the port."""
        with suppress(*ports.ERRORS):
            self.send(Request(Command.STOP))
            self._turn(0)
        ports.close(self._serial)

    # ------------------------------------------------------------------ bytes

    def send(self, request: Request) -> None:
        """Say something; raises OSError where the port is gone."""
        self._serial.write(request.pack())

    def read(self) -> bytes:
        """What has come, at most STORED bytes; waits a little. OSError: the port is gone."""
        if self._buffer:
            kept = bytes(self._buffer)
            self._buffer.clear()
            return kept
        begun: bytes = self._serial.read(1)
        if not begun:
            return b""
        time.sleep(GATHER_S)
        rest: bytes = self._serial.read(min(self._serial.in_waiting, STORED - 1))
        return begun + rest

    def hush(self) -> None:
        """Tell the sensor to stop, and throw away what it sent until it did."""
        self.send(Request(Command.STOP))
        end = time.monotonic() + STOPPING_S
        while time.monotonic() < end:
            time.sleep(QUIET_S)
            if not self._serial.in_waiting:
                break
            self.discard()
        self.discard()

    def discard(self) -> None:
        """Throw away what has come and was not read."""
        self._buffer.clear()
        self._serial.reset_input_buffer()

    def ask(self, request: Request, answer: int, wait: float = ANSWER_S) -> Reply:
        """Say something and wait for the reply of a type; raises Setback where it does not come."""
        self.discard()
        self.send(request)
        end = time.monotonic() + wait
        while time.monotonic() < end:
            got = self._serial.read(max(1, min(self._serial.in_waiting, STORED)))
            self.heard += len(got)
            self._buffer += got
            while (reply := take_reply(self._buffer)) is not None:
                if reply.descriptor.answer == answer:
                    return reply
        name = Command(request.command).name
        raise Setback(f"{self.port}: no whole answer to {name}; is the cable good?")

    # ------------------------------------------------------------------ questions

    def info(self) -> Info:
        """Who is there; raises Setback."""
        return Info.parse(self.ask(Request(Command.GET_INFO), Answer.INFO).payload)

    def health(self) -> Health:
        """How it is; raises Setback."""
        return Health.parse(self.ask(Request(Command.GET_HEALTH), Answer.HEALTH).payload)

    def modes(self, info: Info) -> tuple[Mode, ...]:
        """Ways of scanning, as the sensor tells them; raises Setback."""
        if not info.tells_modes:
            rate = self.ask(Request(Command.GET_SAMPLERATE), Answer.SAMPLERATE).payload
            return old_modes(SampleRate.parse(rate), nearest_model(info).modes[0].range_max)
        modes = tuple(self._mode(i) for i in range(min(int(self._conf(Conf.MODE_COUNT)), MODES_MAX)))
        if not all(1.0 <= mode.sample_us <= 1e4 and 0.5 <= mode.range_max <= 500.0 for mode in modes):
            raise Setback(f"{self.port}: its list of modes makes no sense; is the cable good?")
        return modes

    def _mode(self, i: int) -> Mode:
        told = {key: self._conf(key, i) for key in MODE_KEYS}
        name, answer = str(told[Conf.MODE_NAME]), int(told[Conf.ANSWER])
        return Mode(i, name, answer, float(told[Conf.SAMPLE_US]), float(told[Conf.RANGE_MAX]))

    def _conf(self, key: int, mode: int | None = None) -> int | float | str:
        got, value = parse_conf(self.ask(conf_request(key, mode), Answer.CONF).payload)
        if got != key:
            raise Setback(f"{self.port}: asked for {key:#x}, told {got:#x}; asking again")
        return value

    # ------------------------------------------------------------------ motor

    def start_motor(self, info: Info) -> None:
        """Let it turn at the speed the sensor wants."""
        board = b""
        with suppress(Setback):  # one that knows of no board does not answer
            if 2 <= info.model >> 4 < 6:
                board = self.ask(Request(Command.GET_BOARD, bytes(4)), Answer.BOARD).payload
        self._motor = info.motor(bool(board and board[0] & 1))
        rpm, pwm = RPM, PWM
        with suppress(Setback):
            if info.tells_modes and self._motor != "dtr":
                wanted = int(self._conf(Conf.DESIRED_SPEED))
                rpm, pwm = wanted & 0xFFFF or RPM, wanted >> 16 or PWM
        self._turn(pwm if self._motor == "pwm" else rpm)

    def _turn(self, speed: int) -> None:
        """Run the motor, or with 0 stop it, the way it is driven; nothing where that is not known yet."""
        if self._motor == "dtr":
            ports.set_dtr(self._serial, not speed)
        elif self._motor is not None:
            request = motor_request(self._motor, speed)
            if request is not None:
                self.send(request)
