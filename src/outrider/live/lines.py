"""For other programs: a line of JSON a frame, to whoever connects to a TCP or Unix socket (docs/live.md)."""

from __future__ import annotations

import errno
import selectors
import socket
import threading
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from outrider.errors import InputError
from outrider.live import Health, Raw, Shot
from outrider.records import Array, TrackState

SCHEMA = 1  # of the lines; grows when a key changes its meaning
MOST_CLIENTS = 16
MOST_LINES = 8  # waiting for one client; of more, the oldest are dropped
SEND_BUFFER = 1 << 14  # bytes that the system may hold back for one client: more would be old news
WAIT_S = 0.2


class _Client:
    """One connection: the line that is being sent, and those that wait."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.waiting: deque[bytes] = deque()
        self.sending = b""

    def add(self, line: bytes) -> int:
        """One more line; how many were dropped for it."""
        self.waiting.append(line)
        if len(self.waiting) <= MOST_LINES:
            return 0
        self.waiting.popleft()
        return 1

    def send(self) -> None:
        """As much as the connection takes now; OSError where it is gone."""
        while self.sending or self.waiting:
            if not self.sending:
                self.sending = self.waiting.popleft()
            try:
                self.sending = self.sending[self.connection.send(self.sending) :]
            except BlockingIOError:
                return


class Lines:
    """Sink that serves lines; a client that reads too slowly misses the oldest, and no one waits for it."""

    def __init__(self, address: str) -> None:
        """Listen at tcp://HOST:PORT or unix://PATH; InputError where that cannot be."""
        self._path = _path(address)
        self._listener = _listen(address, self._path)
        self._where = address if self._path else _found(self._listener)
        self._lock = threading.Lock()  # over the clients
        self._clients: dict[socket.socket, _Client] = {}
        self._counts = {"lines": 0, "clients": 0, "refused": 0, "dropped": 0}
        self._woken, self._waker = socket.socketpair()
        for end in (self._woken, self._waker, self._listener):
            end.setblocking(False)
        self._closing = False
        self._thread = threading.Thread(target=self._serve, name="lines", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Where it listens, with the port that was found for port 0."""
        return self._where

    def shot(self, shot: Shot) -> None:
        """One line a frame, while somebody listens."""
        if self._clients:
            self._tell(frame_line(shot))

    def raw(self, raw: Raw) -> None:
        """Nothing."""

    def health(self, health: Health) -> None:
        """One line that says why the last frame cannot be trusted any more."""
        if self._clients:
            self._tell({"schema": SCHEMA, "kind": "health", "degraded": health.degraded})

    def close(self) -> None:
        """Hang up. A second call does nothing."""
        self._closing = True
        self._wake()
        self._thread.join()

    @property
    def report(self) -> Mapping[str, Any]:
        """Lines told, clients that came or were refused, and lines they were too slow for."""
        return {"address": self._where, **self._counts}

    def _tell(self, line: dict[str, Any]) -> None:
        data = msgspec.json.encode(line) + b"\n"
        with self._lock:
            self._counts["lines"] += 1
            for client in self._clients.values():
                self._counts["dropped"] += client.add(data)
        self._wake()

    def _wake(self) -> None:
        with suppress(OSError):  # full: it is awake already; closed: it sleeps for ever
            self._waker.send(b"x")

    # ------------------------------------------------------------------ the thread

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._listener, selectors.EVENT_READ, self._accept)
            selector.register(self._woken, selectors.EVENT_READ, self._awake)
            while not self._closing:
                for key, _ in selector.select(WAIT_S):
                    key.data(selector, key.fileobj)
                self._send(selector)
        for end in (*self._clients, self._listener, self._woken, self._waker):
            end.close()
        self._clients.clear()
        if self._path is not None:
            self._path.unlink(missing_ok=True)

    def _accept(self, selector: selectors.BaseSelector, _: socket.socket) -> None:
        """One client more; one too many is hung up on."""
        with suppress(OSError):
            connection, _ = self._listener.accept()
            if len(self._clients) >= MOST_CLIENTS:
                connection.close()
                self._counts["refused"] += 1
                return
            connection.setblocking(False)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            with self._lock:
                self._clients[connection] = _Client(connection)
            selector.register(connection, selectors.EVENT_READ, self._hear)
            self._counts["clients"] += 1

    def _awake(self, selector: selectors.BaseSelector, _: socket.socket) -> None:
        with suppress(OSError):
            self._woken.recv(4096)

    def _hear(self, selector: selectors.BaseSelector, connection: socket.socket) -> None:
        """What a client says is thrown away; one that has hung up is forgotten."""
        try:
            if connection.recv(4096):
                return
        except BlockingIOError:
            return
        except OSError:
            pass
        self._forget(selector, connection)

    def _send(self, selector: selectors.BaseSelector) -> None:
        """What the clients take now; those that take no more are asked again when they do."""
        for connection, client in list(self._clients.items()):
            try:
                with self._lock:
                    client.send()
            except OSError:
                self._forget(selector, connection)
                continue
            wants = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.sending else 0)
            selector.modify(connection, wants, self._hear)

    def _forget(self, selector: selectors.BaseSelector, connection: socket.socket) -> None:
        selector.unregister(connection)
        with self._lock:
            del self._clients[connection]
        connection.close()


# ------------------------------------------------------------------ what a line says


def frame_line(shot: Shot) -> dict[str, Any]:
    """A frame as one line tells it, in plain numbers; None for what is infinite or not known."""
    frame, alert = shot.frame, shot.frame.alert
    tracks, threats = frame.tracks, frame.threats
    columns = {
        "id": tracks.id.tolist(),
        "state": [TrackState(state).name.lower() for state in tracks.state],
        "x_m": _numbers(tracks.W_p[:, 0]),
        "y_m": _numbers(tracks.W_p[:, 1]),
        "yaw_rad": _numbers(tracks.yaw),
        "course_rad": _numbers(tracks.course),
        "speed_mps": _numbers(tracks.speed),
        "acceleration_mps2": _numbers(tracks.acceleration),
        "yaw_rate_radps": _numbers(tracks.yaw_rate),
        "length_m": _numbers(tracks.extent[:, 0]),
        "width_m": _numbers(tracks.extent[:, 1]),
        "ttc_s": _numbers(threats.ttc),
        "closest_m": _numbers(threats.closest_distance),
        "position_bound_m": _numbers(tracks.bound[:, 0]),
    }
    return {
        "schema": SCHEMA,
        "kind": "frame",
        "t": frame.t,
        "level": alert.level.name.lower(),
        "track": alert.track if alert.track >= 0 else None,
        "ttc_s": _numbers(np.array([alert.ttc]))[0],
        "degraded": shot.health.degraded,
        "last_beam": shot.last_beam,
        "decided": shot.decided,
        "rider": dict(zip(("x_m", "y_m", "yaw_rad"), _numbers(frame.scan.ego.W_pose), strict=True)),
        "tracks": [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)],
    }


def _numbers(values: Array) -> list[float | None]:
    """Of an array (n,): rounded to what can matter; None for what is not finite."""
    return [round(value, 4) if np.isfinite(value) else None for value in values.tolist()]


# ------------------------------------------------------------------ where it listens


def _path(address: str) -> Path | None:
    return Path(address.removeprefix("unix://")) if address.startswith("unix://") else None


def _found(listener: socket.socket) -> str:
    host, port = listener.getsockname()[:2]
    return f"tcp://[{host}]:{port}" if ":" in host else f"tcp://{host}:{port}"


def _listen(address: str, path: Path | None) -> socket.socket:
    """A listening socket; a Unix socket that nobody listens at any more is replaced."""
    try:
        if path is not None:
            return _listen_unix(path)
        host, _, port = address.removeprefix("tcp://").rpartition(":")
        if not address.startswith("tcp://") or not host or not port.isdigit() or int(port) > 65535:
            raise InputError(f"--lines {address}: want tcp://HOST:PORT or unix://PATH")
        host = host.strip("[]")
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, int(port)), family=family)
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"--lines {address}: cannot listen there ({reason}); choose another") from error


def _listen_unix(path: Path) -> socket.socket:
    if not hasattr(socket, "AF_UNIX"):
        raise OSError(errno.EAFNOSUPPORT, "no Unix sockets here")
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        if path.is_socket():
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe, suppress(ConnectionRefusedError):
                probe.connect(str(path))
                raise OSError(errno.EADDRINUSE, "another program listens there")
            path.unlink()
        listener.bind(str(path))
        listener.listen(MOST_CLIENTS)
    except OSError:
        listener.close()
        raise
    return listener
