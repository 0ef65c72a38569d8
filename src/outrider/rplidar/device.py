"""A lidar on a serial port as a live source of turns: found, started, watched, and brought back.

The states and where they lead; whatever goes wrong in any of them is told once, as Trouble, and leads back
to the beginning after a short pause:

    find      a port that answers GET_INFO at one of the speeds   -> hello
    hello     its modes, and which of them is used                -> healthy
    healthy   GET_HEALTH; RESET where it has protected itself     -> motor
    motor     started                                             -> scanning
    scanning  bytes to the decoder, turns to who asked, until something is wrong

A sensor that falls silent, or sends bytes that make no turn, is begun again with; so is one that was
unplugged, that speaks another speed than before, or whose motor is blocked.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from serial import SerialTimeoutException

from outrider.errors import InputError
from outrider.records import Raw, Trouble, Turn
from outrider.rplidar import ports
from outrider.rplidar.decoder import BEHIND, Decoder
from outrider.rplidar.line import Line
from outrider.rplidar.models import BAUDS, choose, nearest_model
from outrider.rplidar.ports import AUTO, Listing, Setback
from outrider.rplidar.protocol import Answer, Command, Request, express_request

PAUSE_S = 0.1  # between two attempts
SPIN_UP_S = 5.0  # the first turn comes within this: a motor needs time
SILENCE_S = 1.0  # each further one within this: four turns of the slowest motor
HELD_S = 0.5  # the reader was not run for so long, or its clock was set: what waited in the port is old
PROTECTED = 2  # status of GET_HEALTH
ABOUT = (
    *("sensor", "port", "baud", "serial", "firmware", "health"),
    *("mode", "modes", "answer", "sample_us", "range_min", "range_max", "counts"),
)
LOST = (Setback, InputError, *ports.ERRORS)  # what may pass: begin again

Put = Callable[[Raw | Trouble | Turn], None]
State = Callable[[], "State"]


class Device:
    """One lidar; `about` tells which, and counts what came and what went wrong."""

    def __init__(
        self,
        port: str = AUTO,
        mode: str | None = None,
        *,
        clock: Callable[[], float],
        listing: Listing = ports.listed,
    ) -> None:
        """On a port by name, or whichever has one; `mode` by name, or the fastest that is decoded.

        `clock` gives the time of the host [s], which stamps all that is put; `listing` the ports there are.
        """
        self._told_of: dict[str, Any] = dict.fromkeys(ABOUT) | {
            "sensor": "RPLIDAR",
            "port": port,
            "mode": mode or AUTO,
            "counts": {},
        }
        self.about: Mapping[str, Any] = self._told_of  # its keys never change, so that any thread may read it
        self._port, self._wanted, self._clock, self._listing = port, mode, clock, listing
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._counts = {"connections": 0, "setbacks": 0, "held_up": 0}
        self._bauds: tuple[int, ...] = BAUDS
        self._line: Line | None = None
        self._decoder: Decoder | None = None
        self._told = ""  # the trouble that was told last; "" once a turn came

    def start(self, put: Put) -> None:
        """Begin to hand over turns, bytes and trouble from a thread of its own.

        Raises InputError where a port that was named is not there, may not be used or is no serial port.
        """
        if self._port != AUTO:
            try:
                ports.close(ports.opened(self._port, BAUDS[0]))
            except Setback as setback:
                raise InputError(str(setback)) from setback
        self._put = put
        self._thread = threading.Thread(target=self._run, name="rplidar", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread; the sensor is left at rest, its motor off. A second call does nothing."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()

    @property
    def finished(self) -> bool:
        """Whether the thread has ended, which it does only by `stop`."""
        return self._thread is not None and not self._thread.is_alive()

    def _run(self) -> None:
        """From state to state until the end."""
        state: State = self._find
        while not self._stopping.is_set():
            try:
                state = state()
            except LOST as error:
                if self._stopping.is_set():
                    break
                self._count("setbacks")
                self._tell(_words(self._line.port if self._line else self._port, error))
                self._let_go()
                self._stopping.wait(PAUSE_S)
                state = self._find
        self._let_go()
        self._count()

    # ------------------------------------------------------------------ states

    def _find(self) -> State:
        """A port that answers GET_INFO at one of the speeds."""
        candidates = [self._port] if self._port != AUTO else ports.candidates(self._listing)
        why = []
        for port in candidates:
            try:
                self._line = self._asked(port)
            except LOST as error:
                why.append(_words(port, error))
            else:
                return self._hello
        raise Setback("; ".join(why))

    def _asked(self, port: str) -> Line:
        """The line to a lidar that has said who it is; raises Setback where there is none."""
        heard = 0
        for baud in self._bauds:
            if self._stopping.is_set():
                break
            line = Line(port, baud)
            try:
                line.hush()
                self._info = line.info()
            except (Setback, InputError):
                heard += line.heard
                line.close()
            except BaseException:
                line.close()
                raise
            else:
                self._bauds = _between(baud)
                return line
        what = "what comes is no answer of a lidar" if heard else "nothing answers; power and cable?"
        raise Setback(f"{port}: {what} (asked at {', '.join(map(str, BAUDS))} baud)")

    def _hello(self) -> State:
        """Its modes, and which of them is used."""
        line, info = self._there(), self._info
        if self.about.get("serial") != info.serial:
            self._modes = line.modes(info)
        mode = choose(self._modes, self._wanted)
        if self._decoder is None or (mode, line.baud) != (self._decoder.mode, self.about["baud"]):
            if self._decoder is not None:
                self._counts = _sum(self._counts, self._decoder.counts)
            self._decoder = Decoder(mode, line.baud, nearest_model(info).range_min, BEHIND)
        self._told_of |= {
            "sensor": f"RPLIDAR {info.name}",
            "port": line.port,
            "baud": line.baud,
            "serial": info.serial,
            "firmware": "{}.{:02}".format(*info.firmware),
            "mode": mode.name,
            "modes": [mode.name for mode in self._modes],
            "answer": mode.answer,
            "sample_us": mode.sample_us,
            "range_min": nearest_model(info).range_min,
            "range_max": mode.range_max,
        }
        self._count()
        return self._healthy

    def _healthy(self) -> State:
        """Its health; one that has stopped to protect itself is reset."""
        line = self._there()
        health = line.health()
        if health.status >= PROTECTED:
            line.send(Request(Command.RESET))
            raise Setback(
                f"{line.port}: the lidar has stopped to protect itself (code {health.code:#06x}) "
                "and is reset; does something block its motor?"
            )
        self._told_of["health"] = f"warning {health.code:#06x}" if health.status else "good"
        return self._motor

    def _motor(self) -> State:
        """The motor is told to turn."""
        self._there().start_motor(self._info)
        return self._scanning

    def _scanning(self) -> State:
        """Bytes to the decoder, its turns to who asked, until something is wrong."""
        line, decoder = self._there(), self._decoder
        if decoder is None:
            return self._hello
        mode = decoder.mode
        request = Request(Command.SCAN) if mode.answer == Answer.STANDARD else express_request(mode.id)
        descriptor = line.ask(request, mode.answer).descriptor.pack()
        self._count("connections")
        at = last_turn = last_byte = self._clock()
        self._take(decoder, descriptor, at)
        patience = SPIN_UP_S
        while not self._stopping.is_set():
            data = line.read()
            before, at = at, self._clock()
            if abs(at - before) > HELD_S:
                line.discard()
                self._count("held_up")
                self._tell(f"this computer was held up, or its clock was set: {at - before:.1f} s were lost")
                last_turn = last_byte = at
                continue
            last_byte = at if data else last_byte
            if data and self._take(decoder, data, at):
                last_turn, patience = at, SILENCE_S
            if at - last_turn > patience:
                silent = at - last_byte > 0.5 * SILENCE_S
                what = "not one byte came" if silent else "what came made no turn; motor and cable?"
                raise Setback(f"{line.port}: for {at - last_turn:.1f} s {what}")
        return self._find

    # ------------------------------------------------------------------ said

    def _take(self, decoder: Decoder, data: bytes, at: float) -> bool:
        """Hand over bytes, and the turns they end; whether there were any."""
        self._put(Raw(at, data))
        turns = decoder.feed(data, at)
        for turn in turns:
            self._told = ""
            self._put(turn)
        if turns:
            self._count()
        return bool(turns)

    def _tell(self, words: str) -> None:
        """Trouble, unless it was told already and no turn came since."""
        if words != self._told:
            self._told = words
            self._put(Trouble(self._clock(), words))

    def _count(self, what: str = "") -> None:
        """Count something; show all counts."""
        if what:
            self._counts[what] += 1
        decoded = self._decoder.counts if self._decoder is not None else {}
        self._told_of["counts"] = _sum(self._counts, decoded)

    # ------------------------------------------------------------------ line

    def _there(self) -> Line:
        """The line; raises Setback where there is none."""
        if self._line is None:
            raise Setback(f"{self._port}: not connected")
        return self._line

    def _let_go(self) -> None:
        """Leave the sensor at rest and the port free."""
        line, self._line = self._line, None
        if line is not None:
            line.close()


def _words(port: str, error: BaseException) -> str:
    """What went wrong with a port, in one line."""
    if isinstance(error, Setback | InputError):
        return str(error)
    if isinstance(error, SerialTimeoutException):
        return f"{port}: takes no bytes; plug the lidar out and in again"
    return f"{port}: the lidar is gone; plug it in again"


def _between(known: int) -> tuple[int, ...]:
    """Speeds in the order they are tried: the known one before each other."""
    return tuple(baud for other in BAUDS if other != known for baud in (known, other))


def _sum(some: Mapping[str, int], more: Mapping[str, int]) -> dict[str, int]:
    """Counts by name, those of the same name added."""
    return {name: some.get(name, 0) + more.get(name, 0) for name in dict.fromkeys([*some, *more])}
