"""What host and lidar say to each other over the serial line: requests, descriptors, short replies, models.

All numbers are little-endian. A request is `A5 command`, and where the command's top bit is set also
`size payload checksum`; a reply begins with the seven bytes of its descriptor. Each reply here can be read
and built, so that the reader of a lidar and its emulator share one text. Facts from the maker's interface
manual (LR001) and its SDK (BSD).
"""

from __future__ import annotations

import struct
from enum import IntEnum
from functools import reduce
from operator import xor
from typing import Literal, NamedTuple

from outrider.errors import InputError

SYNC = 0xA5
SYNC2 = 0x5A
PAYLOAD_MAX = 255
SHORT_REPLY_MAX = 512  # [bytes]; a descriptor that promises more in one piece is noise
CONF_FIRMWARE = (1, 24)  # from here on models of the A series tell their modes


class Command(IntEnum):
    """What a host asks for."""

    SCAN = 0x20
    FORCE_SCAN = 0x21
    STOP = 0x25  # no reply
    RESET = 0x40  # no reply but the boot text of some models
    GET_INFO = 0x50
    GET_HEALTH = 0x52
    GET_SAMPLERATE = 0x59
    EXPRESS_SCAN = 0x82
    GET_CONF = 0x84
    MOTOR_RPM = 0xA8  # no reply
    MOTOR_PWM = 0xF0  # no reply
    GET_BOARD = 0xFF  # whether the adapter board can drive the motor by PWM


class Answer(IntEnum):
    """Type of a reply, in its descriptor."""

    INFO = 0x04
    HEALTH = 0x06
    SAMPLERATE = 0x15
    CONF = 0x20
    STANDARD = 0x81
    EXPRESS = 0x82
    ULTRA = 0x84
    DENSE = 0x85
    ULTRA_DENSE = 0x86
    BOARD = 0xFF


class Conf(IntEnum):
    """Keys of GET_CONF that are used."""

    DESIRED_SPEED = 0x01  # two u16: rpm, PWM
    MODE_COUNT = 0x70
    SAMPLE_US = 0x71  # of one mode, in 1/256 us
    RANGE_MAX = 0x74  # of one mode, in 1/256 m
    ANSWER = 0x75  # of one mode
    TYPICAL_MODE = 0x7C
    MODE_NAME = 0x7F  # of one mode


MODE_KEYS = (Conf.SAMPLE_US, Conf.RANGE_MAX, Conf.ANSWER, Conf.MODE_NAME)  # all that tells of one mode
SERIES = (("M", 12), ("T", 9), ("S", 6), ("C", 4))  # letter, and Info.model >> 4 of its first; below: A
Motor = Literal["dtr", "pwm", "rpm"]

# ------------------------------------------------------------------ requests


class Request(NamedTuple):
    """What a host said."""

    command: int
    payload: bytes = b""

    def pack(self) -> bytes:
        """As it goes over the line."""
        head = bytes([SYNC, self.command])
        if not self.command & 0x80:
            return head
        body = head + bytes([len(self.payload)]) + self.payload
        return body + bytes([reduce(xor, body)])


def take_request(buffer: bytearray) -> Request | None:
    """The first whole request, taken out of `buffer` with all noise before it; None while there is none."""
    while (start := buffer.find(SYNC)) >= 0:
        del buffer[:start]
        if len(buffer) < 2:
            return None
        command = buffer[1]
        if not command & 0x80:
            if command in frozenset(Command):
                del buffer[:2]
                return Request(command)
            del buffer[:1]
            continue
        if len(buffer) < 3 or len(buffer) < buffer[2] + 4:
            return None
        end = buffer[2] + 4
        if not reduce(xor, buffer[:end]):
            payload = bytes(buffer[3 : end - 1])
            del buffer[:end]
            return Request(command, payload)
        del buffer[:1]
    buffer.clear()
    return None


def express_request(working_mode: int) -> Request:
    """Ask for samples of a mode by capsules; `working_mode` is Mode.id, 0 where modes are not told."""
    return Request(Command.EXPRESS_SCAN, struct.pack("<BHH", working_mode, 0, 0))


def motor_request(motor: Motor, speed: int) -> Request | None:
    """Turn at `speed`: rpm for "rpm", 0..1023 for "pwm", 0: stop; None for a motor that hangs on DTR."""
    if motor == "dtr":
        return None
    return Request(Command.MOTOR_RPM if motor == "rpm" else Command.MOTOR_PWM, struct.pack("<H", speed))


def conf_request(key: int, mode: int | None = None) -> Request:
    """Ask for one value of GET_CONF, of one mode where the key needs it."""
    return Request(
        Command.GET_CONF, struct.pack("<I", key) + (b"" if mode is None else struct.pack("<H", mode))
    )


# ------------------------------------------------------------------ replies


class Descriptor(NamedTuple):
    """The seven bytes before every reply."""

    length: int  # of the payload, or of each packet of a stream [bytes]
    stream: bool  # packets come until STOP
    answer: int

    def pack(self) -> bytes:
        """As it goes over the line."""
        size = self.length | (0x4000_0000 if self.stream else 0)
        return struct.pack("<BBIB", SYNC, SYNC2, size, self.answer)

    @classmethod
    def parse(cls, seven: bytes) -> Descriptor:
        """From the seven bytes, which begin with A5 5A."""
        _, _, size, answer = struct.unpack("<BBIB", seven)
        return cls(size & 0x3FFF_FFFF, bool(size >> 30), answer)


class Reply(NamedTuple):
    """A descriptor and its payload; that of a stream is empty, and its packets follow in the buffer."""

    descriptor: Descriptor
    payload: bytes = b""


def reply(answer: int, payload: bytes) -> bytes:
    """A short reply as it goes over the line."""
    return Descriptor(len(payload), False, answer).pack() + payload


def take_reply(buffer: bytearray) -> Reply | None:
    """The first whole reply, taken out of `buffer` with all noise before it; None while there is none.

    Never raises. What is kept in `buffer` while None is given is less than SHORT_REPLY_MAX + 7 bytes.
    """
    while (start := buffer.find(bytes([SYNC, SYNC2]))) >= 0:
        del buffer[:start]
        if len(buffer) < 7:
            return None
        descriptor = Descriptor.parse(bytes(buffer[:7]))
        known = descriptor.answer in frozenset(Answer) and descriptor.length <= SHORT_REPLY_MAX
        end = 7 if descriptor.stream else 7 + descriptor.length
        if known and len(buffer) >= end:
            payload = bytes(buffer[7:end])
            del buffer[:end]
            return Reply(descriptor, payload)
        if known:
            return None
        del buffer[:2]
    del buffer[: len(buffer) - buffer.endswith(bytes([SYNC]))]
    return None


class Info(NamedTuple):
    """Who the lidar is: reply to GET_INFO."""

    model: int  # series and model in one byte
    firmware: tuple[int, int]  # major, minor
    hardware: int
    serial: str  # 32 hexadecimal digits

    @classmethod
    def parse(cls, payload: bytes) -> Info:
        """From the 20 bytes of the payload; InputError for another length."""
        model, minor, major, hardware, serial = struct.unpack("<BBBB16s", _of_length(payload, 20, "GET_INFO"))
        return cls(model, (major, minor), hardware, serial.hex().upper())

    def pack(self) -> bytes:
        """The payload."""
        major, minor = self.firmware
        return struct.pack("<BBBB16s", self.model, minor, major, self.hardware, bytes.fromhex(self.serial))

    @property
    def tells_modes(self) -> bool:
        """Whether GET_CONF is answered."""
        return self.model >> 4 >= 4 or self.firmware >= CONF_FIRMWARE

    @property
    def name(self) -> str:
        """As printed on the box, as far as the byte says."""
        major = self.model >> 4
        letter, first = next((row for row in SERIES if row[1] <= major), ("A", 1))
        return f"{letter}{major - first + 1}M{self.model & 15}"

    def motor(self, board_has_pwm: bool) -> Motor:
        """How the motor is driven; `board_has_pwm` from GET_BOARD, which only series A2 to C need."""
        major = self.model >> 4
        if major >= 6:
            return "rpm"
        return "pwm" if major >= 2 and board_has_pwm else "dtr"


class Health(NamedTuple):
    """How the lidar is: reply to GET_HEALTH."""

    status: int  # 0 good, 1 warning, 2 error: it has stopped to protect itself, RESET may help
    code: int

    @classmethod
    def parse(cls, payload: bytes) -> Health:
        """From the 3 bytes of the payload; InputError for another length."""
        return cls(*struct.unpack("<BH", _of_length(payload, 3, "GET_HEALTH")))

    def pack(self) -> bytes:
        """The payload."""
        return struct.pack("<BH", self.status, self.code)


class SampleRate(NamedTuple):
    """Time of one sample: reply to GET_SAMPLERATE."""

    standard_us: int
    express_us: int

    @classmethod
    def parse(cls, payload: bytes) -> SampleRate:
        """From the 4 bytes of the payload; InputError for another length."""
        return cls(*struct.unpack("<HH", _of_length(payload, 4, "GET_SAMPLERATE")))

    def pack(self) -> bytes:
        """The payload."""
        return struct.pack("<HH", *self)


def parse_conf(payload: bytes) -> tuple[int, int | float | str]:
    """Key and value of a reply to GET_CONF, in the units of Mode; InputError where it is too short."""
    if len(payload) < 5:
        raise InputError(f"reply to GET_CONF has {len(payload)} bytes: want 5 or more; ask again")
    key, value = int.from_bytes(payload[:4], "little"), payload[4:]
    if key == Conf.MODE_NAME:
        return key, value.split(b"\0")[0].decode("ascii", "replace")
    number = int.from_bytes(value[:4], "little")
    return key, number / 256.0 if key in (Conf.SAMPLE_US, Conf.RANGE_MAX) else number


def pack_conf(key: int, value: float | str) -> bytes:
    """The payload of a reply to GET_CONF, the inverse of `parse_conf`."""
    if isinstance(value, str):
        told = value.encode("ascii") + b"\0"
    elif key in (Conf.SAMPLE_US, Conf.RANGE_MAX):
        told = struct.pack("<I", round(value * 256.0))
    else:
        told = int(value).to_bytes({Conf.ANSWER: 1, Conf.DESIRED_SPEED: 4}.get(Conf(key), 2), "little")
    return struct.pack("<I", key) + told


def _of_length(payload: bytes, want: int, what: str) -> bytes:
    if len(payload) != want:
        raise InputError(f"reply to {what} has {len(payload)} bytes: want {want}; ask again")
    return payload
