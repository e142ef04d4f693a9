"""What was tried to break the page: stalls, a closed lid, other browsers, reloads, too many fingers, garbage.

docs/page.md lists these tests. After each of them a click goes through, and the demo ends without a traceback.
"""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser

from tactable.shipped import find_device_file
from tests.system.page import FIRST, IN_CHROMIUM, SECOND, STEADY, THIRD, Demo, Visit, choose, clicked, lift, opened

pytestmark = IN_CHROMIUM
# Shorter than the watchdog, longer than it, and longer than fingers are kept; the lid is closed for longer.
STALLS_S = (0.1, 0.5, 1.5)
LID_S = 2.0
PARTS = {"engine": "processes.engine", "firmware": "processes.firmware"}


def processes(demo: Demo, part: str) -> list[int]:
    """The server itself, one of its processes, or all of them."""
    assert demo.process is not None
    if part == "all":
        return [demo.process.pid, *demo.children("processes.")]
    return [demo.process.pid] if part == "server" else demo.children(PARTS[part])


NOTE_SENTENCES = """window.said = [], sentence = document.getElementById("outcome"),
    new MutationObserver(() => said.push(sentence.textContent)).observe(sentence, { childList: true }); 0"""


@contextmanager
def stopped(demo: Demo, part: str, seconds: float) -> Iterator[None]:
    """Processes that stand still during the block, and for so long after it."""
    found = processes(demo, part)
    for process in found:
        os.kill(process, signal.SIGSTOP)
    try:
        yield
        time.sleep(seconds)
    finally:
        for process in found:
            os.kill(process, signal.SIGCONT)


def clicks_on(visit: Visit) -> None:
    """A new touch gets a command of its own, and its finger is there, not one from before; then it lifts."""
    before = visit.until("p.fingerCount === 0")["command"]
    visit.touch(f1=FIRST)
    visit.until(f"p.fingerCount === 1 && p.command > 0 && p.command !== {before} && p.fingers[0].zone === 0")
    lift(visit)


def test_stalls_lose_nothing(demo: Demo, browser: Browser) -> None:
    with opened(demo, browser) as visit:
        for part in "engine", "firmware", "server":
            a_stall_of_any_part_loses_nothing(demo, part, visit)
        a_closed_lid_loses_nothing(demo, visit)


def a_stall_of_any_part_loses_nothing(demo: Demo, part: str, visit: Visit) -> None:
    choose(visit, source="click", quiet_zones=[])
    for seconds in STALLS_S:
        with stopped(demo, part, seconds):
            visit.touch(f1=SECOND)
        visit.touch(f1=None)
        clicks_on(visit)
    assert visit.ask("tactable.scene.status") == "running"


def a_closed_lid_loses_nothing(demo: Demo, visit: Visit) -> None:
    choose(visit, source="steady", quiet_zones=[])
    visit.touch(f1=FIRST)
    visit.until("p.fingerCount === 1 && p.isPlaying")
    with stopped(demo, "all", LID_S):
        pass
    lift(visit)
    visit.until("!p.isPlaying")
    choose(visit, source="click")
    visit.until("p.command === 0")  # of the next run, which counts anew
    clicks_on(visit)


def test_what_is_late_or_dies_comes_back_and_the_page_says_so(demo: Demo, browser: Browser) -> None:
    with opened(demo, browser) as visit:
        the_tour_waits_for_an_engine_that_is_late(demo, visit)
        a_run_that_begins_anew_under_the_tour_changes_no_sentence(demo, visit)
        a_server_that_comes_back_is_found_again(demo, visit)


def the_tour_waits_for_an_engine_that_is_late(demo: Demo, visit: Visit) -> None:
    choose(visit, source="click", quiet_zones=[])
    visit.ask(NOTE_SENTENCES)
    with stopped(demo, "engine", 0):
        visit.page.click("#show-me")
        visit.page.wait_for_timeout(1800)
        assert visit.ask("tactable.fingers.down.size") == 1  # the second finger taps once the first is told
    visit.wait("said.some((each) => each.includes('dB more than finger'))")
    said = visit.ask("tactable.fingers.stopTour(), said")
    assert not any(sentence.startswith("Two clicks overlapped") for sentence in said)


def a_run_that_begins_anew_under_the_tour_changes_no_sentence(demo: Demo, visit: Visit) -> None:
    """Its resting finger feels a click then, as it comes down again, and the tapping one has left."""
    choose(visit, source="click", quiet_zones=[])
    restarts = visit.ask("tactable.scene.restarts")
    visit.ask(NOTE_SENTENCES)
    visit.ask("tactable.fingers.startTour(tactable.fingers.zones[1], tactable.fingers.zones[0], 2)")  # of two taps
    visit.wait("said.some((each) => each.startsWith('Finger 2 taps')) && /dB more than finger.1/.test(said.at(-1))")
    visit.ask("said.length = 0")
    for process in processes(demo, "engine"):
        os.kill(process, signal.SIGKILL)
    visit.wait("tactable.fingers.says?.startsWith('Your turn')")
    assert visit.ask("tactable.scene.restarts") == restarts + 1
    said = [each.replace("\N{NO-BREAK SPACE}", " ") for each in visit.ask("said")]
    kept = ("Finger 2 feels the click", "The machine was late", "Your turn")
    assert all(each.startswith(kept) for each in said), said
    visit.wait("document.getElementById('status').textContent === 'engine runs'")
    clicks_on(visit)


def a_server_that_comes_back_is_found_again(demo: Demo, visit: Visit) -> None:
    connections = visit.ask("tactable.wire.connections")
    demo.stop()
    visit.wait("document.getElementById('status').textContent === 'the demo is over'")
    demo.start()
    visit.wait(f"tactable.wire.connections === {connections + 1} && tactable.scene.status === 'running'")
    clicks_on(visit)
    visit.complaints[:] = [text for text in visit.complaints if "ERR_CONNECTION_REFUSED" not in text]


def test_nothing_that_browsers_do_or_send_hurts_another(demo: Demo, browser: Browser) -> None:
    with opened(demo, browser) as visit:
        a_second_browser_sees_the_same_and_takes_no_finger_along(demo, browser, visit)
        a_page_that_is_loaded_again_in_mid_click_leaves_no_finger_behind(visit)
        more_fingers_than_ten_are_left_out(visit)
        a_device_file_that_is_dropped_plays_and_a_wrong_one_is_told(visit)


def a_second_browser_sees_the_same_and_takes_no_finger_along(demo: Demo, browser: Browser, visit: Visit) -> None:
    choose(visit, source="steady", quiet_zones=[])
    visit.touch(f1=FIRST)
    visit.until("p.fingerCount === 1 && p.isPlaying")
    with opened(demo, browser) as other:
        other.until("p.fingerCount === 1 && p.isPlaying")
        other.touch(f1=THIRD)
        visit.until("p.fingerCount === 2")
    visit.until("p.fingerCount === 1 && p.isPlaying")
    lift(visit)
    choose(visit, source="click")


def a_page_that_is_loaded_again_in_mid_click_leaves_no_finger_behind(visit: Visit) -> None:
    choose(visit, source="click", quiet_zones=[])
    for _ in range(5):
        visit.ask(f"tactable.wire.touch(77, 0, {FIRST}, 0.5); tactable.wire.flush()")
        visit.page.reload()
        visit.wait("window.tactable?.scene?.plays && tactable.wire.picture.levelCount > 0")
    visit.until("p.fingerCount === 0")
    clicks_on(visit)


def more_fingers_than_ten_are_left_out(visit: Visit) -> None:
    choose(visit, source="steady", quiet_zones=[])
    visit.ask(
        """window.many = setInterval(() => { for (let i = 0; i < 40; i++)
        tactable.wire.touch(100 + i, 0, (i + 0.5) / 40, 0.5); tactable.wire.flush(); }, 50)"""
    )
    visit.until("p.fingerCount === 10")
    visit.ask("clearInterval(window.many)")
    visit.until("p.fingerCount === 0")  # they were not heard of for a second
    choose(visit, source="click")
    visit.until("p.command === 0")  # of the next run, which counts anew
    clicks_on(visit)


def a_device_file_that_is_dropped_plays_and_a_wrong_one_is_told(visit: Visit) -> None:
    drop = """([name, text]) => { const dataTransfer = new DataTransfer();
        dataTransfer.items.add(new File([text], name));
        window.dispatchEvent(new DragEvent("drop", { dataTransfer, cancelable: true })); }"""
    text = (
        find_device_file("reference-d").read_text(encoding="utf-8").replace('name = "reference-d"', 'name = "dropped"')
    )
    choose(visit, source="click", quiet_zones=[])
    clicked(visit)
    visit.wait("tactable.courses.isDrawn")
    lift(visit)
    visit.page.evaluate(drop, ["wrong.toml", text.replace('length = "', 'length = "x')])
    visit.wait("tactable.scene.trouble.startsWith('wrong.toml: bar.length: ')")
    assert "expected a length such as" in visit.page.inner_text("#notice")
    visit.page.evaluate(drop, ["my bar.toml", text])
    visit.wait("tactable.scene.device.name === 'dropped' && tactable.scene.plays?.device.endsWith('/my-bar.toml')")
    assert not visit.ask("tactable.courses.isDrawn")  # they are another bar's
    visit.touch(f1=FIRST)
    assert visit.until("p.fingerCount === 1 && p.command > 0")["drive"] == STEADY
    lift(visit)
    choose(visit, device="small.toml", source="click")
