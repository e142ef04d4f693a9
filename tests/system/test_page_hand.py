"""A drive by hand on the page, in Chromium: sliders move the bar, on a desktop and on a phone."""

import pytest
from playwright.sync_api import Browser

from tests.system.page import CHROMIUM, CLICK, DESKTOP, FIRST, PHONE, STEADY, Demo, choose, lift, opened

pytestmark = [
    pytest.mark.machine,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium: run tests/system/prepare.sh"),
]


@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_sliders_drive_the_bar_and_fingers_play_again_afterwards(
    demo: Demo, browser: Browser, size: tuple[int, int]
) -> None:
    with opened(demo, browser, size) as visit:
        page = visit.page
        page.get_by_label("By hand", exact=True).check(force=True)
        visit.until(f"p.drive === {STEADY} && p.isPlaying && !p.madeCount && p.age_s > 0.5")
        assert page.locator("#paper").is_hidden()
        sliders = page.locator("#hand input")
        assert sliders.count() == 6
        assert page.get_by_label("frequency of left").is_visible()
        page.get_by_label("amplitude of left").fill("40")
        page.get_by_label("phase of right").fill("90")
        visit.until("Math.abs(p.amplitude[0] - 0.4) < 1e-6 && Math.abs(p.phase_rad[1] - Math.PI / 2) < 1e-6")
        visit.wait("/^By hand: .?\\d+ dB at \\d+ mm, .?\\d+ dB at \\d+ mm\\.$/.test(outcome.textContent)")
        # Nothing reaches over the edge of the screen.
        assert visit.ask("document.documentElement.scrollWidth <= innerWidth")
        assert visit.ask("rules.disabled && level.disabled && !source.disabled")
        choose(visit, source="click")
        visit.wait("hand.hidden")
        visit.ask("scrollTo(0, 0)")  # on a phone the sliders are below the bar
        visit.touch(f1=FIRST)
        visit.until(f"p.drive === {CLICK} && p.madeCount === 1")
        lift(visit)


def test_a_drive_beyond_a_limit_changes_nothing_and_is_told(demo: Demo, browser: Browser) -> None:
    with opened(demo, browser) as visit:
        choose(visit, source="hand")
        visit.ask("tactable.wire.choose({hand: [[150, 2, 0], [150, 0, 0]]})")
        visit.wait("notice.textContent.includes('actuator left: 200 %')")
        visit.until("p.isPlaying && p.amplitude[0] < 1.5")
        choose(visit, source="click")
