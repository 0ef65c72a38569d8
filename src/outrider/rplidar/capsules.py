"""The four packets of samples, all packets of a buffer at once: whether they are whole, and what they say.

A packet of the standard answer is one sample. A capsule holds N samples at even steps of angle, from its own
start angle to that of the next capsule. Angles here are the sensor's: clockwise, 0 ahead, in 1/64 degree.
Layouts: the maker's manual (LR001) and SDK (BSD).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.records import Array, Bools, Bytes, Ints
from outrider.rplidar.protocol import Answer

TURN_Q6 = 360 * 64  # one turn [1/64 deg]
FIRST = 0x8000  # bit of the start angle: this capsule has none before it


class Layout(NamedTuple):
    """How packets of one answer lie in the stream."""

    size: int  # of a packet [bytes]
    samples: int  # in it
    start: int  # where the start angle stands [bytes]
    body: int  # where the samples begin [bytes]


LAYOUTS = {
    Answer.STANDARD: Layout(5, 1, 1, 3),
    Answer.EXPRESS: Layout(84, 32, 2, 4),
    Answer.DENSE: Layout(84, 40, 2, 4),
    Answer.ULTRA_DENSE: Layout(170, 64, 8, 10),
}

# Ultra-dense: the low two bits of a 20-bit word choose the step, then the value begins where the finer ended.
STEP_MM = np.array([2, 3, 4, 5])
VALUE_BITS = np.array([10, 11, 12, 13])
BEGIN_MM = np.concatenate([[0], np.cumsum(STEP_MM * (2**VALUE_BITS - 1))])[:4]  # 0, 2046, 8187, 24567


class Samples(NamedTuple):
    """What m packets say, N samples each."""

    start_q6: Ints  # (m,) angle of the first sample [1/64 deg]
    first: Bools  # (m,) standard: first sample of a turn; capsules: not preceded by another
    offset_deg: Array  # (m, N) to be subtracted from the even steps [deg]
    range_mm: Array  # (m, N); 0: no return [mm]
    quality: Array  # (m, N); 0 throughout where the answer does not tell


def whole(answer: int, rows: Bytes) -> Bools:
    """Which of the packets (m, size) pass all that can be checked in one packet alone."""
    if answer == Answer.STANDARD:
        flags = rows[:, 0] & 3
        angle = _word(rows, 1) >> 1
        node: Bools = ((flags == 1) | (flags == 2)) & ((rows[:, 1] & 1) == 1) & (angle <= TURN_Q6)
        return node
    good: Bools = (rows[:, 0] >> 4 == 0xA) & (rows[:, 1] >> 4 == 0x5)
    good &= (rows[:, 0] & 15) | (rows[:, 1] << 4) == np.bitwise_xor.reduce(rows[:, 2:], axis=1)
    good &= _word(rows, LAYOUTS[Answer(answer)].start) & (FIRST - 1) <= TURN_Q6
    return good


def start_q6(answer: int, rows: Bytes) -> Ints:
    """Angles (m,) of the first samples of whole packets (m, size) [1/64 deg]."""
    word = _word(rows, LAYOUTS[Answer(answer)].start)
    return word >> 1 if answer == Answer.STANDARD else word & (FIRST - 1)


def unpack(answer: int, rows: Bytes) -> Samples:
    """What whole packets (m, size) say."""
    if answer == Answer.STANDARD:
        quality, mm = rows[:, :1] >> 2, _word(rows, 3)[:, None] / 4.0
        none = np.zeros((len(rows), 1))
        return Samples(start_q6(answer, rows), rows[:, 0] & 1 == 1, none, mm, quality.astype(np.float64))
    layout = LAYOUTS[Answer(answer)]
    first = _word(rows, layout.start) & FIRST > 0
    body = rows[:, layout.body :]
    read = {Answer.EXPRESS: _express, Answer.DENSE: _dense, Answer.ULTRA_DENSE: _ultra_dense}[Answer(answer)]
    return Samples(start_q6(answer, rows), first, *read(body))


def _express(body: Bytes) -> tuple[Array, Array, Array]:
    """Two words of a distance in mm above two bits of angle; then a byte with four bits more of each."""
    word, nibble = _cabins(body)
    offset = (nibble | (word & 3) << 4) / 8.0
    mm = (word >> 2).astype(np.float64)
    return offset, mm, np.zeros_like(mm)


def _dense(body: Bytes) -> tuple[Array, Array, Array]:
    """Words of a distance in mm."""
    mm = np.ascontiguousarray(body).view("<u2").astype(np.float64)
    return np.zeros_like(mm), mm, np.zeros_like(mm)


def _ultra_dense(body: Bytes) -> tuple[Array, Array, Array]:
    """Two words and a byte with four more bits of each: two bits of scale, a value, and quality above it."""
    low, high = _cabins(body)
    word = low | high << 16
    scale = word & 3
    bits = VALUE_BITS[scale]
    value = word >> 2 & (1 << bits) - 1
    quality = word >> bits + 2 << scale
    return (
        np.zeros(word.shape),
        (STEP_MM[scale] * value + BEGIN_MM[scale]).astype(float),
        quality.astype(float),
    )


def _cabins(body: Bytes) -> tuple[Ints, Ints]:
    """Words (m, N) and half bytes (m, N) of pairs of samples in five bytes."""
    five = body.reshape(len(body), -1, 5).astype(np.int64)
    word = np.stack([five[..., 0] | five[..., 1] << 8, five[..., 2] | five[..., 3] << 8], axis=-1)
    half = np.stack([five[..., 4] & 15, five[..., 4] >> 4], axis=-1)
    return word.reshape(len(body), -1), half.reshape(len(body), -1)


def _word(rows: Bytes, at: int) -> Ints:
    """(m,) the 16-bit number at a place of each packet."""
    low: npt.NDArray[np.int64] = rows[:, at].astype(np.int64)
    return low | rows[:, at + 1].astype(np.int64) << 8
