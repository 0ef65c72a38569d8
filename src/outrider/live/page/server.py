"""A small web server in a thread of its own, and the page as a sink of a live run."""

from __future__ import annotations

import secrets
import socket
import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from outrider.errors import InputError
from outrider.live import Health, Shot, Silent
from outrider.live.page.feed import Feed
from outrider.live.page.guard import TOKEN_LEAST, Guard, is_loopback
from outrider.settings import Settings

if TYPE_CHECKING:
    from outrider.live.page.app import Show

HOST, PORT = "127.0.0.1", 8642
PAGES = 8  # open at a time
MESSAGE_BYTES = 256  # a page that sends more in one message is closed
CONNECTIONS = 64
PING_S = 5.0  # a page that does not answer for as long is closed


def address(text: str) -> tuple[str, int]:
    """Host and port of "", "PORT", "HOST", "HOST:PORT" or "[HOST]:PORT"; InputError for anything else."""
    host, _, port = text.rpartition(":") if ":" in text and not text.endswith("]") else ("", "", "")
    if not port:
        host, port = ("", text) if text.isascii() and text.isdigit() else (text, str(PORT))
    host = host.removeprefix("[").removesuffix("]") or HOST
    if not (port.isascii() and port.isdigit() and 0 <= int(port) <= 65535) or set(host) & set("/ @?#"):
        raise InputError(f"page address {text!r}: want HOST:PORT, such as {HOST}:{PORT} or 0.0.0.0:{PORT}")
    return host, int(port)


class Server:
    """Serves a show until `close`; bound when made, so that what is wrong with the address is told at once.

    token: what a page must show; "" asks for none on an address that only this machine can reach, and makes
    one up on any other. Raises InputError for an address that cannot be had.
    """

    def __init__(self, show: Show, host: str = HOST, port: int = PORT, token: str = "", most: int = PAGES):
        import uvicorn

        from outrider.live.page.app import App

        if token and (len(token) < TOKEN_LEAST or not (token.isascii() and token.isprintable())):
            raise InputError(
                f"page token of {len(token)} characters; want {TOKEN_LEAST} or more, plain ASCII"
            )
        if not token and not is_loopback(host):
            token = secrets.token_urlsafe(12)
        self._socket = _bind(host, port)
        self._host, self.port, self._token = host, self._socket.getsockname()[1], token
        self.app = App(show, Guard(host, self.port, token), most)
        config: dict[str, Any] = {
            "log_config": None, "access_log": False, "lifespan": "off", "server_header": False,
            "http": "h11", "ws": "websockets-sansio", "loop": "asyncio", "proxy_headers": False,
            "ws_max_size": MESSAGE_BYTES, "ws_per_message_deflate": False, "ws_ping_interval": PING_S,
            "ws_ping_timeout": PING_S, "limit_concurrency": CONNECTIONS, "timeout_graceful_shutdown": 1,
        }  # fmt: skip
        self._uvicorn = uvicorn.Server(uvicorn.Config(self.app, **config))
        self._thread = threading.Thread(
            target=self._uvicorn.run, args=([self._socket],), name="page", daemon=True
        )
        self._thread.start()

    @property
    def url(self) -> str:
        """What to type into a browser; a token stands behind the #, which browsers keep to themselves."""
        host = _reached_at() if self._host in ("0.0.0.0", "::") else self._host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/" + (f"#{self._token}" if self._token else "")

    def wait(self) -> None:
        """Return when the server has ended, which it does not by itself; Ctrl-C is raised here."""
        while self._thread.is_alive():
            self._thread.join(0.2)

    def close(self) -> None:
        """End all connections and the thread; a second call does nothing."""
        self._uvicorn.should_exit = True
        self._thread.join(5.0)
        self._socket.close()


def _bind(host: str, port: int) -> socket.socket:
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        bound = socket.socket(family, kind, protocol)
    except OSError as error:
        raise InputError(
            f"page on {host}: no such address ({error.strerror}); try {HOST} or 0.0.0.0"
        ) from error
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind(place)
        bound.listen()
    except OSError as error:
        bound.close()
        other = f"{HOST}:{port % 65535 + 1}"
        raise InputError(f"page on {host}:{port}: {error.strerror}; name another, such as {other}") from error
    return bound


def _reached_at() -> str:
    """The address under which others most likely reach this machine; nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # kept free for documentation: routed like any far address
        except OSError:
            return socket.gethostname()
        return str(probe.getsockname()[0])


class PageSink(Silent):
    """Shows a live run to browsers; see `Server` for the arguments. about: what is told of the source."""

    def __init__(
        self,
        settings: Settings,
        host: str = HOST,
        port: int = PORT,
        token: str = "",
        about: Mapping[str, Any] | None = None,
        most: int = PAGES,
    ) -> None:
        super().__init__()
        self._feed = Feed(settings, about or {})
        self._server = Server(self._feed, host, port, token, most)

    @property
    def url(self) -> str:
        """What to type into a browser."""
        return self._server.url

    def shot(self, shot: Shot) -> None:
        """The newest picture; pages fetch it as fast as they can, one picture is all that is kept."""
        self._feed.put(shot)

    def health(self, health: Health) -> None:
        """What is wrong while no turn comes."""
        self._feed.tell(health)

    def close(self) -> None:
        """Tell the pages that the run has ended; the server stops."""
        self._feed.end()
        self._server.close()

    @property
    def report(self) -> Mapping[str, Any]:
        """Where it is, pages open now, pictures sent and dropped over all pages."""
        return {
            "url": self.url.partition("#")[0],
            "pages": self._server.app.pages,
            "sent": self._feed.sent,
            "dropped": self._feed.dropped,
        }
