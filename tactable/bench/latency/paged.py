"""A page that looks on while the engine is measured, and a browser without a screen that draws it."""

import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tactable.page.attach import PageOf, page_of
from tactable.page.security import LOOPBACK

_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_LOADED_S = 3.0
"""Until a browser draws; what it costs to start is not what is asked."""
# As root, as in a container, a browser runs without its own sandbox; it sees only our page.
_OPTIONS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")


def find_browser() -> str | None:
    """A browser that draws without a screen; None: the page is served and nobody looks."""
    return next(filter(None, map(shutil.which, _BROWSERS)), None)


@contextmanager
def page_on(ring: Path, table: Path, frequency_resolution_hz: float) -> Iterator[None]:
    """Serve the page of a run, and draw it, until the end. Raises OSError where there is no port for it."""
    with page_of(PageOf(ring, table, frequency_resolution_hz, LOOPBACK[0], 0)) as lines, _drawing(_url_of(lines)):
        yield


def _url_of(lines: list[str]) -> str:
    return next(word for line in lines for word in line.split() if word.startswith("http://"))


@contextmanager
def _drawing(url: str) -> Iterator[None]:
    browser = find_browser()
    if browser is None:
        yield
        return
    with tempfile.TemporaryDirectory(prefix="tactable-browser-", ignore_cleanup_errors=True) as profile:
        command = [browser, *_OPTIONS, f"--user-data-dir={profile}", "--remote-debugging-port=0", url]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            time.sleep(_LOADED_S)
            yield
        finally:
            process.terminate()
            process.wait()
