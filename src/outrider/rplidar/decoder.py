"""Bytes of a lidar in, turns out: a pure function of the bytes and of when they came.

The mirror is a clock: it goes on turning while bytes are lost, so the angle at which samples come again says
how many are missing, up to whole turns, and these the host's clock says.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from outrider.records import Array, Bools, Ints, Turn
from outrider.rplidar.beam_time import BeamTime
from outrider.rplidar.capsules import LAYOUTS, TURN_Q6, Samples, start_q6, unpack
from outrider.rplidar.framing import BACK_Q6, Framer, Packets
from outrider.rplidar.models import DECODED, Mode, refuse
from outrider.rplidar.protocol import Answer

AHEAD, BEHIND = 0.0, 180.0  # seams [deg]
SILENCE_S = 0.5  # without bytes: what came before belongs to no turn that is given
QUIET_S = 0.05  # without bytes, and then too few for it: some got lost, whatever angle comes next
SLOWEST_S = 2.0  # a turn that takes longer is dropped: the mirror stands
FASTEST_HZ = 60.0  # a capsule that spans more is not followed by the next one
FASTER = 1.5  # so much more than the capsule before may one span: if more, one between them was lost ...
STEPS = 8  # ... unless so many in a row say the same
EARLY = 0.25  # turns by which the host's clock may fall short of one that was lost
COVERAGE = 0.5  # share of its beams without which a turn is dropped


class _Beams(NamedTuple):
    """n samples in the order of time."""

    number: Ints  # (n,) how many were taken before
    turn: Array  # (n,) they belong to, 0: the one under way
    angle_q6: Array  # (n,) clockwise from ahead at the beginning of the turn under way [1/64 deg]
    range_mm: Array  # (n,)
    quality: Array  # (n,)

    def cut(self, begin: int, end: int) -> _Beams:
        """Some of them."""
        cut = slice(begin, end)
        return _Beams(
            self.number[cut], self.turn[cut], self.angle_q6[cut], self.range_mm[cut], self.quality[cut]
        )


class Decoder:
    """Bytes in any pieces in, turns out as soon as the bytes allow; never raises, memory is bounded.

    A turn begins where the sensor looks ahead, and its angle falls from 0 to -2 pi; near 0 it may lie beyond
    by what the sensor corrects. With another seam it begins there: from BEHIND it falls from pi to -pi, and
    what is ahead is in one piece. A packet is decoded when the next has come, which gives or proves its
    angles; a capsule in which a turn ends is not made to wait: it turns as fast as the one before it.
    `counts` tells all that came and all that was lost, since the beginning.
    """

    def __init__(self, mode: Mode, baud: int = 115_200, range_min: float = 0.05, seam: float = AHEAD) -> None:
        """`seam`: where a turn begins, clockwise from ahead [deg]. InputError for a mode not decoded (84)."""
        if mode.answer not in DECODED:
            refuse(mode, "a mode that answers 81, 82, 85 or 86")
        self.mode = mode
        self._range_min = range_min
        self._seam = round(64.0 * seam)  # [1/64 deg]; angles in here are from the seam on
        self._answer = Answer(mode.answer)
        size, self._n = LAYOUTS[self._answer][:2]
        period = max(mode.sample_us, 1.0) * 1e-6
        self._framer = Framer(mode.answer)
        # From the middle of a sample to its last byte: one more is filtered with it, then the packet is sent.
        self._time = BeamTime(period, 1.5 * period + 10.0 * size / baud)
        self._byte_s = self._n * period / size
        self._widest = FASTEST_HZ * self._n * period * TURN_Q6
        self._most = SLOWEST_S / period
        self._own = {"turns": 0, "turns_dropped": 0, "beams": 0, "beams_lost": 0, "silences": 0}
        self._received = -np.inf  # when the last bytes came
        self._last_t = -np.inf  # of the last beam given
        self._begin("")

    @property
    def counts(self) -> dict[str, int]:
        """Since the beginning: bytes, packets, turns, beams, and what was lost of each."""
        return {**self._framer.counts, **self._own}

    def _begin(self, why: str) -> None:
        """Nothing is known of what the next packet follows."""
        self._queue: list[Packets] = []  # not yet decoded; the first packet follows those that are
        self._queued, self._due = 0, False  # packets in it; whether it shall be decoded
        self._angle = 0  # of its first packet, unwrapped from the beginning of the turn under way [1/64 deg]
        self._number = 0  # of its first sample
        self._newest = 0  # angle of its last packet [1/64 deg]
        self._given = False  # whether it is decoded already
        self._step = np.nan  # angle from packet to packet [1/64 deg]
        self._recent: deque[int] = deque(maxlen=STEPS)  # the same of the newest, right or not
        self._pieces: list[_Beams] = []  # of the turn under way
        self._gaps = {0: 0}  # by turn, 0 the one under way: bytes thrown away where beams are missing
        self._why = why
        self._time.reset()

    def feed(self, data: bytes, received: float) -> list[Turn]:
        """Turns that are whole with these bytes, which came at `received` [s], a clock that does not jump."""
        if not data:
            return []
        silent = received - self._received
        if np.isfinite(silent) and abs(silent) > SILENCE_S:
            self._own["silences"] += 1
            self._own["turns_dropped"] += self._queued > 1 or len(self._pieces) > 0
            self._framer.reset()
            self._last_t = self._last_t if silent > 0.0 else -np.inf
            self._begin(f"silence of {silent:.1f} s" if silent > 0.0 else f"clock back by {-silent:.1f} s")
        elif silent > QUIET_S and len(data) * self._byte_s < 0.5 * silent:
            self._framer.reset()
        self._received = received
        packets = self._framer.feed(data)
        if not len(packets.rows):
            return []
        start = start_q6(self._answer, packets.rows) - self._seam
        start += TURN_Q6 * (start < 0)
        if not self._queue:
            self._newest = self._angle = int(start[0])
        passed = packets.apart.any() or (np.diff(start, prepend=self._newest) < 0).any()
        reaches = self._n > 1 and start[-1] + self._step >= TURN_Q6
        self._due = self._due or bool(passed or reaches) or self._long()
        self._queue.append(packets)
        self._queued += len(start)
        self._newest = int(start[-1])
        if self._due and (self._queued > 2 or np.isfinite(self._step)):
            return self._take()
        self._time.arrived(self._number + self._queued * self._n - 1, received)
        return []

    def _long(self) -> bool:
        """Whether the turn under way takes too long."""
        return self._queued * self._n + sum(len(piece.turn) for piece in self._pieces) > self._most

    def _take(self) -> list[Turn]:
        """Decode all packets but the newest, and that too where a turn ends in it; the turns whole then."""
        rows, lost, apart = (np.concatenate(column) for column in zip(*self._queue, strict=True))
        self._queue, self._queued, self._due = [Packets(rows[-1:], lost[-1:], apart[-1:])], 1, False
        samples = unpack(self._answer, rows)
        lost, apart = lost[1:], apart[1:]
        if self._answer != Answer.STANDARD:
            apart = apart | samples.first[1:]
        ahead = (np.diff(samples.start_q6) + BACK_Q6) % TURN_Q6 - BACK_Q6
        joined = self._joined(ahead, apart)
        steps = np.append(self._step, _filled(np.where(joined, ahead, np.nan), self._step))
        jump, missing = self._bridged(ahead, joined, steps[1:])
        angle = np.cumsum(np.append(self._angle, jump))
        number = np.cumsum(np.append(self._number, missing + self._n))
        self._note_gaps(angle, joined, lost)
        self._time.arrived(int(number[-1]) + self._n - 1, self._received)
        ends = (angle % TURN_Q6 + steps >= TURN_Q6) & (self._n > 1)  # not made to wait for its successor
        good = joined if self._answer == Answer.STANDARD else np.isfinite(steps[1:]) & (apart | (ahead > 0))
        good = np.append(good, False) | ends
        self._own["beams_lost"] += int(missing.sum()) + self._n * int(np.count_nonzero(~good[:-1]))
        good[0] &= not self._given
        step = np.where(ends, steps, np.append(steps[1:], np.nan))
        beams = self._beams(Samples._make(c[good] for c in samples), angle[good], step[good], number[good])
        self._angle, self._number = int(angle[-1]), int(number[-1])
        self._step, self._given = steps[-1], bool(ends[-1])
        return self._deal(beams, int(angle[-1] + (steps[-1] if ends[-1] else 0.0)) // TURN_Q6)

    def _joined(self, ahead: Ints, apart: Bools) -> Bools:
        """(m - 1,) whether each packet is followed by the next, m packets with steps `ahead` [1/64 deg]."""
        if self._answer == Answer.STANDARD:
            return ~apart
        joined = ~apart & (ahead > 0) & (ahead <= self._widest)
        step = (
            float(np.min(ahead, where=joined, initial=self._widest)) if np.isnan(self._step) else self._step
        )
        for i in np.flatnonzero(joined).tolist():
            self._recent.append(int(ahead[i]))
            usual = min(self._recent) if len(self._recent) == self._recent.maxlen else 0
            joined[i] = ahead[i] <= FASTER * max(step, usual)
            step = ahead[i] if joined[i] else step
        return joined

    def _bridged(self, ahead: Ints, joined: Bools, step: Array) -> tuple[Ints, Ints]:
        """For all packets but the newest: angle to the next [1/64 deg], samples missing in between.

        The host's clock knows how many turns were lost; it is rather late than early, as bytes are.
        """
        jump, missing = ahead.copy(), np.zeros(len(ahead), np.int64)
        newest = self._time.number(self._received)
        for i in np.flatnonzero(~joined).tolist():
            expected = self._number + (len(ahead) + 1) * self._n - 1 + int(missing.sum())
            late = 0.0 if newest is None else max(newest - expected, 0.0) / self._n  # [packets]
            if np.isnan(step[i]):
                jump[i] += TURN_Q6
                missing[i] = round(late) * self._n
            elif step[i] > 0.0:
                beyond = ahead[i] - step[i]
                jump[i] += TURN_Q6 * max(math.floor((late * step[i] - beyond) / TURN_Q6 + EARLY), 0)
                missing[i] = max(round((jump[i] - step[i]) / step[i]), 0) * self._n
        return jump, missing

    def _note_gaps(self, angle: Ints, joined: Bools, lost: Ints) -> None:
        """Remember in which turns beams are missing: the one a gap begins in, and the one it ends in."""
        for i in np.flatnonzero(~joined):
            for turn in {max(int(angle[i]) // TURN_Q6, 0), int(angle[i + 1]) // TURN_Q6}:
                self._gaps[turn] = self._gaps.get(turn, 0) + int(lost[i])

    def _beams(self, packets: Samples, angle: Ints, step: Array, number: Ints) -> _Beams:
        """All samples of packets whose start angle (m,), step (m,) and first number (m,) are known."""
        k = np.arange(self._n)
        even = angle[:, None] + step[:, None] * (k / self._n)
        turn = np.maximum.accumulate(np.maximum(np.floor(even.ravel() / TURN_Q6), 0.0))
        corrected = even - 64.0 * packets.offset_deg
        numbers: Ints = (number[:, None] + k).ravel()
        return _Beams(numbers, turn, corrected.ravel(), packets.range_mm.ravel(), packets.quality.ravel())

    def _deal(self, beams: _Beams, newest: int) -> list[Turn]:
        """Deal beams out to turns; those that are whole, where turn `newest` is under way now."""
        turns, under_way = [], 0
        edges = [0, *(np.flatnonzero(np.diff(beams.turn)) + 1), len(beams.turn)]
        for begin, end in pairwise(edges):
            if begin == end:
                break
            piece = beams.cut(int(begin), int(end))
            if piece.turn[0] > under_way:
                turns += self._end(under_way)
                under_way = int(piece.turn[0])
            self._pieces.append(piece)
        newest = max(newest, under_way)
        if newest > under_way:
            turns += self._end(under_way)
        self._angle -= newest * TURN_Q6
        self._gaps = {turn - newest: lost for turn, lost in self._gaps.items() if turn >= newest}
        self._pieces = [p._replace(angle_q6=p.angle_q6 - newest * TURN_Q6) for p in self._pieces]
        if self._long():
            self._pieces, self._gaps[0], self._why = [], 0, "the mirror hardly turned"
            self._own["turns_dropped"] += 1
        return turns

    def _end(self, turn: int) -> list[Turn]:
        """The turn that is whole now, or none where too much of it is missing."""
        pieces, self._pieces = self._pieces, []
        if not pieces:
            return []
        beams = _Beams._make(np.concatenate(column) for column in zip(*pieces, strict=True))
        n, faults = len(beams.turn), [self._why] if self._why else []
        if turn in self._gaps:
            swept, taken = beams.angle_q6[-1] - beams.angle_q6[0], beams.number[-1] - beams.number[0]
            whole = round(TURN_Q6 * taken / swept) if swept > 0.0 else 0
            if n < COVERAGE * whole or not whole:
                self._own["turns_dropped"] += 1
                return []
            if lost := self._gaps[turn]:
                faults.append(f"{lost} bytes were no samples")
            if n < whole:
                faults.append(f"about {whole - n} of {whole} beams lost")
        self._why = ""
        self._own["turns"] += 1
        self._own["beams"] += n
        first = TURN_Q6 - self._seam if self._seam else 0
        angle = np.deg2rad((first - (beams.angle_q6 - turn * TURN_Q6)) / 64.0)
        metres, quality = (beams.range_mm / 1000.0).astype(np.float32), beams.quality.astype(np.float32)
        limits = (self._range_min, self.mode.range_max, self._received)
        return [Turn(self._times(beams.number), angle, metres, quality, *limits, tuple(faults))]

    def _times(self, number: Ints) -> Array:
        """Times of samples (n,), later than all given before; squeezed where the offset came down."""
        t = self._time.at(number)
        if t[0] <= self._last_t:
            end = max(t[-1], self._last_t + self._time.period)
            t = np.linspace(self._last_t, end, len(t) + 1)[1:]
        self._last_t = float(t[-1])
        return t


def _filled(step: Array, before: float) -> Array:
    """(m,) each step that is not known taken from the one before it; the first from `before`."""
    known = np.append(np.isfinite(before), np.isfinite(step))
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), 0))
    filled: Array = np.append(before, step)[last][1:]
    return filled
