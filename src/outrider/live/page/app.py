"""The page's HTTP and WebSocket side: files, the token, and the pictures of a show, each after the guard."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, MutableMapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from outrider.live.page.guard import Guard, text_headers

STATIC = Path(__file__).parent / "static"
TOKEN_BYTES = 256  # a longer body is not read
PATIENCE_S, GUESSERS = 0.5, 8  # a wrong token is answered one at a time, so late; more wait not at all
FULL = 1013  # WebSocket close code: try again later


class Show(Protocol):
    """What is shown on the page."""

    async def serve(self, socket: WebSocket) -> None:
        """Send pictures to one page that was let in, until it goes away or the show ends."""

    def data(self, name: str, query: Mapping[str, str]) -> bytes | None:
        """Something large that is asked for once, by name; None where there is no such thing."""


class App:
    """An ASGI application that shows `show` to at most `most` pages at a time."""

    def __init__(self, show: Show, guard: Guard, most: int) -> None:
        self._show, self._guard, self._most = show, guard, most
        self.pages = 0  # open now
        self._slow, self._guessers = asyncio.Lock(), 0
        self._routes = Starlette(
            routes=[
                Route("/session", self._session),
                Route("/enter", self._enter, methods=["POST"]),
                Route("/data/{name}", self._data),
                WebSocketRoute("/pictures", self._pictures),
                Mount("/", StaticFiles(directory=STATIC, html=True)),
            ]
        )

    async def __call__(self, scope: MutableMapping[str, Any], receive: Any, send: Any) -> None:
        """One request; its host is judged first, and the headers for safety go with every answer."""
        headers = text_headers(scope)
        if not self._guard.knows_host(headers):
            refusal = PlainTextResponse("unknown host name; ask by the address that outrider printed", 421)
            return await _refuse(scope, receive, send, refusal)
        extra = [(k.lower().encode(), v.encode()) for k, v in self._guard.answer_headers(headers).items()]

        async def safe(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *extra]
            await send(message)

        return await self._routes(scope, receive, safe)

    async def _session(self, request: Request) -> Response:
        """Whether this browser has been let in."""
        return JSONResponse({"admitted": self._guard.admits(text_headers(request.scope))})

    async def _enter(self, request: Request) -> Response:
        """The token for a session; a wrong one is answered slowly, and one at a time."""
        if not self._guard.own_page(text_headers(request.scope)):
            return PlainTextResponse("not from this page", 403)
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > TOKEN_BYTES:
                return PlainTextResponse("too long for a token", 413)
        cookie = self._guard.session(body)
        if cookie:
            return Response(status_code=204, headers={"Set-Cookie": cookie})
        if self._guessers >= GUESSERS:
            return PlainTextResponse("too many wrong tokens at once", 429)
        self._guessers += 1
        try:
            async with self._slow:
                await asyncio.sleep(PATIENCE_S)
        finally:
            self._guessers -= 1
        return PlainTextResponse("wrong token", 403)

    async def _data(self, request: Request) -> Response:
        if not self._guard.admits(text_headers(request.scope)):
            return PlainTextResponse("token wanted", 401)
        loop = asyncio.get_running_loop()
        name, query = request.path_params["name"], dict(request.query_params)
        content = await loop.run_in_executor(None, self._show.data, name, query)
        if content is None:
            return PlainTextResponse("no such thing", 404)
        return Response(content, media_type="application/octet-stream")

    async def _pictures(self, socket: WebSocket) -> None:
        headers = text_headers(socket.scope)
        if not self._guard.own_page(headers):
            return await socket.send_denial_response(PlainTextResponse("not from this page", 403))
        if not self._guard.admits(headers):
            return await socket.send_denial_response(PlainTextResponse("token wanted", 401))
        await socket.accept()
        if self.pages >= self._most:
            return await socket.close(FULL, f"{self._most} pages are open already; close one of them")
        self.pages += 1
        try:
            with suppress(WebSocketDisconnect, OSError):
                await self._show.serve(socket)
        finally:
            self.pages -= 1
        return None


async def _refuse(scope: MutableMapping[str, Any], receive: Any, send: Any, refusal: Response) -> None:
    """Send an answer to a request that no route has seen, in either of two protocols."""
    if scope["type"] == "websocket":
        await WebSocket(scope, receive, send).send_denial_response(refusal)
    else:
        await refusal(scope, receive, send)
