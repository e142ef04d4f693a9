"""Who may see a page, and who may speak over a WebSocket: token and Host decide, and all that is said is answered."""

import asyncio
import functools
import json
import logging
import sys
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any, ParamSpec

import pytest
import websockets
from starlette.applications import Starlette
from websockets.asyncio.client import connect
from websockets.typing import Origin

from tactable.control.control_server import ControlServer
from tactable.control.security import HEADERS, POLICY, AccessPolicy, AddressError, new_token, quiet_server, user_of
from tactable.control.web import WebControl
from tests.tactable.control.messages import HELLO, VALID
from tests.tactable.control.virtual import FINGERS, VirtualSlot

LOOPBACK = AccessPolicy("127.0.0.1", 8000, "secret")
OPEN = AccessPolicy("0.0.0.0", 8000, "secret")


def test_only_the_token_opens_the_door_and_none_is_like_another() -> None:
    assert LOOPBACK.knows("secret")
    assert not any(LOOPBACK.knows(token) for token in ("", "secre", "secret ", "Secret", "sécret"))
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100 and min(map(len, tokens)) >= 32


def test_the_token_is_in_the_address_and_in_no_text_of_the_door_nor_of_a_command_line() -> None:
    assert LOOPBACK.url == "http://127.0.0.1:8000/secret/"
    assert AccessPolicy("::1", 8000, "secret").url == "http://[::1]:8000/secret/"
    assert "secret" not in repr(LOOPBACK)
    assert "secret" not in LOOPBACK.opening_url and LOOPBACK.ticket in LOOPBACK.opening_url
    assert LOOPBACK.ticket != OPEN.ticket


def test_a_server_logs_no_request_tells_neither_its_name_nor_its_clock_and_compresses_no_secret() -> None:
    server = quiet_server(Starlette(), 1)
    server.config.load()
    asyncio.run(server.on_tick(0))
    assert server.server_state.default_headers == [] and not server.config.ws_per_message_deflate
    # The token is in the path of every request.
    assert not logging.getLogger("uvicorn.access").isEnabledFor(logging.INFO)


@pytest.mark.parametrize(
    ("policy", "host", "is_admitted"),
    [
        *((LOOPBACK, host, True) for host in ("127.0.0.1:8000", "localhost:8000", "[::1]:8000")),
        *((LOOPBACK, host, False) for host in (None, "", "127.0.0.1", "127.0.0.1:8001", "evil.example:8000")),
        *((LOOPBACK, host, False) for host in ("192.168.1.2:8000", "localhost.evil:8000")),
        (OPEN, "192.168.1.2:8000", True),
        (OPEN, "evil.example:8000", False),
        (AccessPolicy("bar.example", 8000, "secret"), "bar.example:8000", True),
    ],
)
def test_a_door_admits_the_names_that_it_is_bound_to_and_pages_of_theirs_alone(
    policy: AccessPolicy, host: str | None, is_admitted: bool
) -> None:
    assert policy.admits_host(host) == is_admitted
    assert policy.admits_origin(f"http://{host}", host) == is_admitted
    assert policy.is_loopback is (policy is LOOPBACK)
    for origin in (None, "null", "http://evil.example", f"https://{host}", "http://localhost", "http://127.0.0.1"):
        assert not policy.admits_origin(origin, host)


def test_nothing_is_loaded_from_elsewhere_and_nothing_inline_runs() -> None:
    assert HEADERS["Content-Security-Policy"] == POLICY
    rules = dict(rule.split(" ", 1) for rule in POLICY.split("; "))
    assert rules["default-src"] == "'none'"
    assert all(sources in ("'none'", "'self'") for sources in rules.values())


CONNECTIONS = """\
  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode
   0: 0100007F:1F40 00000000:0000 0A 00000000:00000000 00:00000000 00000000  1000        0 11 1 0 100 0 0 10 0
   1: 0100007F:1F40 0100007F:C350 01 00000000:00000000 00:00000000 00000000  1000        0 12 1 0 20 4 30 10 -1
   2: 0100007F:C350 0100007F:1F40 01 00000000:00000000 00:00000000 00000000  1001        0 13 1 0 20 4 30 10 -1
   3: 0100007F:C351 0100007F:1F40 05 00000000:00000000 00:00000000 00000000     0        0 0 1 0 20 4 30 10 -1
   4: 0000000000000000FFFF00000100007F:C352 0000000000000000FFFF00000100007F:1F40 01 0:0 0:0 0 1002 0 14 1 0
   5: 00000000000000000000000001000000:C353 00000000000000000000000001000000:1F40 01 0:0 0:0 0 1003 0 15 1 0
"""


@pytest.mark.skipif(sys.byteorder == "big", reason="the listing is one of a little-endian machine")
@pytest.mark.parametrize(
    ("host", "port", "user"),
    [
        ("127.0.0.1", 50000, 1001),
        ("127.0.0.1", 50001, None),  # the browser has closed it: the system names root
        ("127.0.0.1", 50002, 1002),
        ("::1", 50003, 1003),
        ("127.0.0.1", 50003, None),
        ("192.0.2.7", 50000, None),
    ],
)
def test_the_user_at_the_other_end_is_read_from_the_system_s_list(host: str, port: int, user: int | None) -> None:
    server = ("::1" if ":" in host else "127.0.0.1", 8000)
    assert user_of((host, port), server, CONNECTIONS.splitlines()) == user


P = ParamSpec("P")


def in_real_time(test: Callable[P, Coroutine[Any, Any, None]]) -> Callable[P, None]:
    """Make a test of a coroutine, whose arguments are fixtures."""
    return functools.wraps(test)(lambda *args, **fixtures: asyncio.run(test(*args, **fixtures)))


@asynccontextmanager
async def served(server: ControlServer) -> AsyncIterator[WebControl]:
    web = WebControl(server, 0)
    serving = asyncio.create_task(web.run())
    try:
        yield web
    finally:
        web.end()
        await serving


@pytest.mark.usefixtures("both_ends")
@in_real_time
async def test_a_page_says_what_its_buttons_feel_like_and_loses_them_when_it_closes(
    server: ControlServer, slot: VirtualSlot
) -> None:
    async with served(server) as web, connect(web.address, origin=Origin("null")) as page:
        answers = []
        for message in (HELLO, VALID[1], {"type": "subscribe", "to": ["touches"]}, {"type": "nonsense"}):
            await page.send(json.dumps(message))
            answers.append(json.loads(await page.recv()))
        assert [each["ok"] for each in answers] == [True, True, True, False]
        assert list(server.scene.regions) == ["ok"]
        server.publish([{"event": "touches", "time_ns": 1, "fingers": FINGERS}])
        assert json.loads(await page.recv())["fingers"] == FINGERS
        await page.send(b"\xff")
        assert json.loads(await page.recv())["ok"] is False
        await page.close()
        while server.scene.regions or len(slot.steps) < 2:
            await asyncio.sleep(0.01)


@pytest.mark.usefixtures("both_ends")
@in_real_time
async def test_a_text_that_is_not_utf_8_closes_its_own_connection_and_prints_nothing(
    server: ControlServer, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    async with served(server) as web:
        async with connect(web.address, origin=Origin("null")) as page:
            await page.send(b"\xff\xfe", text=True)
            with pytest.raises(websockets.ConnectionClosed) as closed:
                await page.recv()
        assert closed.value.rcvd is not None and closed.value.rcvd.code == 1007
        async with connect(web.address, origin=Origin("null")) as page:
            await page.send(json.dumps(HELLO))
            assert json.loads(await page.recv())["ok"]
    assert capfd.readouterr() == ("", "") and caplog.text == ""


@pytest.mark.usefixtures("both_ends")
@in_real_time
async def test_without_the_token_or_by_a_foreign_name_nobody_speaks_and_a_port_that_is_taken_is_named(
    server: ControlServer,
) -> None:
    async with served(server) as web:
        port = int(web.address.split(":")[2].split("/")[0])
        for right, wrong in (("/control", "x/control"), ("127.0.0.1", "foreign.example")):
            with pytest.raises(websockets.exceptions.InvalidStatus, match="403"):
                await connect(web.address.replace(right, wrong), host="127.0.0.1", port=port)
        with pytest.raises(AddressError, match=f"port {port}: .*give another port"):
            WebControl(server, port)
