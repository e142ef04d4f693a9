"""The page's server and its address: who is let in and what they get, what is no message, and what opens a page."""

import asyncio
import json
import stat
import webbrowser
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import segno
import uvicorn
from typer.testing import CliRunner
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.typing import Origin

from engine.effects.rules import Drives
from engine.touch.sources.pointer import Phase, PointerEvent
from tactable.cli import demo as cli
from tactable.cli.main import app
from tactable.control.security import HEADERS, AccessPolicy, AddressError, listen_at, new_token
from tactable.page import opening
from tactable.page.opening import announcement, has_browser, qr_code, reachable, token_for
from tactable.page.page_messages import VERSION, CloseCode, DroppedFile, Kind, encode_sound
from tactable.page.page_server import MOST_BROWSERS, PageBackend, PageServer, serve
from tactable.page.processes.engine_process import ProgramsAt
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


SCREEN = {"DISPLAY": ":0"}


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What was asked for, in order: values of a report, or those of a page.

    Nothing is made or served. The last two of a page are its drives, and where its control channel is.
    """
    asked: list[Any] = []
    for module, name in ((cli, "report_demo"), (opening, "show_demo")):
        monkeypatch.setattr(module, name, lambda *values: asked.append(values))
    return asked


def demo(*words: str) -> str:
    found = CliRunner().invoke(app, ["demo", *words])
    return f"{found.output} {found.exception}"


def test_a_browser_needs_a_screen_and_a_screen_a_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> webbrowser.BaseBrowser:
        raise webbrowser.Error("none")

    monkeypatch.setattr(webbrowser, "get", lambda: webbrowser.GenericBrowser("true"))
    assert [has_browser(screen) for screen in ({}, SCREEN, {"WAYLAND_DISPLAY": "wayland-0"})] == [False, True, True]
    monkeypatch.setattr(webbrowser, "get", none)
    assert not has_browser(SCREEN)


@pytest.mark.parametrize("has_one", [True, False])
def test_the_demo_is_the_page_where_there_is_a_browser_or_it_is_asked_for_and_else_the_report(
    has_one: bool, opened: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opening, "has_browser", lambda: has_one)
    figure = Path("tactable-demo.png")
    for words, expected in (
        ((), opening.Address("127.0.0.1", 0, opens_browser=True) if has_one else figure),
        (("--no-open",), opening.Address(opens_browser=False)),
        (("--host", "0.0.0.0"), opening.Address("0.0.0.0", opens_browser=False)),
        (("--page-port", "8123"), opening.Address(port=8123, opens_browser=has_one)),
        (("--headless",), figure),
        (("--json",), figure),
        (("--figure", "other.png"), Path("other.png")),
        (("--recording", "a.hid"), figure),
        (("--table", "a.nc"), figure),
    ):
        demo(*words)
        assert [expected in values for values in opened] == [True], words
        opened.clear()


def test_drives_and_a_control_channel_are_the_page_s_as_they_were_asked_for(opened: list[Any]) -> None:
    demo("--control", "--control-socket", "/tmp/some.sock", "--control-port", "0")
    demo("--no-open", "--drives", "zones")
    for words in (("--no-open",), ("--control",)):
        assert "--control are the page's" in demo("--headless", *words)
    assert "its key `drives`" in demo("--no-open", "--drives", "zones", "--rules", "rules.toml")
    assert [values[-2:] for values in opened] == [(None, ProgramsAt("/tmp/some.sock", 0, None)), (Drives.ZONES, None)]


def test_the_command_line_of_the_browser_holds_no_token(monkeypatch: pytest.MonkeyPatch) -> None:
    class OpenedError(Exception):
        pass

    def note(url: str) -> None:
        said.append(url)
        raise OpenedError

    said: list[str] = []
    monkeypatch.setattr(webbrowser, "open", note)
    with pytest.raises(OpenedError):
        asyncio.run(opening._serve(Notes(), opening.Address(), said.append))
    printed, opened = said
    token = printed.split("/")[3]
    assert len(token) >= 32 and token not in opened and opened.startswith("http://127.0.0.1:")


def test_only_a_page_that_others_reach_has_a_warning() -> None:
    (line,) = announcement(AccessPolicy("127.0.0.1", 8000, "secret"))
    assert "http://127.0.0.1:8000/secret/" in line
    assert [reachable(host) for host in ("::1", "192.0.2.7", "localhost")] == ["::1", "192.0.2.7", "localhost"]
    own = reachable("0.0.0.0")
    address, warning, words, *code = announcement(AccessPolicy("0.0.0.0", 8000, "secret"))
    assert own != "0.0.0.0" and f"http://{own}:8000/secret/" in address
    assert "WARNING" in warning and "phone" in words
    assert not any("secret" in line for line in (warning, words, *code))
    assert code == qr_code(f"http://{own}:8000/secret/")


def test_a_qr_code_has_its_modules_two_to_a_character() -> None:
    text = "http://192.0.2.7:8000/secret/"
    halves = {" ": (1, 1), "▀": (0, 1), "▄": (1, 0), "█": (0, 0)}
    lines = [[halves[each] for each in line] for line in qr_code(text)]
    rows = [[each[half] for each in line] for line in lines for half in (0, 1)]
    wanted = [list(row) for row in segno.make(text, micro=False).matrix_iter(border=2)]
    assert rows[: len(wanted)] == wanted
    assert all(len(line) <= 80 for line in lines)


def test_the_token_of_a_stated_port_is_kept_for_its_user_alone_and_not_believed_where_others_could_have_written_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert token_for(0) != token_for(0)
    planted = token_for(8123)
    assert token_for(8123) == planted
    (kept,) = (tmp_path / "tactable").iterdir()
    assert stat.S_IMODE(kept.stat().st_mode) == 0o600
    for damaged in ("", "\n", "a b", "\N{GREEK SMALL LETTER ALPHA}" * 32):  # such as by a disk that was full
        kept.write_text(damaged, encoding="utf-8")
        token = token_for(8123)
        assert len(token) >= 32
        assert token_for(8123) == kept.read_text(encoding="utf-8") == token
        assert stat.S_IMODE(kept.stat().st_mode) == 0o600
    tmp_path.chmod(0o777)
    assert token_for(8123) != token
