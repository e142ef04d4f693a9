"""Access to the page: checks of token, Host and Origin, and the security headers of every answer."""

import ipaddress
import logging
import secrets
from dataclasses import dataclass, field

_TOKEN_BYTES = 24
LOOPBACK = ("127.0.0.1", "::1", "localhost")
POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "connect-src 'self'",
        "img-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
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


def print_no_wrong_text() -> None:
    """Keep the traceback of a text that is not UTF-8 from the terminal; who sent it is answered with the code 1007."""
    logging.getLogger("uvicorn.error").addFilter(_is_no_wrong_text)


def _is_no_wrong_text(record: logging.LogRecord) -> bool:
    return "Invalid UTF-8" not in record.getMessage()


@dataclass(frozen=True)
class AccessPolicy:
    """Decides which requests may see the page. `host` and `port`: what the server is bound to."""

    host: str
    port: int
    token: str = field(repr=False)

    @property
    def url(self) -> str:
        """The address to open on this machine."""
        return self.url_at(self.host)

    def url_at(self, host: str) -> str:
        """The address to open where the server is known as `host`."""
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/{self.token}/"

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

    def admits_origin(self, origin: str | None, host: str | None) -> bool:
        """Whether an Origin header names a page of this server."""
        return self.admits_host(host) and origin == f"http://{host}"


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
