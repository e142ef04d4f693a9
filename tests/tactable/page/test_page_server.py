"""The page's server: who is let in, what it gives them, and how it closes on what is no message."""

import asyncio
import json
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import httpx
import numpy as np
import pytest
import uvicorn
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.typing import Origin

from engine.touch.sources.pointer import Phase, PointerEvent
from tactable.control.security import HEADERS, AccessPolicy, AddressError, listen_at, new_token
from tactable.page.page_messages import VERSION, CloseCode, DroppedFile, Kind, encode_sound
from tactable.page.page_server import MOST_BROWSERS, PageBackend, PageServer, serve
from tests.tactable.page.browser import encode_choice, encode_device, encode_listen, encode_touches

pytestmark = pytest.mark.usefixtures("both_ends")

DOWN = PointerEvent(1, 0.25, 0.5, Phase.DOWN)
SOUND = encode_sound(3, 8000, np.zeros(4, np.int16))
Visit = Callable[[AccessPolicy, "Notes"], Awaitable[None]]


class Notes(PageBackend):
    """A backend that notes what is done to it, and shows one picture after another."""

    def __init__(self) -> None:
        self.scene_number = 0
        self.ticks = 0
        self.is_busy = True
        self.is_broken = False
        self.asked: list[object] = []
        self.left: list[int] = []

    def scene(self) -> dict[str, Any]:
        return {"number": self.scene_number}

    def tick(self) -> tuple[list[bytes], bool]:
        if self.is_broken:
            raise RuntimeError("the backend is broken")
        self.ticks += 1
        return [bytes([VERSION, Kind.PICTURE]) + self.ticks.to_bytes(4, "little")], self.is_busy

    def touch(self, browser: int, events: Sequence[PointerEvent]) -> None:
        self.asked.append((browser, tuple(events)))

    def leave(self, browser: int) -> None:
        self.left.append(browser)

    def choose(self, switches: dict[str, Any]) -> None:
        self.asked.append(switches)
        self.scene_number += 1

    def drop(self, file: DroppedFile) -> None:
        self.asked.append(file)

    def sound(self, finger: int) -> bytes | None:
        return SOUND if finger == 3 else None

    async def run(self) -> None:
        await asyncio.Event().wait()


def while_served(visitor: Visit) -> Callable[[], None]:
    """Make a test of a visitor to a backend that is served while it is there."""

    async def served() -> None:
        backend, (listening, access) = Notes(), listen_at("127.0.0.1", 0, new_token())

        async def stay(server: uvicorn.Server) -> None:
            async def come_and_go() -> None:
                try:
                    await visitor(access, backend)
                finally:
                    server.should_exit = True

            stays.append(asyncio.create_task(come_and_go()))

        stays: list[asyncio.Task[None]] = []
        with listening:
            await serve(backend, listening, access, stay)
        await stays[0]

    return lambda: asyncio.run(served())


def socket_of(access: AccessPolicy, **words: Any) -> connect:
    """A WebSocket as the page itself opens it."""
    address = access.url.replace("http:", "ws:") + "socket"
    return connect(address, **{"origin": Origin(f"http://127.0.0.1:{access.port}"), "compression": None, **words})


async def next_of(socket: ClientConnection, kind: Kind) -> bytes:
    while True:
        message = await socket.recv()
        assert isinstance(message, bytes)
        if message[1] == kind:
            return message


async def closed_with(socket: ClientConnection) -> int:
    with pytest.raises(ConnectionClosed) as caught:
        while True:
            await socket.recv()
    assert caught.value.rcvd is not None
    return caught.value.rcvd.code


async def until(condition: Callable[[], bool]) -> None:
    while not condition():
        await asyncio.sleep(0.005)


@while_served
async def test_the_page_s_files_are_served_by_its_token_and_names_alone(access: AccessPolicy, _backend: Notes) -> None:
    kinds = {"": "text/html", "app.js": "text/javascript", "page.css": "text/css", "icon.svg": "image/svg+xml"}
    async with httpx.AsyncClient() as client:
        for name, kind in kinds.items():
            found = await client.get(access.url + name)
            assert found.status_code == 200
            assert found.headers["content-type"].startswith(kind)
            assert all(found.headers[header] == value for header, value in HEADERS.items())
        for name in ("page_server.py", "..%2fpage_server.py", "%2e%2e/page_server.py", "socket"):
            assert (await client.get(access.url + name)).status_code in (403, 404)
        assert (await client.post(access.url)).status_code == 403
        root = f"http://127.0.0.1:{access.port}/"
        for address in (root, root + "x/", root + access.token[:-1] + "/", root + access.token, root + "app.js"):
            found = await client.get(address)
            assert found.status_code == 403
            assert "location" not in found.headers
            assert "script" not in found.text
        foreign = {"Host": f"evil.example:{access.port}"}
        assert (await client.get(access.url, headers=foreign)).status_code == 403


@while_served
async def test_a_ticket_leads_its_user_to_the_page_once(access: AccessPolicy, _backend: Notes) -> None:
    async with httpx.AsyncClient() as client:
        foreign = {"Host": f"evil.example:{access.port}"}
        assert (await client.get(access.opening_url, headers=foreign)).status_code == 403
        assert (await client.get(access.opening_url[:-1])).status_code == 403
        found = await client.get(access.opening_url)
        assert found.status_code == 303 and found.headers["location"] == f"/{access.token}/"
        assert (await client.get(access.opening_url)).status_code == 403
        assert (await client.get(access.url)).status_code == 200


def test_a_ticket_is_of_no_use_to_another_user_who_is_sooner_there() -> None:
    """It stands in the command line of the browser, which everybody can read."""
    access = AccessPolicy("127.0.0.1", 8000, "secret")
    users = iter([access.user_id + 1, None, access.user_id])

    def connections() -> list[str]:
        return [f"0: 0100007F:C350 0100007F:1F40 01 0:0 0:0 0 {user} 0" for user in [next(users)] if user is not None]

    async def ask() -> list[int]:
        transport = httpx.ASGITransport(PageServer(Notes(), access, connections).app, client=("127.0.0.1", 50000))
        async with httpx.AsyncClient(transport=transport) as client:
            return [(await client.get(access.opening_url)).status_code for _ in range(4)]

    assert asyncio.run(ask()) == [403, 403, 303, 403]


@while_served
async def test_a_socket_of_a_foreign_page_or_a_wrong_token_is_refused(access: AccessPolicy, backend: Notes) -> None:
    wrong = AccessPolicy(access.host, access.port, "wrong")
    for socket in (socket_of(wrong), *(socket_of(access, origin=each) for each in (None, "http://evil.example"))):
        with pytest.raises(InvalidStatus) as caught:
            await socket
        assert caught.value.response.status_code == 403
    assert backend.left == []


@while_served
async def test_what_is_no_message_closes_the_socket_and_hurts_nobody_else(access: AccessPolicy, backend: Notes) -> None:
    async with socket_of(access) as other:
        for message, code in (
            (b"", CloseCode.MALFORMED),
            (bytes([VERSION, Kind.CHOICE]) + b"[" * 1500, CloseCode.MALFORMED),
            (bytes([VERSION + 1, Kind.LISTEN, 0, 0, 0, 0]), CloseCode.OTHER_VERSION),
            ("text", CloseCode.NOT_BINARY),
            (bytes(1 << 20), CloseCode.TOO_BIG),
        ):
            async with socket_of(access) as socket:
                await socket.send(message)
                assert await closed_with(socket) == code
        await other.send(encode_touches([DOWN]))
        await until(lambda: bool(backend.asked))
        await next_of(other, Kind.PICTURE)
    await until(lambda: len(backend.left) == 6)


@while_served
async def test_what_browsers_ask_reaches_the_show_and_goes_with_them(access: AccessPolicy, backend: Notes) -> None:
    async with socket_of(access) as socket:
        assert json.loads((await next_of(socket, Kind.SCENE))[2:]) == {"number": 0}
        await socket.send(encode_touches([DOWN]))
        await socket.send(encode_choice({"level_db": None}))
        assert json.loads((await next_of(socket, Kind.SCENE))[2:]) == {"number": 1}
        await socket.send(encode_device("bar.toml", "x" * 9000))
        await socket.send(encode_listen(9))
        await socket.send(encode_listen(3))
        assert await next_of(socket, Kind.SOUND) == SOUND
    await until(lambda: bool(backend.left))
    assert backend.asked == [(1, (DOWN,)), {"level_db": None}, DroppedFile("bar.toml", "x" * 9000)]
    assert backend.left == [1]


@while_served
async def test_pictures_come_in_order_and_seldom_while_nothing_happens(access: AccessPolicy, backend: Notes) -> None:
    async with socket_of(access) as socket:
        first, second = [await next_of(socket, Kind.PICTURE) for _ in range(2)]
        assert int.from_bytes(second[2:], "little") > int.from_bytes(first[2:], "little")
        backend.is_busy = False
        await next_of(socket, Kind.PICTURE)
        before, shown = backend.ticks, 0
        while backend.ticks < before + 60:
            await next_of(socket, Kind.PICTURE)
            shown += 1
        assert shown <= 60 // 6


@while_served
async def test_a_browser_that_takes_nothing_holds_up_nobody(access: AccessPolicy, backend: Notes) -> None:
    async with socket_of(access, max_queue=1, close_timeout=0.1), socket_of(access) as socket:
        before = backend.ticks
        while backend.ticks < before + 60:
            newest = int.from_bytes((await next_of(socket, Kind.PICTURE))[2:], "little")
        assert newest >= backend.ticks - 20


@while_served
async def test_more_browsers_than_there_is_room_for_are_turned_away(access: AccessPolicy, _backend: Notes) -> None:
    sockets = [await socket_of(access) for _ in range(MOST_BROWSERS)]
    async with socket_of(access) as late:
        assert await closed_with(late) == CloseCode.CROWDED
    for socket in sockets:
        await socket.close()
    async with socket_of(access) as again:
        await next_of(again, Kind.PICTURE)


def test_a_backend_that_breaks_ends_the_server_with_its_error() -> None:
    async def visitor(access: AccessPolicy, backend: Notes) -> None:
        async with socket_of(access) as socket:
            backend.is_broken = True
            await closed_with(socket)

    with pytest.raises(RuntimeError, match="the backend is broken"):
        while_served(visitor)()


def test_a_port_that_is_taken_and_an_address_of_another_machine_are_named() -> None:
    listening, access = listen_at("127.0.0.1", 0, "token")
    with listening, pytest.raises(AddressError, match=rf"port {access.port}: .* in use.* another port"):
        listen_at("127.0.0.1", access.port, "token")
    with pytest.raises(AddressError, match=r"192\.0\.2\.1, port 0: .* an address of this machine"):
        listen_at("192.0.2.1", 0, "token")
