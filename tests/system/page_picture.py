"""The picture of the live page in the README: `python -m tests.system.page_picture docs/page.png`, with Chromium."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

_SIZE = (1280, 1080)
_COMMAND = [str(Path(sys.executable).parent / "tactable"), "demo", "--no-open"]
_IS_TOLD = (
    "(({ made, madeCount, isLate, age_s }) => madeCount === 2 && !isLate && age_s < 1.5 && made[0].role === 2"
    " && made[1].role === 1 && Math.abs(made[0].simulated - made[0].promised) < 100"
    " && Math.abs(made[1].simulated - made[1].promised) < 400)(tactable.wire.picture)"
    " && tactable.courses._courses.length === 2"
)
_PLAYS = "window.tactable?.scene?.plays && tactable.scene.clicks > 0"


def draw(path: Path, command: list[str]) -> None:
    """Wait until the demo plays, put a finger into IV, tap I with another, and take the page's picture."""
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as demo, sync_playwright() as playwright:
        assert demo.stderr is not None
        url = next(word for word in demo.stderr.readline().split() if word.startswith("http"))
        words = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=words)
        page = browser.new_page(viewport={"width": _SIZE[0], "height": _SIZE[1]}, color_scheme="light")
        page.goto(url + "#no-tour")
        _wait(page, _PLAYS)
        while not page.evaluate(_IS_TOLD):  # again where the machine stalled, which lifts fingers
            page.keyboard.up("1")
            page.keyboard.up("4")
            _wait(page, "tactable.wire.picture.fingerCount === 0")
            page.keyboard.down("4")
            _wait(page, "tactable.wire.picture.fingerCount === 1 && tactable.wire.picture.age_s > 3")
            page.keyboard.down("1")
            _wait(page, "tactable.wire.picture.fingerCount === 2 && tactable.wire.picture.age_s > 0.8")
        page.screenshot(path=path)
        browser.close()
        demo.terminate()


def _wait(page: Page, condition: str) -> None:
    while not page.evaluate(condition):
        page.wait_for_timeout(20)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), _COMMAND)
