"""Who may look: by which name the page was asked for, from which page, and with which token.

A page on the rider's own machine answers to names of that machine alone, so that no site of the web can make
a browser fetch it under another name (DNS rebinding); whoever comes from elsewhere shows a token first.
"""

from __future__ import annotations

import ipaddress
import re
import secrets
import socket
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import urlsplit

HOST = re.compile(r"[A-Za-z0-9.:\[\]-]+")  # it goes into the policy below
TOKEN_LEAST = 12  # characters of a token that somebody chose
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self' {sockets}; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
    "Cache-Control": "no-cache",
}


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach what is bound to `host`, a name or an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


class Guard:
    """Decides on requests; `headers` below are those of ASGI, lower case names to text.

    host, port: what the page is bound to. token: what whoever comes must show once; "" for none.
    """

    def __init__(self, host: str, port: int, token: str) -> None:
        self._cookie = f"outrider-{port}"  # browsers keep them by host, not by port
        self._open = not is_loopback(host)
        self._names = {"localhost", host.lower()}
        if self._open:
            name = socket.gethostname().lower()
            self._names |= {name, f"{name}.local"}
        self._token = token.encode()
        self._session = secrets.token_urlsafe(32)

    def knows_host(self, headers: Mapping[str, str]) -> bool:
        """Whether the page was asked for by an address or a name of this machine."""
        host = headers.get("host", "")
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if not HOST.fullmatch(host):
            return False
        if name in self._names or name.rstrip(".") in self._names:
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        return self._open or address.is_loopback

    def own_page(self, headers: Mapping[str, str]) -> bool:
        """Whether a request comes from a page of this server, as its Origin says; a browser always says."""
        scheme, _, rest = headers.get("origin", "").partition("://")
        return scheme in ("http", "https") and bool(rest) and rest.lower() == headers.get("host", "").lower()

    def admits(self, headers: Mapping[str, str]) -> bool:
        """Whether the token has been shown, or none is asked for."""
        if not self._token:
            return True
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(self._cookie)
        except CookieError:
            return False
        return cookie is not None and secrets.compare_digest(cookie.value.encode(), self._session.encode())

    def session(self, token: bytes) -> str | None:
        """The Set-Cookie line for the right token, None for another; takes as long for any of one length."""
        if not (self._token and secrets.compare_digest(token, self._token)):
            return None
        return f"{self._cookie}={self._session}; HttpOnly; SameSite=Strict; Path=/"

    def answer_headers(self, headers: Mapping[str, str]) -> dict[str, str]:
        """What is sent with every answer; the host must be known."""
        host = headers["host"]
        return {**HEADERS, "Content-Security-Policy": POLICY.format(sockets=f"ws://{host} wss://{host}")}


def text_headers(scope: Mapping[str, Any]) -> dict[str, str]:
    """Headers of an ASGI request as text; of those sent twice, all but cookies are left out as unclear."""
    found: dict[str, str] = {}
    twice = set()
    for raw, value in scope["headers"]:
        name = raw.decode("latin-1")
        if name in found and name != "cookie":
            twice.add(name)
        found[name] = (
            f"{found[name]}; {value.decode('latin-1')}" if name in found else value.decode("latin-1")
        )
    return {name: value for name, value in found.items() if name not in twice}
