"""Who may see the page."""

import pytest

from tactable.control.security import HEADERS, POLICY, AccessPolicy, new_token

LOOPBACK = AccessPolicy("127.0.0.1", 8000, "secret")
OPEN = AccessPolicy("0.0.0.0", 8000, "secret")


def test_only_the_token_opens_the_door() -> None:
    assert LOOPBACK.knows("secret")
    assert not any(LOOPBACK.knows(token) for token in ("", "secre", "secret ", "Secret", "sécret"))


def test_tokens_are_never_the_same_and_long_enough() -> None:
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 32


def test_the_token_is_in_the_address_and_in_no_text_of_the_door() -> None:
    assert LOOPBACK.url == "http://127.0.0.1:8000/secret/"
    assert AccessPolicy("::1", 8000, "secret").url == "http://[::1]:8000/secret/"
    assert "secret" not in repr(LOOPBACK)


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "localhost:8000", "[::1]:8000"])
def test_a_loopback_door_admits_the_names_of_loopback(host: str) -> None:
    assert LOOPBACK.admits_host(host)
    assert LOOPBACK.admits_origin(f"http://{host}", host)


@pytest.mark.parametrize(
    "host", [None, "", "127.0.0.1", "127.0.0.1:8001", "evil.example:8000", "192.168.1.2:8000", "localhost.evil:8000"]
)
def test_a_loopback_door_admits_no_other_name(host: str | None) -> None:
    assert not LOOPBACK.admits_host(host)
    assert not LOOPBACK.admits_origin(f"http://{host}", host)


@pytest.mark.parametrize(("host", "is_admitted"), [("192.168.1.2:8000", True), ("evil.example:8000", False)])
def test_an_open_door_admits_addresses_but_no_foreign_names(host: str, is_admitted: bool) -> None:
    assert OPEN.admits_host(host) == is_admitted


def test_a_door_admits_the_name_that_it_is_bound_to() -> None:
    assert AccessPolicy("bar.example", 8000, "secret").admits_host("bar.example:8000")


@pytest.mark.parametrize(
    "origin",
    [None, "null", "http://evil.example", "https://127.0.0.1:8000", "http://localhost:8000", "http://127.0.0.1"],
)
def test_an_origin_that_is_not_the_page_itself_is_refused(origin: str | None) -> None:
    assert not LOOPBACK.admits_origin(origin, "127.0.0.1:8000")


def test_nothing_is_loaded_from_elsewhere_and_nothing_inline_runs() -> None:
    assert HEADERS["Content-Security-Policy"] == POLICY
    rules = dict(rule.split(" ", 1) for rule in POLICY.split("; "))
    assert rules["default-src"] == "'none'"
    assert all(sources in ("'none'", "'self'") for sources in rules.values())


def test_only_loopback_is_called_so() -> None:
    assert LOOPBACK.is_loopback
    assert not OPEN.is_loopback
