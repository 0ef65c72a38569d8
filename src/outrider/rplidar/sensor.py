"""What a lidar does behind its line: answers requests, turns its motor, sends what it sees.

Time is given to it and bytes go in and out by hand, so that it runs at any pace; `emulator` puts it behind a
pseudo-terminal.
"""

from __future__ import annotations

import struct

from outrider.records import Bytes
from outrider.rplidar.capsules import LAYOUTS
from outrider.rplidar.encode import Encoder, descriptor
from outrider.rplidar.models import DECODED, Mode, Model, choose
from outrider.rplidar.protocol import (
    Answer,
    Command,
    Conf,
    Health,
    Info,
    Request,
    SampleRate,
    pack_conf,
    reply,
    take_request,
)
from outrider.rplidar.scene import Scene

SERIAL = "00112233445566778899AABBCCDDEEFF"
RPM, PWM = 600, 660  # usual speed of the motor, and the PWM that gives it
BOOT_S = 0.5  # deaf for so long after RESET
LEFT_OUT_S = 0.5  # time that jumps by more than this is left out: nothing is sent for it
GOOD, PROTECTED, STALLED = 0, 2, 0x8001  # status of GET_HEALTH; code of a motor that cannot turn


class Sensor:
    """A lidar of a model that sees a scene; `t` [s] never falls."""

    def __init__(self, model: Model, scene: Scene, mode: str | None = None) -> None:
        """`mode` is told as the usual one, by name, or the fastest; raises InputError where it has none."""
        self.model, self._scene = model, scene
        self.typical = choose(model.modes, mode)
        self.slowed = 1.0  # a turn takes so many times as long as it should
        self.blocked = False  # the motor cannot turn
        self._turn = -1  # the next one
        self._scene_s: float | None = None  # where in the scene that begins
        self._t = 0.0
        self.power_up(0.0)

    def power_up(self, t: float) -> None:
        """As after the plug was put in, or RESET: at rest, and deaf for a while."""
        self.health = Health(GOOD, 0)
        self.mode: Mode | None = None  # it sends samples in
        self.rpm = RPM if self.motor == "dtr" else 0  # a pseudo-terminal has no DTR that could stop it
        self._deaf_until = t + BOOT_S if t > 0.0 else t
        self._heard = bytearray()

    @property
    def motor(self) -> str:
        """How the motor is driven."""
        return self._info.motor(self._has_board)

    @property
    def _has_board(self) -> bool:
        return 2 <= self.model.model >> 4 < 4

    @property
    def _info(self) -> Info:
        return Info(self.model.model, self.model.firmware, 1, SERIAL)

    # ------------------------------------------------------------------ asked

    def hear(self, data: bytes, t: float) -> bytes:
        """What it says to bytes of the host."""
        if t < self._deaf_until:
            return b""
        self._heard += data
        said = b""
        while (request := take_request(self._heard)) is not None:
            said += self._answer(request, t)
        return said

    def _answer(self, request: Request, t: float) -> bytes:
        match request.command:
            case Command.STOP:
                self.mode = None
            case Command.RESET:
                self.power_up(t)
            case Command.MOTOR_RPM | Command.MOTOR_PWM:
                self._drive(request)
            case Command.GET_INFO:
                return reply(Answer.INFO, self._info.pack())
            case Command.GET_HEALTH:
                return reply(Answer.HEALTH, self.health.pack())
            case Command.GET_SAMPLERATE:
                times = [round(mode.sample_us) for mode in self.model.modes]
                return reply(Answer.SAMPLERATE, SampleRate(times[0], min(times)).pack())
            case Command.GET_BOARD if self._has_board:
                return reply(Answer.BOARD, struct.pack("<I", 1))
            case Command.GET_CONF if len(request.payload) >= 4:
                return self._told(request.payload)
            case Command.SCAN | Command.FORCE_SCAN:
                return self._start(0, t)
            case Command.EXPRESS_SCAN if request.payload:
                return self._start(request.payload[0], t)
        return b""

    def _told(self, payload: bytes) -> bytes:
        """The reply to GET_CONF; none where it knows nothing of what is asked."""
        key, number = int.from_bytes(payload[:4], "little"), int.from_bytes(payload[4:6], "little")
        if key == Conf.DESIRED_SPEED:
            return reply(Answer.CONF, pack_conf(key, RPM | PWM << 16))
        if key == Conf.MODE_COUNT:
            return reply(Answer.CONF, pack_conf(key, len(self.model.modes)))
        if key == Conf.TYPICAL_MODE:
            return reply(Answer.CONF, pack_conf(key, self.typical.id))
        if number < len(self.model.modes):
            mode = self.model.modes[number]
            told: dict[int, float | str] = {
                Conf.SAMPLE_US: mode.sample_us,
                Conf.RANGE_MAX: mode.range_max,
                Conf.ANSWER: mode.answer,
                Conf.MODE_NAME: mode.name,
            }
            if key in told:
                return reply(Answer.CONF, pack_conf(key, told[key]))
        return b""

    def _drive(self, request: Request) -> None:
        if len(request.payload) == 2:
            speed = int.from_bytes(request.payload, "little")
            self.rpm = speed if request.command == Command.MOTOR_RPM else round(speed * RPM / PWM)

    def _start(self, number: int, t: float) -> bytes:
        """Begin to send samples in a mode; nothing is said to one that is not there or not encoded."""
        modes = [mode for mode in self.model.modes if mode.id == number and mode.answer in DECODED]
        if not modes or self.health.status == PROTECTED:
            return b""
        self.mode = modes[0]
        self._encoder = Encoder(self.mode.answer)
        self._packets: list[Bytes] = []  # made and not yet sent
        self._made = self._sent = 0  # packets since the beginning
        self._run_s = 0.0  # since the beginning, while the motor turned
        self._scene_s = self._scene_s or 0.0
        self._t = t
        return descriptor(self.mode.answer).pack()

    # ------------------------------------------------------------------ sending

    def due(self, t: float) -> bytes:
        """The packets that have gone over the line by now, whole, and were not given before."""
        since, self._t = t - self._t, t
        if self.blocked and self.rpm:
            self.mode, self.health = None, Health(PROTECTED, STALLED)
        if self.mode is None or not self.rpm or since > LEFT_OUT_S:
            self._pass(since)
            return b""
        self._run_s += since
        layout = LAYOUTS[Answer(self.mode.answer)]
        packet_s, line_s = layout.samples * self.mode.sample_us * 1e-6, 10.0 * layout.size / self.model.baud
        count = max(int((self._run_s - line_s) / packet_s + 1e-9), self._sent)
        while self._made < count:
            self._make(self.mode.sample_us * 1e-6)
        ready, self._packets = self._packets[: count - self._sent], self._packets[count - self._sent :]
        self._sent = count
        return b"".join(packet.tobytes() for packet in ready)

    def _pass(self, seconds: float) -> None:
        """The scene goes on unseen."""
        if self._scene_s is not None:
            self._scene_s += seconds

    def _make(self, sample_s: float) -> None:
        """One turn further: what is seen from now on."""
        samples = max(1, round(self.slowed * 60.0 / self.rpm / sample_s))
        packets = self._encoder.feed(self._scene.turn(self._turn, self._scene_s or 0.0, samples))
        self._turn += 1
        self._pass(samples * sample_s)
        self._packets += list(packets)
        self._made += len(packets)
