"""Opens the page of the demo: its address and token, the warning, the browser, and Ctrl-C that ends it."""

import asyncio
import contextlib
import io
import ipaddress
import os
import re
import signal
import socket
import webbrowser
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from threadpoolctl import threadpool_limits

from base.files import replace_file, work_folder
from base.trust import open_to_others
from engine.device import Device
from engine.effects.rules import Drives
from tactable.control.security import LOOPBACK, AccessPolicy, listen_at, new_token
from tactable.page.choices import Choice, Rules, Source, offered
from tactable.page.demo_backend import DemoBackend
from tactable.page.page_server import PageBackend, serve
from tactable.page.processes.engine_process import ProgramsAt
from tactable.shipped import cache_folder

_ELSEWHERE = ("192.0.2.1", "2001:db8::1")
"""Addresses that RFC 5737 and RFC 3849 reserve for documents: a route to them is the way out of this machine."""
_IP = re.compile(r"[0-9.]+|.*:.*")
_QUIET = 2  # light modules around a QR code
_TOKEN = r"[A-Za-z0-9_-]{32,}"
Say = Callable[[str], None]


@dataclass(frozen=True)
class Address:
    """Address at which the page is served; port 0 takes any free one."""

    host: str = LOOPBACK[0]
    port: int = 0
    opens_browser: bool = True


def has_browser(environment: Mapping[str, str] = os.environ) -> bool:
    """Whether a graphical browser can be opened; a browser in a terminal cannot show the page."""
    if not (environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY")):
        return False
    try:
        webbrowser.get()
    except webbrowser.Error:
        return False
    return True


def show_demo(
    device_name: str,
    device: Device,
    rule_file: Path | None,
    cache: Path,
    address: Address,
    say: Say,
    drives: Drives | None = None,
    programs: ProgramsAt | None = None,
) -> None:
    """The demo as a page, with a control channel for `programs`, until Ctrl-C; it begins with these drives.

    Raises OSError where the address is taken.
    """
    rules = Rules.TOUCH if rule_file is None else Rules.FILE
    choice = Choice(device_name, Source.ZONES if drives is Drives.ZONES else Source.CLICK, rules)
    with work_folder("page", in_memory=True) as work:
        backend = DemoBackend(choice, device, offered(device_name, rule_file), cache, work, programs, say)
        # SIGTERM ends the demo as Ctrl-C does, so that no process of the rig is left behind.
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        with contextlib.suppress(KeyboardInterrupt), threadpool_limits(1, "blas"):  # its threads spin on a busy machine
            asyncio.run(_serve(backend, address, say))
        signal.signal(signal.SIGTERM, before)


async def _serve(backend: PageBackend, address: Address, say: Say) -> None:
    listening, access = listen_at(address.host, address.port, token_for(address.port))
    with listening:
        for line in announcement(access):
            say(line)

        async def open_browser(_server: uvicorn.Server) -> None:
            if address.opens_browser:
                await asyncio.to_thread(webbrowser.open, access.opening_url)

        await serve(backend, listening, access, open_browser)


def token_for(port: int) -> str:
    """The token of a page: new for port 0; the same every time for a stated port, so that an open page reconnects.

    It is kept in a file that only its user can read.
    """
    if port == 0:
        return new_token()
    path = cache_folder() / "page-token"
    path.parent.mkdir(parents=True, exist_ok=True)
    is_ours = path.is_file() and open_to_others(path) is None
    kept = path.read_text(encoding="utf-8", errors="replace").strip() if is_ours else ""
    if re.fullmatch(_TOKEN, kept):
        return kept
    token = new_token()
    # Damaged or empty, with which no address would be admitted; or others could write it, and so would know it.
    path.unlink(missing_ok=True)
    with replace_file(path) as partial, os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT, 0o600), "w") as file:
        file.write(token)
    return token


def announcement(access: AccessPolicy) -> list[str]:
    """The lines that are printed once the page is served."""
    url = access.url_at(reachable(access.host))
    lines = [f"the page: {url}  (Ctrl-C ends)"]
    if not access.is_loopback:
        warning = "everybody who reaches this machine and knows the address can use the page; nothing is encrypted"
        lines += [f"WARNING: bound to {access.host}: {warning}", "for a phone or a tablet in the same network:"]
        lines += qr_code(url)
    return lines


def reachable(host: str) -> str:
    """Where others reach a server that is bound to `host`: for all addresses, that of the way out of this machine."""
    if not ipaddress.ip_address(socket.gethostbyname(host) if not _IP.fullmatch(host) else host).is_unspecified:
        return host
    family, other = (socket.AF_INET6, _ELSEWHERE[1]) if ":" in host else (socket.AF_INET, _ELSEWHERE[0])
    with socket.socket(family, socket.SOCK_DGRAM) as way:
        try:
            way.connect((other, 9))  # of a datagram socket: it asks the routes, and sends nothing
        except OSError:
            return LOOPBACK[1] if ":" in host else LOOPBACK[0]
        return str(way.getsockname()[0])


def qr_code(text: str) -> list[str]:
    """Lines of a QR code in half blocks, light on the dark ground of most terminals."""
    import segno  # only an address for others needs it

    lines = io.StringIO()
    segno.make(text, micro=False).terminal(lines, border=_QUIET, compact=True)
    return lines.getvalue().splitlines()
