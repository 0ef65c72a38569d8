"""A stream of bytes to whole packets: finds where they begin, and finds it again after anything.

Never raises, whatever the bytes are. What is kept between two calls is bounded by what is needed to find the
beginning of a packet again: RUN samples of the standard answer, or one capsule.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from outrider.records import Bools, Bytes, Ints
from outrider.rplidar.capsules import LAYOUTS, TURN_Q6, start_q6, whole
from outrider.rplidar.protocol import Answer, Descriptor

RUN = 8  # samples of the standard answer that must follow each other before the first is believed
BACK_Q6, AHEAD_Q6 = 10 * 64, 20 * 64  # how far off the angle of the next one may lie [1/64 deg]


class Packets(NamedTuple):
    """m whole packets in the order they came."""

    rows: Bytes  # (m, size)
    lost: Ints  # (m,) bytes thrown away between the packet before and this one
    apart: Bools  # (m,) something is missing before it: bytes were thrown away, or the stream began anew


class Framer:
    """Bytes in any pieces in, whole packets out; how they were cut changes nothing."""

    def __init__(self, answer: int) -> None:
        self._answer = Answer(answer)
        self._size = LAYOUTS[self._answer].size
        self._proof = RUN * self._size if self._answer == Answer.STANDARD else self._size
        self._head = Descriptor(self._size, True, self._answer).pack()
        self.counts = {"bytes": 0, "bytes_dropped": 0, "packets": 0, "starts": 0}
        self._rest = b""
        self._inside = False  # the next packet begins where the last one ended
        self._before: int | None = None  # angle of that one [1/64 deg]; None where it follows none
        self._lost, self._apart = 0, True  # since the last packet given

    def reset(self) -> None:
        """What comes next follows nothing; bytes still kept count as dropped."""
        self._drop(len(self._rest))
        self._rest, self._inside, self._apart = b"", False, True

    def feed(self, data: bytes) -> Packets:
        """Packets that are whole with these bytes."""
        self.counts["bytes"] += len(data)
        a = np.frombuffer(self._rest + data, np.uint8)
        at, runs = 0, []
        places: Ints | None = None
        while True:
            if not self._inside:
                places = self._places(a) if places is None else places
                at = self._search(a, at, places)
            if not self._inside:
                break
            run = self._run(a, at, self._before)
            if len(run):
                runs.append(self._given(run))
                self._before = int(start_q6(self._answer, run[-1:])[0])
            at += len(run) * self._size
            if len(a) - at < self._size:
                break
            self._inside, self._apart = False, True  # there is one more, and it does not follow
        self._rest = a[at:].tobytes()
        if not runs:
            return self._given(np.zeros((0, self._size), np.uint8))
        return Packets(*(np.concatenate(column) for column in zip(*runs, strict=True)))

    def _given(self, run: Bytes) -> Packets:
        """Packets of which each follows the one before, and what lies before the first."""
        m = len(run)
        lost, apart = np.zeros(m, np.int64), np.zeros(m, bool)
        if m:
            lost[0], apart[0] = self._lost, self._apart
            self._lost, self._apart = 0, False
        self.counts["packets"] += m
        return Packets(run, lost, apart)

    def _run(self, a: Bytes, at: int, before: int | None) -> Bytes:
        """The good packets from a place on, as far as each follows the one before; the first: `before`."""
        m = (len(a) - at) // self._size
        rows = a[at : at + m * self._size].reshape(m, self._size)
        good = whole(self._answer, rows)
        if self._answer == Answer.STANDARD and m:
            angle = start_q6(self._answer, rows)
            good &= _near(np.append(angle[0] if before is None else before, angle[:-1]), angle)
        return rows if good.all() else rows[: int(np.argmin(good))]

    def _places(self, a: Bytes) -> Ints:
        """Where a packet or the descriptor may begin, as far as the bytes there have come."""
        may = _may_begin_run(a) if self._answer == Answer.STANDARD else _may_begin_capsule(a)
        return np.flatnonzero(may | _may_begin_with(a, self._head))

    def _search(self, a: Bytes, at: int, places: Ints) -> int:
        """Where the next packet begins, or where to go on searching once there are more bytes."""
        for place in places[np.searchsorted(places, at) :].tolist():
            there = a[place : place + self._proof].tobytes()
            if self._head.startswith(there[: len(self._head)]):
                self._drop(place - at)
                if len(there) < len(self._head):
                    return int(place)
                self.counts["starts"] += 1
                self._inside, self._before, self._apart = True, None, True
                return int(place) + len(self._head)
            if (
                len(self._run(a[: place + self._proof], place, None))
                == len(there[: self._proof]) // self._size
            ):
                self._drop(place - at)
                self._inside, self._before = len(there) >= self._proof, None
                return int(place)
        self._drop(len(a) - at)
        return len(a)

    def _drop(self, count: int) -> None:
        if count:
            self.counts["bytes_dropped"] += count
            self._lost += count
            self._apart = True


def _near(before: Ints, after: Ints) -> Bools:
    """Whether an angle lies where that of the next sample may."""
    near: Bools = (after - before + BACK_Q6) % TURN_Q6 <= BACK_Q6 + AHEAD_Q6
    return near


def _may_begin_with(a: Bytes, head: bytes) -> Bools:
    """(n,) places where the first two bytes are those of `head`, as far as they have come."""
    may: Bools = a == head[0]
    may[:-1] &= a[1:] == head[1]
    return may


def _may_begin_capsule(a: Bytes) -> Bools:
    """(n,) places where the marks of a capsule stand, as far as they have come."""
    may: Bools = a >> 4 == 0xA
    may[:-1] &= a[1:] >> 4 == 0x5
    return may


def _may_begin_run(a: Bytes) -> Bools:
    """(n,) places where RUN standard samples begin that follow each other, as far as they have come."""
    flags = a & 3
    node: Bools = (flags == 1) | (flags == 2)
    node[:-1] &= a[1:] & 1 == 1
    angle = (a[1:-1].astype(np.int64) | a[2:].astype(np.int64) << 8) >> 1
    node[:-2] &= angle <= TURN_Q6
    linked = node.copy()
    linked[: max(len(a) - 7, 0)] &= _near(angle[:-5], angle[5:])
    may = linked.copy()
    for i in range(1, RUN):
        may[: -5 * i] &= (linked if i < RUN - 1 else node)[5 * i :]
    return may
