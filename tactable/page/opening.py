"""A show to an address that people open: the door, the warning, the browser, and Ctrl-C that ends it."""

import asyncio
import contextlib
import os
import signal
import sys
import tempfile
import webbrowser
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import uvicorn

from engine.device import Device
from tactable.page.choices import Choice, Rules, offered
from tactable.page.demo_show import DemoShow
from tactable.page.security import LOOPBACK, Door, new_token
from tactable.page.server import Show, open_door, serve
from tactable.shipped import cache_folder

_MEMORY = Path("/dev/shm")
Say = Callable[[str], None]


@dataclass(frozen=True)
class Address:
    """Where the page is to be; port 0 takes any that is free."""

    host: str = LOOPBACK[0]
    port: int = 0
    opens_browser: bool = True


def has_browser(environment: Mapping[str, str] = os.environ, platform: str = sys.platform) -> bool:
    """Whether there is a browser with a screen; one in a terminal shows no page of ours."""
    if platform.startswith("linux") and not (environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY")):
        return False
    try:
        webbrowser.get()
    except webbrowser.Error:
        return False
    return True


def show_demo(
    device_name: str, device: Device, rule_file: Path | None, cache: Path, address: Address, say: Say
) -> None:
    """The demo as a page, until Ctrl-C. Raises OSError where the address is taken."""
    rules = Rules.TOUCH if rule_file is None else Rules.FILE
    choice, where = Choice(device_name, rules=rules), _MEMORY if _MEMORY.is_dir() else None
    with tempfile.TemporaryDirectory(prefix="tactable-page-", dir=where) as work:
        show = DemoShow(choice, device, offered(device_name, rule_file), cache, Path(work))
        # A polite kill is a Ctrl-C: nothing of the rig is left behind.
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(_show(show, address, say))
        signal.signal(signal.SIGTERM, before)


async def _show(show: Show, address: Address, say: Say) -> None:
    listening, door = open_door(address.host, address.port, token_for(address.port))
    with listening:
        for line in announcement(door):
            say(line)

        async def open_browser(_server: uvicorn.Server) -> None:
            if address.opens_browser:
                await asyncio.to_thread(webbrowser.open, door.url)

        await serve(show, listening, door, open_browser)


def token_for(port: int) -> str:
    """A token for a page: of a port that was asked for always the same, so that an open page finds it again.

    It is kept where only its user reads it.
    """
    if port == 0:
        return new_token()
    path = cache_folder() / "page-token"
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        return path.read_text(encoding="ascii").strip()
    token = new_token()
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(token)
    return token


def announcement(door: Door) -> list[str]:
    """What people are told before the page is there."""
    lines = [f"the page: {door.url}  (Ctrl-C ends)"]
    if not door.is_loopback:
        warning = "anybody who can reach this machine and knows this address can use the page; nothing is encrypted"
        lines.append(f"WARNING: bound to {door.host}: {warning}")
    return lines
