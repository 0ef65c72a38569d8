"""Samples to the packets of a lidar, the inverse of `capsules`: what an emulator sends.

What is lost on the way, and all that is lost:

| answer | angle | range | quality |
|---|---|---|---|
| 81 | 1/64 deg | 0.25 mm, to 16.38 m | 0..63 |
| 82 | even steps between starts of 1/64 deg | 1 mm, to 16.38 m | none |
| 85 | even steps between starts of 1/64 deg | 1 mm, to 65.5 m | none |
| 86 | even steps between starts of 1/64 deg | 2 to 5 mm, to 2.0, 8.2, 24.6, 65.5 m | 0..255 in 1, 2, 4, 8 |

A range that does not fit is sent as "no return".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.records import Array, Bytes, Ints, LaserScan
from outrider.rplidar.capsules import BEGIN_MM, FIRST, LAYOUTS, STEP_MM, TURN_Q6, VALUE_BITS
from outrider.rplidar.protocol import Answer, Descriptor

END_MM = BEGIN_MM + STEP_MM * (2**VALUE_BITS - 1)  # last range of each scale


class Sweep(NamedTuple):
    """n samples in the order of time."""

    angle: Array  # (n,) clockwise, 0 ahead; grows and is never wrapped [deg]
    range: Array  # (n,) [m]; 0: no return
    quality: Array  # (n,)


def descriptor(answer: int) -> Descriptor:
    """What is sent before the first packet."""
    return Descriptor(LAYOUTS[Answer(answer)].size, True, answer)


def sweep(scan: LaserScan, samples: int, turns: int) -> Sweep:
    """The scan as a lidar sees it that takes `samples` a turn, clockwise from ahead; `turns` made before.

    Each sample is the scan's nearest beam. The time of a beam within the scan is not kept.
    """
    clockwise: Array = np.arange(samples, dtype=np.float64) * (360.0 / samples)
    n = len(scan.ranges)
    if not n or not scan.angle_increment:
        return Sweep(clockwise + 360.0 * turns, np.zeros(samples), np.zeros(samples))
    step = np.rad2deg(scan.angle_increment)
    beams = round(360.0 / abs(step))
    beam = np.rint((-clockwise - np.rad2deg(scan.angle_min)) / step).astype(int) % beams
    seen = np.minimum(beam, n - 1)
    ranges = scan.ranges[seen].astype(float)
    with np.errstate(invalid="ignore"):
        good = (beam < n) & np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges < scan.range_max)
    quality = scan.intensities[seen].astype(float) if len(scan.intensities) == n else np.full(samples, 47.0)
    return Sweep(
        clockwise + 360.0 * turns,
        np.where(good, ranges, 0.0),
        np.where(good & np.isfinite(quality), quality, 0.0),
    )


class Encoder:
    """Sweeps in, whole packets out; samples that do not fill a packet wait for the next ones."""

    def __init__(self, answer: int) -> None:
        self.answer = Answer(answer)
        self._layout = LAYOUTS[self.answer]
        self._waiting = Sweep(np.zeros(0), np.zeros(0), np.zeros(0))
        self._turn = -1  # that the last sample of the standard answer was in
        self._begun = False

    def feed(self, more: Sweep) -> Bytes:
        """(m, size) whole packets; each is what goes over the line once its last sample is taken."""
        samples = Sweep._make(np.concatenate(pair) for pair in zip(self._waiting, more, strict=True))
        n = self._layout.samples
        m = len(samples.angle) // n
        self._waiting = Sweep._make(column[m * n :] for column in samples)
        angle, metres, quality = (column[: m * n].reshape(m, n) for column in samples)
        mm = np.nan_to_num(metres, nan=0.0, posinf=0.0, neginf=0.0) * 1000.0
        if not m:
            return np.zeros((0, self._layout.size), np.uint8)
        if self.answer == Answer.STANDARD:
            return self._standard(angle[:, 0], mm[:, 0], quality[:, 0])
        return self._capsules(angle, mm, quality)

    def _standard(self, angle: Array, mm: Array, quality: Array) -> Bytes:
        q6 = np.rint(angle * 64.0).astype(np.int64)
        turn = q6 // TURN_Q6
        first = np.diff(turn, prepend=self._turn) != 0
        self._turn = int(turn[-1])
        rows = np.empty((len(q6), 5), np.uint8)
        rows[:, 0] = np.clip(quality, 0.0, 63.0).astype(np.uint8) << 2 | np.where(first, 1, 2)
        _put(rows, 1, (q6 % TURN_Q6) << 1 | 1)
        _put(rows, 3, _rounded(mm * 4.0, 0xFFFF))
        return rows

    def _capsules(self, angle: Array, mm: Array, quality: Array) -> Bytes:
        m, n = angle.shape
        layout = self._layout
        rows = np.zeros((m, layout.size), np.uint8)
        start = np.rint(angle[:, 0] * 64.0).astype(np.int64)
        first = np.zeros(m, np.int64)
        first[0] = 0 if self._begun else FIRST
        self._begun = True
        _put(rows, layout.start, start % TURN_Q6 | first)
        body = rows[:, layout.body :]
        if self.answer == Answer.DENSE:
            body[:] = _rounded(mm, 0xFFFF).astype("<u2").view(np.uint8)
        elif self.answer == Answer.EXPRESS:
            _put_cabins(body, _rounded(mm, 0x3FFF) << 2, np.zeros((m, n), np.int64))
        else:
            word = _scaled(mm, quality)
            _put_cabins(body, word & 0xFFFF, word >> 16)
        check = np.bitwise_xor.reduce(rows[:, 2:], axis=1)
        rows[:, 0], rows[:, 1] = 0xA0 | check & 15, 0x50 | check >> 4
        return rows


def _scaled(mm: Array, quality: Array) -> Ints:
    """(m, n) 20-bit words of the ultra-dense answer."""
    scale = np.minimum(np.searchsorted(END_MM, mm, side="left"), 3)
    value = np.rint((mm - BEGIN_MM[scale]) / STEP_MM[scale]).astype(np.int64)
    fits = (value >= 0) & (value < 1 << VALUE_BITS[scale]) & (mm > 0.0)
    strength = np.clip(quality, 0.0, 255.0).astype(np.int64) >> scale
    word: Ints = np.where(fits, strength << VALUE_BITS[scale] + 2 | value << 2 | scale, 0)
    return word


def _rounded(value: Array, most: int) -> Ints:
    """(m, n) the nearest whole number, 0 where that is more than fits."""
    whole: npt.NDArray[np.int64] = np.rint(value).astype(np.int64)
    return np.where((whole >= 0) & (whole <= most), whole, 0)


def _put(rows: Bytes, at: int, word: Ints) -> None:
    """Write 16-bit numbers (m,) to a place of each packet."""
    rows[:, at], rows[:, at + 1] = word & 0xFF, word >> 8


def _put_cabins(body: Bytes, word: Ints, half: Ints) -> None:
    """Write words (m, N) and half bytes (m, N) as pairs of samples in five bytes."""
    five = body.reshape(len(body), -1, 5)
    five[..., 0], five[..., 1] = word[:, ::2] & 0xFF, word[:, ::2] >> 8
    five[..., 2], five[..., 3] = word[:, 1::2] & 0xFF, word[:, 1::2] >> 8
    five[..., 4] = half[:, ::2] | half[:, 1::2] << 4
