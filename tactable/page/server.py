"""Browsers to a show and back: the files of the page, one WebSocket a browser, nothing that waits for a slow one."""

import asyncio
import contextlib
import socket
import time
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from engine.touch.sources.pointer import PointerEvent
from tactable.page.messages import (
    MOST_BYTES,
    CloseCode,
    Kind,
    PageMessageError,
    decode_message,
    encode_scene,
)
from tactable.page.security import HEADERS, Door

FRAME_S = 1 / 60
IDLE_FRAMES = 12
"""While nothing happens, only one picture of so many is sent."""
ALONE_S = 0.1
"""While nobody looks on, time passes in such steps."""
MOST_BROWSERS = 8
_STATIC = Path(__file__).parent / "static"
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_GRACE_S = 1


class Show(Protocol):
    """What is shown, and what its viewers may do to it."""

    scene_number: int
    """Another one whenever the scene is."""

    def scene(self) -> dict[str, Any]:
        """What changes seldom, for JSON."""

    def tick(self) -> tuple[list[bytes], bool]:
        """Let time pass: messages for all, and whether anything happens."""

    def touch(self, browser: int, events: Sequence[PointerEvent]) -> None:
        """Pointers of a browser."""

    def leave(self, browser: int) -> None:
        """A browser is gone, and its pointers with it."""

    def choose(self, switches: dict[str, Any]) -> None:
        """Somebody moved switches."""

    def sound(self, finger: int) -> bytes | None:
        """What a finger felt, as a message."""

    async def run(self) -> None:
        """What it needs to do beside, until it is cancelled."""


class _Browser:
    """What one browser is to be told: of each kind the newest."""

    def __init__(self, socket_: WebSocket) -> None:
        self._socket = socket_
        self._news: dict[int, bytes] = {}
        self._has_news = asyncio.Event()

    def offer(self, message: bytes) -> None:
        """In place of an older one of its kind that is not sent yet."""
        self._news[message[1]] = message
        self._has_news.set()

    async def send(self) -> None:
        """As fast as it takes them."""
        while True:
            await self._has_news.wait()
            self._has_news.clear()
            for kind in Kind:
                message = self._news.pop(kind, None)
                if message is not None:
                    await self._socket.send_bytes(message)


class PageServer:
    """One show behind one door, for any number of browsers up to MOST_BROWSERS."""

    def __init__(self, show: Show, door: Door) -> None:
        self.show, self.door = show, door
        self._browsers: dict[int, _Browser] = {}
        self._opened = 0
        self._files = {path.name: path.read_bytes() for path in _STATIC.iterdir() if path.suffix in _TYPES}
        routes = [
            Route("/{token}/", self._answer_file),
            Route("/{token}/{name}", self._answer_file),
            WebSocketRoute("/{token}/socket", self._answer_socket),
        ]
        self.app = Starlette(routes=routes, exception_handlers={404: _refused, 405: _refused})

    async def _answer_file(self, request: Request) -> Response:
        token, name = request.path_params["token"], request.path_params.get("name", "index.html")
        if not self.door.admits_host(request.headers.get("host")) or not self.door.knows(token):
            return await _refused(request, None)
        content = self._files.get(name)
        if content is None:
            return Response("there is no such file\n", 404, HEADERS)
        return Response(content, 200, HEADERS, media_type=_TYPES[Path(name).suffix])

    async def _answer_socket(self, socket_: WebSocket) -> None:
        headers = socket_.headers
        is_ours = self.door.admits_origin(headers.get("origin"), headers.get("host"))
        if not is_ours or not self.door.knows(socket_.path_params["token"]):
            await socket_.close()  # before it is accepted: 403
            return
        await socket_.accept()
        if len(self._browsers) >= MOST_BROWSERS:
            await socket_.close(CloseCode.CROWDED, f"{MOST_BROWSERS} browsers look on already")
            return
        await self._serve(socket_)

    async def _serve(self, socket_: WebSocket) -> None:
        self._opened += 1
        number, browser = self._opened, _Browser(socket_)
        browser.offer(encode_scene(self.show.scene()))
        self._browsers[number] = browser
        sender = asyncio.create_task(browser.send())
        try:
            await self._listen(number, socket_, browser)
        except PageMessageError as error:
            await socket_.close(error.code, str(error)[:100])
        except WebSocketDisconnect:
            pass
        finally:
            del self._browsers[number]
            self.show.leave(number)
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sender

    async def _listen(self, number: int, socket_: WebSocket, browser: _Browser) -> None:
        while True:
            message = await socket_.receive()
            if message["type"] == "websocket.disconnect":
                return
            data = message.get("bytes")
            if data is None:
                raise PageMessageError(CloseCode.NOT_BINARY, "a message of text; expected bytes")
            asked = decode_message(data)
            if isinstance(asked, tuple):
                self.show.touch(number, asked)
            elif isinstance(asked, dict):
                self.show.choose(asked)
            elif (sound := self.show.sound(asked)) is not None:
                browser.offer(sound)

    async def broadcast(self) -> None:
        """Let the show go on, and tell all browsers, until it is cancelled."""
        scene_number, idle, due_s = self.show.scene_number, 0, time.monotonic()
        while True:
            messages, is_busy = self.show.tick()
            idle = 0 if is_busy else idle + 1
            if idle % IDLE_FRAMES:
                messages = [message for message in messages if message[1] != Kind.PICTURE]
            if scene_number != self.show.scene_number:
                scene_number = self.show.scene_number
                messages.insert(0, encode_scene(self.show.scene()))
            for browser in self._browsers.values():
                for message in messages:
                    browser.offer(message)
            # A machine that is late leaves pictures out.
            due_s = max(due_s + (FRAME_S if self._browsers else ALONE_S), time.monotonic() + FRAME_S / 4)
            await asyncio.sleep(due_s - time.monotonic())


async def _refused(_request: Request, _error: Exception | None) -> Response:
    return Response("refused: open the address that tactable printed\n", 403, HEADERS)


def open_door(host: str, port: int, token: str) -> tuple[socket.socket, Door]:
    """A listening socket, and the door it is; port 0 takes any that is free. Raises OSError."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen()
    except OSError:
        listening.close()
        raise
    return listening, Door(host, listening.getsockname()[1], token)


async def serve(
    show: Show,
    listening: socket.socket,
    door: Door,
    on_start: Callable[[uvicorn.Server], Awaitable[None]] | None = None,
) -> None:
    """Serve a show until a signal, or until the server is told to exit."""
    page = PageServer(show, door)
    config = uvicorn.Config(
        page.app,
        http="h11",
        ws="websockets-sansio",
        loop="asyncio",
        lifespan="off",
        ws_max_size=MOST_BYTES,
        ws_per_message_deflate=False,
        log_level="error",
        access_log=False,  # the token is in every path
        server_header=False,
        date_header=False,
        timeout_graceful_shutdown=_GRACE_S,
    )
    server = uvicorn.Server(config)
    beside = [asyncio.create_task(show.run()), asyncio.create_task(page.broadcast())]
    for task in beside:
        task.add_done_callback(lambda done: _end_if_broken(done, server))
    try:
        if on_start is not None:
            await on_start(server)
        await server.serve(sockets=[listening])
    finally:
        for task in beside:
            task.cancel()
        results = await asyncio.gather(*beside, return_exceptions=True)
    for result in results:
        if isinstance(result, Exception):
            raise result


def _end_if_broken(done: "asyncio.Task[None]", server: uvicorn.Server) -> None:
    """A show that broke ends the server, and its error is the server's."""
    if not done.cancelled():
        server.should_exit = True
