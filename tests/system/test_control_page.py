"""The example application of the control channel in Chromium: buttons on the bar that move when they are let go."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

from engine.touch.sources.recording import write_recording
from firmware_link.emulator.process import run_emulator
from tactable.shipped import find_device
from tests.engine.made_entries import entry_of, felt_states
from tests.engine.made_table import write_table
from tests.tactable.rig.strokes import Stroke, make_recording

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium: run tests/system/prepare.sh"),
]
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "buttons.html"
TACTABLE = str(Path(sys.executable).parent / "tactable")
DEVICE = find_device("reference-a")
TAPS, HITS = 900, 6
PATIENCE_MS = 120_000
"""Only against a page that hangs."""
TOTAL_HITS = "[...buttons.values()].reduce((sum, button) => sum + button.hits, 0)"


def test_buttons_move_under_taps_and_each_is_felt_where_it_is(tmp_path: Path) -> None:
    write_table(tmp_path / "bar.nc", DEVICE, [entry_of(DEVICE, felt_states(DEVICE)[0])], response=0.05)
    places = [((7 * tap) % 29 + 0.5) / 29 for tap in range(TAPS)]
    strokes = tuple(Stroke(0.2 * tap, 0.2 * tap + 0.1, place, place) for tap, place in enumerate(places))
    write_recording(make_recording(strokes), tmp_path / "taps.hid")
    with run_emulator() as emulator, sync_playwright() as playwright:
        words = ["bar.nc", "--touch", "taps.hid", "--port", emulator.port, "--reconnect", "--control"]
        words += ["--control-socket", str(tmp_path / "control.sock"), "--control-port", "0"]
        with subprocess.Popen([TACTABLE, "run", *words], cwd=tmp_path, stderr=subprocess.PIPE, text=True) as run:
            assert run.stderr is not None
            address = ""
            while not address:
                line = run.stderr.readline()
                assert line, "the run has ended"
                address = next((word for word in line.split() if word.startswith("ws://")), "")
            sandbox = ["--no-sandbox"] if os.geteuid() == 0 else []
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=sandbox)
            page = browser.new_page()
            wrong: list[str] = []
            page.on("pageerror", lambda error: wrong.append(str(error)))
            page.goto(f"{EXAMPLE.as_uri()}#{address}")
            page.wait_for_function("document.querySelectorAll('.button').length === 2", timeout=PATIENCE_MS)
            before = page.evaluate("[...buttons.values()].map((button) => button.style.left)")
            page.wait_for_function(f"{TOTAL_HITS} >= {HITS}", timeout=PATIENCE_MS)
            after = page.evaluate("[...buttons.values()].map((button) => button.style.left)")
            said = page.text_content("#played")
            browser.close()
            run.terminate()
            run.communicate()
        sounded = [
            event
            for event in emulator.stop().events
            if event.waveform is not None or any(channel.amplitude for channel in event.channels)
        ]
    assert wrong == []
    assert before != after
    assert said is not None and said.startswith(("drive", "silence", "click"))
    assert len(sounded) >= HITS  # every hit was pressed, and nothing was felt outside of buttons before
