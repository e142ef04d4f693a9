"""The page of a demo in Chromium, for the tests: the demo's processes, an open page, and fingers on its screen."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, CDPSession, ConsoleMessage, FloatRect, Page

from tactable.control.security import listen_at

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
IN_CHROMIUM = [
    pytest.mark.machine(stall_s=0.25),
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium: run tests/system/prepare.sh"),
]
"""The marks of tests in the browser. Only a stall that latches an emulated board excuses them."""
TACTABLE = str(Path(sys.executable).parent / "tactable")
# Only against a page that hangs.
PATIENCE_S = 120
DESKTOP, PHONE = (1280, 800), (390, 844)
FIRST, SECOND, THIRD = 1 / 6, 3 / 6, 5 / 6
CLICK, STEADY = 2, 1
QUIET, FELT = 1, 2


class Demo:
    """`tactable demo`, on a small bar whose table is there already; it can be ended and started again.

    `more`: further words of its command; `browser`: the command that opens a browser, none by default.
    """

    def __init__(self, folder: Path, *more: str, browser: str | None = None, device: str = "small.toml") -> None:
        self._folder, self._device, self._more, self._browser = folder, device, more, browser
        listening, access = listen_at("127.0.0.1", 0, "")
        listening.close()
        self._port = access.port
        self.process: subprocess.Popen[str] | None = None
        self.url = self.start()

    def start(self) -> str:
        """The address of its page: of the same port it is always the same."""
        opens = {} if self._browser is None else {"BROWSER": self._browser, "DISPLAY": os.environ.get("DISPLAY", ":0")}
        no_open = [] if opens else ["--no-open"]
        self.process = subprocess.Popen(
            [TACTABLE, "demo", self._device, *no_open, "--page-port", str(self._port), *self._more],
            cwd=self._folder,
            env={**os.environ, "XDG_CACHE_HOME": str(self._folder), **opens},
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stderr is not None
        line = self.process.stderr.readline()
        found = re.search(r"http://\S+", line)
        assert found, line
        return found[0]

    def stop(self) -> None:
        assert self.process is not None
        self.process.send_signal(signal.SIGTERM)
        _, said = self.process.communicate()
        assert self.process.returncode == 0 and "Traceback" not in said, said

    def children(self, name: str) -> list[int]:
        """Its processes of a module."""
        assert self.process is not None
        found = subprocess.run(
            ["ps", "-ww", "--ppid", str(self.process.pid), "-o", "pid=,args="],
            capture_output=True,
            text=True,
            check=True,
        )
        return [int(line.split()[0]) for line in found.stdout.splitlines() if name in line]


@dataclass
class Visit:
    """A page that is open, and the fingers that lie on its screen."""

    page: Page
    cdp: CDPSession
    complaints: list[str]
    down: dict[int, float]

    def ask(self, expression: str) -> Any:
        return self.page.evaluate(expression)

    def picture(self) -> dict[str, Any]:
        found: dict[str, Any] = self.ask(
            """(() => { const p = tactable.wire.picture; return {
            command: p.command, drive: p.drive, isPlaying: p.isPlaying, age_s: p.age_s,
            latencies: p.latencies, last_ns: [...p.last_ns],
            made: p.made.slice(0, p.madeCount).map((f) => ({...f})),
            fingers: p.fingers.slice(0, p.fingerCount).map((f) => ({...f})) }; })()"""
        )
        return found

    def until(self, condition: str) -> dict[str, Any]:
        """The picture for which an expression of `p` holds."""
        self.wait(f"(() => {{ const p = tactable.wire.picture; return {condition}; }})()")
        return self.picture()

    def wait(self, condition: str) -> None:
        """Until it holds; asked from outside, for the page's policy lets nobody evaluate text within."""
        end_s = time.monotonic() + PATIENCE_S
        while not self.ask(condition):
            found = time.monotonic() < end_s or f"{self.picture()} {self.ask('JSON.stringify(tactable.scene)')}"
            assert found is True, f"{condition}: {found}"
            self.page.wait_for_timeout(20)

    def touch(self, **fingers: float | None) -> None:
        """Fingers by name: down or moved to a fraction of the bar, or lifted by None; all of one event."""
        before = dict(self.down)
        self.down.update({_number(name): place for name, place in fingers.items() if place is not None})
        lifted = [_number(name) for name, place in fingers.items() if place is None]
        for number in lifted:
            del self.down[number]
        kind = "touchEnd" if lifted else "touchStart" if self.down.keys() - before else "touchMove"
        # The end names those that lift, or nobody for all.
        shown = {number: before[number] for number in lifted} if lifted and self.down else self.down
        self.cdp.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": self._points(shown)})

    def bar(self) -> FloatRect:
        """The bar's rectangle, once it is in view: a switch that is taken may scroll the page."""
        bar = self.page.locator("#bar")
        bar.scroll_into_view_if_needed()
        box = bar.bounding_box()
        assert box is not None
        return box

    def click(self, share: float) -> None:
        """Press and let go of the mouse on the bar, at a fraction of its picture's width."""
        box = self.bar()
        self.page.mouse.click(box["x"] + share * box["width"], box["y"] + 0.7 * box["height"])

    def _points(self, fingers: dict[int, float]) -> list[dict[str, float]]:
        left, top, width = self.ask(
            """(() => { tactable.bar.canvas.scrollIntoViewIfNeeded();
            const p = tactable.bar.place(), box = tactable.bar.canvas.getBoundingClientRect();
            return [box.left + p.left, box.top + 0.76 * box.height, p.width]; })()"""
        )
        return [{"x": left + width * place, "y": top, "id": number} for number, place in fingers.items()]


def _number(name: str) -> int:
    return int(name.removeprefix("f"))


@contextmanager
def opened(
    demo: Demo,
    browser: Browser,
    size: tuple[int, int] = DESKTOP,
    scheme: str = "light",
    *,
    has_touch: bool = True,
    link: str = "#no-tour",
) -> Iterator[Visit]:
    """The page, once the engine runs; it must not complain of anything."""
    width, height = size
    context = browser.new_context(
        viewport={"width": width, "height": height},
        color_scheme="dark" if scheme == "dark" else "light",
        has_touch=has_touch,
    )
    page = context.new_page()
    visit = Visit(page, context.new_cdp_session(page), [], {})

    def note(message: ConsoleMessage) -> None:
        visit.complaints.append(message.text)

    page.on("console", note)
    page.on("pageerror", lambda error: visit.complaints.append(str(error)))
    page.goto(demo.url + link)
    visit.wait("window.tactable?.scene?.plays && tactable.wire.picture.levelCount > 0")
    try:
        yield visit
        assert visit.complaints == []
    finally:
        context.close()


def choose(visit: Visit, **switches: Any) -> None:
    """By the wire, as the switches do, until it plays."""
    visit.page.evaluate("(switches) => tactable.wire.choose(switches)", switches)
    for name, value in switches.items():
        visit.wait(
            f"JSON.stringify(tactable.scene.plays?.{name}) === {json.dumps(json.dumps(value, separators=(',', ':')))}"
        )


MADE = "p.made.slice(0, p.madeCount)"


def is_made_for(roles: str) -> str:
    """That the last command is for fingers with these zones and roles, such as "0:2,2:1"."""
    return f"{MADE}.map((f) => f.zone + ':' + f.role).join() === '{roles}'"


def kept(visit: Visit, roles: str) -> dict[str, Any]:
    """The picture in which a steady drive has become what was promised, to 0.3 dB under every finger.

    Later where the machine stalls: the firmware falls silent then, and the bar begins anew.
    """
    return visit.until(
        f"{is_made_for(roles)} && p.isPlaying && p.age_s > 1 && {MADE}.every((f) =>"
        " Math.abs(Math.max(f.simulated, -2000) - Math.max(f.promised, -2000)) < 30)"
    )


def settled(visit: Visit, count: int, touch: Callable[[], None]) -> dict[str, Any]:
    """Touch, with `count` fingers then: the picture 0.6 s after its command, or 2 s later where a stall left none."""
    before, start_ms = visit.ask("[tactable.wire.picture.command, performance.now()]")
    touch()
    is_new = f"p.command > 0 && p.command !== {before}"
    return visit.until(
        f"p.fingerCount === {count} && ({is_new} ? p.age_s > 0.6 : performance.now() > {start_ms + 2000})"
    )


def clicked(visit: Visit) -> dict[str, Any]:
    """A finger rests in III, another taps I and feels a click; again where the machine stalled, which lifts fingers."""
    for _ in range(20):
        settled(visit, 1, lambda: visit.touch(f1=THIRD))
        shown = settled(visit, 2, lambda: visit.touch(f2=FIRST))
        if [(finger["zone"], finger["role"]) for finger in shown["made"]] == [(0, FELT), (2, QUIET)]:
            return shown
        lift(visit)
    raise AssertionError("no click of two fingers came through")


def lift(visit: Visit) -> None:
    visit.touch(**{f"f{number}": None for number in list(visit.down)})
    visit.until("p.fingerCount === 0")
