"""The example application in Chromium beside the page of the demo: buttons on the bar that move when let go."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from tests.system.page import IN_CHROMIUM, Demo, Visit, choose, opened

pytestmark = IN_CHROMIUM
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "buttons.html"
HITS = 4
PATIENCE_MS = 120_000
"""Only against a page that hangs."""
FINGERS = "document.querySelectorAll('.finger').length"
TOTAL_HITS = "[...buttons.values()].reduce((sum, button) => sum + button.hits, 0)"
PLACES = """[...buttons.values()].map((button) =>
    [parseFloat(button.style.left) / 100, parseFloat(button.style.width) / 100])"""
"""Start and width of every button, as fractions of the bar."""
COUNT_CLICKS = """window.clicks = 0;
    const count = () => { clicks += played.textContent.startsWith("click"); };
    new MutationObserver(count).observe(played, { childList: true })"""
"""Every command that the application shows is counted if it is a click."""


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
        page.evaluate(COUNT_CLICKS)
        for hit in range(HITS):
            if hit == HITS // 2:  # another run, in which the page's own rules would be felt everywhere
                choose(visit, source="steady")
            tap(visit, page, beside_buttons(page))  # by its end, what the button before played is counted
            before = page.evaluate("clicks")
            tap(visit, page, beside_buttons(page))
            assert page.evaluate("clicks") == before, "beside the buttons nothing is felt"
            is_felt_at(visit, page, hit % 2)
        page.close()
    assert wrong == []


def is_felt_at(visit: Visit, page: Page, button: int) -> None:
    """A button that is touched clicks, and moves when it is let go; again where the machine stalled in its click."""
    for _ in range(20):
        hits, clicks = page.evaluate(f"[{TOTAL_HITS}, clicks]")
        start, width = page.evaluate(PLACES)[button]
        tap(visit, page, start + width / 2)
        page.wait_for_function(f"{TOTAL_HITS} > {hits}", timeout=PATIENCE_MS)
        page.wait_for_function(f"{PLACES}[{button}][0] !== {start}", timeout=PATIENCE_MS)
        if page.evaluate("clicks") > clicks:
            return
    raise AssertionError("no button clicked")


def tap(visit: Visit, page: Page, place: float) -> None:
    """A finger comes and goes, and the application sees it; a stalled machine lifts it sooner and brings it back."""
    visit.touch(f1=place)
    page.wait_for_function(f"{FINGERS} === 1", timeout=PATIENCE_MS)
    visit.touch(f1=None)
    page.wait_for_function(f"{FINGERS} === 0", timeout=PATIENCE_MS)
