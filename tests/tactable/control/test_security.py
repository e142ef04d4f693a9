"""Who may see the page."""

import asyncio
import logging
import sys

import pytest
from starlette.applications import Starlette

from tactable.control.security import HEADERS, POLICY, AccessPolicy, new_token, quiet_server, user_of

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
