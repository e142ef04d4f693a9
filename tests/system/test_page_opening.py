"""The browser that the demo opens, in Chromium: the page plays, and no command line holds its token."""

import contextlib
import os
import re
import shlex
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Playwright, expect

from tests.system.page import CHROMIUM, IN_CHROMIUM, PATIENCE_S, Demo, Visit

pytestmark = IN_CHROMIUM
PORT_FILE = "DevToolsActivePort"


@pytest.fixture
def opened(playwright: Playwright, demo_folder: Path, tmp_path: Path) -> Iterator[tuple[Demo, Visit]]:
    """A demo, and the page that is shown by the browser that it opened, as it says in $BROWSER."""
    profile = tmp_path / "profile"
    words = [str(CHROMIUM), "--headless=new", "--remote-debugging-port=0", f"--user-data-dir={profile}"]
    words += ["--no-sandbox"] if os.geteuid() == 0 else []
    demo = Demo(demo_folder, browser=f"{shlex.join(words)} %s &")
    try:
        while not (profile / PORT_FILE).is_file() or not (port := (profile / PORT_FILE).read_text().split()[:1]):
            assert demo.process is not None and demo.process.poll() is None
            time.sleep(0.05)
        browser = playwright.chromium.connect_over_cdp(f"http://127.0.0.1:{port[0]}")
        while not (browser.contexts and browser.contexts[0].pages):  # it has opened its port before its page
            time.sleep(0.05)
            browser.close()
            browser = playwright.chromium.connect_over_cdp(f"http://127.0.0.1:{port[0]}")
        page = browser.contexts[0].pages[0]
        yield demo, Visit(page, browser.contexts[0].new_cdp_session(page), [], {})
        browser.close()
    finally:
        # A browser that lives on would hold what the demo prints to.
        for process, line in command_lines():
            if str(profile) in line:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(process, signal.SIGKILL)
        demo.stop()


def command_lines() -> list[tuple[int, str]]:
    """Each process that runs, and its command line."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = path.read_bytes().replace(b"\0", b" ").decode(errors="replace")
            found.append((int(path.parent.name), line))
        except OSError:  # it has ended
            continue
    return found


@pytest.mark.machine(stall_s=None)
def test_the_page_that_is_opened_plays_and_no_command_line_holds_its_token(opened: tuple[Demo, Visit]) -> None:
    demo, visit = opened
    expect(visit.page).to_have_url(re.compile(re.escape(demo.url)), timeout=1e3 * PATIENCE_S)
    visit.wait("window.tactable?.scene?.plays && tactable.wire.picture.levelCount > 0")
    token, lines = demo.url.split("/")[3], [line for _, line in command_lines()]
    opening = demo.url.replace(token, "open")
    (ticket,) = {word for line in lines for word in line.split() if word.startswith(opening)}
    assert not [line for line in lines if token in line]
    assert httpx.get(ticket).status_code == 403  # whoever reads it there comes too late
