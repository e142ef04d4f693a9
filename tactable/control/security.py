"""Access to the page: checks of token, Host and Origin, and the security headers of every answer.

A browser is opened by a command line, which every user of the machine can read, so the token must not be in it. In its
place is a ticket: it leads to the address with the token once, and only over a connection whose other end belongs to
the same user, which the system tells (/proc/net/tcp). A file that only its user can read would be closed to browsers
in a snap or a flatpak; a ticket that anybody may use first would be used by who watches for it; and a cookie goes to
every port of a host, so to the servers of other users too [RFC 6265, section 8.5].
"""

import errno
import ipaddress
import logging
import os
import secrets
import socket
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.requests import HTTPConnection

from base.errors import TactableError

GRACE_S = 1  # how long a server that ends waits for its connections
_TOKEN_BYTES = 24  # 192 bits in 32 letters; 128 bits cannot be guessed either
LOOPBACK = ("127.0.0.1", "::1", "localhost")
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Headers of every answer: no foreign or inline content, no framing, no referrer (which would hold the token)."""


def new_token() -> str:
    """A random token of 192 bits."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def quiet_server(app: Starlette, longest_message: int) -> uvicorn.Server:
    """A server of small messages that says nothing of its requests, in whose paths the token is.

    Nor has it the traceback of a text that is not UTF-8; who sent it is answered with the code 1007.
    """
    logging.getLogger("uvicorn.error").addFilter(_is_no_wrong_text)
    config = uvicorn.Config(
        app,
        http="h11",
        ws="websockets-sansio",
        loop="asyncio",
        lifespan="off",
        ws_max_size=longest_message,
        ws_per_message_deflate=False,
        log_level="error",
        server_header=False,
        date_header=False,
        timeout_graceful_shutdown=GRACE_S,
    )
    return uvicorn.Server(config)


def _is_no_wrong_text(record: logging.LogRecord) -> bool:
    return "Invalid UTF-8" not in record.getMessage()


@dataclass(frozen=True)
class AccessPolicy:
    """Decides which requests may see the page. `host` and `port`: what the server is bound to.

    ticket: leads `user_id` to the page once, and nobody else.
    """

    host: str
    port: int
    token: str = field(repr=False)
    ticket: str = field(default_factory=new_token)
    user_id: int = field(default_factory=os.getuid)

    @property
    def url(self) -> str:
        """The address to open on this machine."""
        return self.url_at(self.host)

    def url_at(self, host: str) -> str:
        """The address to open where the server is known as `host`."""
        return f"{self._root(host)}/{self.token}/"

    @property
    def opening_url(self) -> str:
        """The address for a command line that opens a browser on this machine."""
        return f"{self._root(self.host)}/open/{self.ticket}"

    def _root(self, host: str) -> str:
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}"

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine reaches it."""
        return self.host in LOOPBACK

    def knows(self, token: str) -> bool:
        """Whether `token` is the right one; compares in constant time."""
        return secrets.compare_digest(token.encode(), self.token.encode())

    def admits_host(self, header: str | None) -> bool:
        """Whether a Host header names this server: by a loopback name, its bound name or, off loopback, any IP address.

        Another name that resolves here belongs to a foreign site (DNS rebinding) and is refused.
        """
        name, separator, port = (header or "").rpartition(":")
        if not separator or port != str(self.port):
            return False
        name = name.removeprefix("[").removesuffix("]")
        if self.is_loopback:
            return name in LOOPBACK
        return name == self.host or name in LOOPBACK or _is_address(name)

    def admits(self, asked: HTTPConnection, *, is_own_page: bool = False) -> bool:
        """Whether a request knows the token in its path and names this server; `is_own_page`: from a page of it."""
        host, origin = asked.headers.get("host"), asked.headers.get("origin")
        is_named = self.admits_origin(origin, host) if is_own_page else self.admits_host(host)
        return is_named and self.knows(asked.path_params["token"])

    def admits_origin(self, origin: str | None, host: str | None) -> bool:
        """Whether an Origin header names a page of this server."""
        return self.admits_host(host) and origin == f"http://{host}"


class AddressError(TactableError, OSError):
    """Nothing can be served at an address; the message names it and the remedy."""


def listen_at(host: str, port: int, token: str) -> tuple[socket.socket, AccessPolicy]:
    """Open a listening socket; its policy knows the port it got (`port` 0 takes any free one). Raises AddressError."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen()
    except OSError as error:
        listening.close()
        remedy = "give another port" if error.errno == errno.EADDRINUSE else "give an address of this machine"
        raise AddressError(f"{host}, port {port}: nothing can be served there ({error.strerror}); {remedy}") from error
    return listening, AccessPolicy(host, listening.getsockname()[1], token)


Endpoint = tuple[str, int]  # IP address and port of one end of a connection
_CONNECTIONS = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
_ESTABLISHED = "01"


def read_connections() -> list[str]:
    """The connections of this machine, as Linux lists them; none where it does not tell."""
    return [line for path in _CONNECTIONS if path.is_file() for line in path.read_text(encoding="ascii").splitlines()]


def user_of(near: Endpoint, far: Endpoint, connections: Iterable[str]) -> int | None:
    """User ID of the owner of the local socket `near` that is connected with `far`; None without such a connection.

    Only open connections count: the system gives root those that nobody holds any more.
    """
    wanted = _end(*near), _end(*far)
    for line in connections:
        columns = line.split()
        if columns[3] == _ESTABLISHED and (_listed_end(columns[1]), _listed_end(columns[2])) == wanted:
            return int(columns[7])
    return None


def _end(address: str, port: int) -> tuple[bytes, int]:
    found = ipaddress.ip_address(address.partition("%")[0])
    return (getattr(found, "ipv4_mapped", None) or found).packed, port


def _listed_end(text: str) -> tuple[bytes, int]:
    """Of "0100007F:1F90": words of four bytes as this machine has them in memory, and the port, in hexadecimal."""
    address, port = text.split(":")
    words = (int(address[at : at + 8], 16).to_bytes(4, sys.byteorder) for at in range(0, len(address), 8))
    return _end(str(ipaddress.ip_address(b"".join(words))), int(port, 16))


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
