"""A live run for many pages: the newest picture wins, and no page can hold up the tracker or another page.

At most IN_FLIGHT pictures are on their way to a page; the next goes out when the page has taken one. What
comes meanwhile is dropped, and the page sees by the numbers how many that were. A word goes out every BEAT_S
in any case, so that a page knows the difference between a silent sensor and a connection that is gone.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Coroutine, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from outrider.live import Health, Shot
from outrider.live.page.message import hello, pack, picture
from outrider.settings import Settings

if TYPE_CHECKING:
    from starlette.websockets import WebSocket

IN_FLIGHT = 2
BEAT_S = 0.5
GONE = 1001  # WebSocket close code: the other side goes away


class _Newest(NamedTuple):
    number: int  # of the shot, from 1 on
    shot: Shot
    at: float  # when it came, monotonic clock [s]


class Feed:
    """Holds the newest shot; `put`, `tell` and `end` may be called from any thread and never wait."""

    def __init__(self, settings: Settings, about: Mapping[str, Any]) -> None:
        self._settings, self._about = settings, about
        self._newest: _Newest | None = None
        self._packed: tuple[int, bytes] = (0, b"")
        self._health = Health((), {})
        self._loop: asyncio.AbstractEventLoop | None = None
        self._wakes: set[asyncio.Event] = set()
        self._ended = False
        self.sent = self.dropped = 0  # pictures, over all pages

    def put(self, shot: Shot) -> None:
        """A new picture; whatever a page has not fetched yet is lost."""
        number = self._newest.number + 1 if self._newest else 1
        self._newest, self._health = _Newest(number, shot, time.monotonic()), shot.health
        self._wake()

    def tell(self, health: Health) -> None:
        """How far the last picture can be trusted now."""
        self._health = health
        self._wake()

    def end(self) -> None:
        """Say goodbye to every page."""
        self._ended = True
        self._wake()

    def _wake(self) -> None:
        if self._loop is not None and self._wakes:
            with suppress(RuntimeError):  # the loop has just been closed
                self._loop.call_soon_threadsafe(self._ring)

    def _ring(self) -> None:
        for wake in self._wakes:
            wake.set()

    def data(self, name: str, query: Mapping[str, str]) -> bytes | None:
        """Nothing: all there is comes by itself."""
        return None

    async def serve(self, socket: WebSocket) -> None:
        """Send what is newest to one page until it goes away or the run ends."""
        self._loop = asyncio.get_running_loop()
        page = _Page(socket)
        self._wakes.add(page.wake)
        try:
            await socket.send_text(hello(self._settings, self._about, mode="live").decode())
            await _first(self._send(page), page.listen())
        finally:
            self._wakes.discard(page.wake)

    async def _send(self, page: _Page) -> None:
        beat, told = 0.0, self._health
        while not self._ended:
            now = time.monotonic()
            if now >= beat or told is not self._health:
                beat, told = now + BEAT_S, self._health
                await page.socket.send_text(self._beat(page, now))
            newest = self._newest
            if newest and newest.number > page.number and len(page.flying) < IN_FLIGHT:
                await self._give(page, newest)
                continue
            with suppress(TimeoutError):
                async with asyncio.timeout(max(beat - time.monotonic(), 0.0)):
                    await page.wake.wait()
            page.wake.clear()
        await page.socket.close(GONE, "outrider has ended")

    async def _give(self, page: _Page, newest: _Newest) -> None:
        if self._packed[0] != newest.number:
            late = time.monotonic() - newest.at + newest.shot.decided - newest.shot.last_beam
            shown = pack(picture(newest.shot.frame), number=newest.number, late=late)
            self._packed = (newest.number, shown)
        self.sent += 1
        self.dropped += newest.number - page.number - 1 if page.number else 0
        page.number = newest.number
        page.flying.append(time.monotonic())
        await page.socket.send_bytes(self._packed[1])

    def _beat(self, page: _Page, now: float) -> str:
        """How old the newest picture is, how slow the connection is, and what is wrong."""
        age = now - self._newest.at if self._newest else None
        lag = max(page.lag, now - page.flying[0]) if page.flying else page.lag
        told = {
            "age": age,
            "lag": lag,
            "degraded": self._health.degraded,
            "counts": dict(self._health.counts),
        }
        return msgspec.json.encode(told, enc_hook=float).decode()


class _Page:
    """One browser."""

    def __init__(self, socket: WebSocket) -> None:
        self.socket, self.wake = socket, asyncio.Event()
        self.number = 0  # of the last picture sent
        self.flying: deque[float] = deque()  # when those not taken yet were sent, monotonic clock [s]
        self.lag = 0.0  # of the last one taken, there and back [s]

    async def listen(self) -> None:
        """Every message says that one picture was taken."""
        while True:
            await self.socket.receive_text()
            if self.flying:
                self.lag = time.monotonic() - self.flying.popleft()
            self.wake.set()


async def _first(*jobs: Coroutine[Any, Any, None]) -> None:
    """Run jobs until the first one ends; its exception is raised, the others are cancelled."""
    tasks = [asyncio.ensure_future(job) for job in jobs]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
