"""The example application in Chromium beside the page of the demo: buttons on the bar that move when let go."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from tests.system.page import CHROMIUM, Demo, choose, opened

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium: run tests/system/prepare.sh"),
]
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "buttons.html"
HITS = 6
PATIENCE_MS = 120_000
"""Only against a page that hangs."""
FINGERS = "document.querySelectorAll('.finger').length"
TOTAL_HITS = "[...buttons.values()].reduce((sum, button) => sum + button.hits, 0)"
PLACES = """[...buttons.values()].map((button) =>
    [parseFloat(button.style.left) / 100, parseFloat(button.style.width) / 100])"""
"""Start and width of every button, as fractions of the bar."""


@pytest.fixture
def demo(demo_folder: Path) -> Iterator[Demo]:
    demo = Demo(demo_folder, "--control", "--control-socket", "control.sock", "--control-port", "0")
    yield demo
    demo.stop()


def address_of(demo: Demo) -> str:
    """The address of the WebSocket, which the demo prints once it plays."""
    assert demo.process is not None and demo.process.stderr is not None
    while line := demo.process.stderr.readline():
        for word in line.split():
            if word.startswith("ws://"):
                return word
    raise AssertionError("the demo has ended")


def beside_buttons(page: Page) -> float:
    """A place, as a fraction of the bar, where no button is."""
    places = page.evaluate(PLACES)
    return next(
        at
        for at in (0.5, 0.05, 0.95, 0.3, 0.7)
        if not any(start - 0.03 <= at <= start + width + 0.03 for start, width in places)
    )


def test_buttons_move_under_the_fingers_of_the_demo_and_each_is_felt_where_it_is(demo: Demo, browser: Browser) -> None:
    with opened(demo, browser) as visit:
        page = browser.new_page()
        wrong: list[str] = []
        page.add_init_script("let drawn = 0; Math.random = () => (drawn += 0.37) % 1")  # never the same place
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(f"{EXAMPLE.as_uri()}#{address_of(demo)}")
        page.wait_for_function("document.querySelectorAll('.button').length === 2", timeout=PATIENCE_MS)
        commands = []
        for hit in range(HITS):
            if hit == HITS // 2:  # another run, in which the page's own rules would be felt everywhere
                choose(visit, source="steady")
            played = page.text_content("#played")
            visit.touch(f1=beside_buttons(page))
            page.wait_for_function(f"{FINGERS} === 1", timeout=PATIENCE_MS)
            visit.touch(f1=None)
            page.wait_for_function(f"{FINGERS} === 0", timeout=PATIENCE_MS)
            # Beside the buttons nothing is felt; what was felt last may have ended.
            assert page.text_content("#played") in (played, "silence, no promise")
            before = page.evaluate(PLACES)
            start, width = before[hit % 2]
            visit.touch(f1=start + width / 2)
            page.wait_for_function(f"{FINGERS} === 1 && {TOTAL_HITS} === {hit}", timeout=PATIENCE_MS)
            visit.touch(f1=None)
            page.wait_for_function(f"{TOTAL_HITS} === {hit + 1}", timeout=PATIENCE_MS)
            moved = f"(before) => {PLACES}[{hit % 2}][0] !== before"
            page.wait_for_function(moved, arg=start, timeout=PATIENCE_MS)
            commands.append(page.text_content("#played"))
        page.close()
    assert wrong == []
    assert all(said is not None and said.startswith("click") for said in commands)
