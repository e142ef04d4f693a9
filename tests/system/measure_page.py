"""Latency of a run with the page attached and drawn by a browser, and without, in turns:

`python -m tests.system.measure_page TABLE [PAIRS]`. The machine should have nothing else to do.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, sync_playwright

from engine.sources.recording import write_recording
from engine.table import open_table
from firmware_link.emulator import run_emulator
from tactable.virtual_digitizer import Stroke, make_recording

TAPS, EVERY_S, DOWN_S = 100, 0.15, 0.08
_TACTABLE = str(Path(sys.executable).parent / "tactable")


def measure(table: Path, touches: Path, browser: Browser | None) -> dict[str, Any]:
    """`report_to_command` of one run; with a browser its page is attached and drawn."""
    page = ["--page"] if browser else []
    with open_table(table, verify=False) as opened:
        actuators = len(opened.device.actuators)
    with run_emulator(actuators) as emulator:
        words = [str(table), "--touch", str(touches), "--port", emulator.port, "--reconnect", "--json", *page]
        command = [_TACTABLE, "run", *words, "--bit-rate", "2000000"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
            assert run.stderr is not None
            looks = None
            if browser is not None:
                while not (found := re.search(r"http://\S+", run.stderr.readline())):
                    assert run.poll() is None
                looks = browser.new_page()
                looks.goto(found[0])
            told, said = run.communicate()
            assert run.returncode == 0, said
            frames = 0 if looks is None else looks.evaluate("tactable.bar.frames")
            if looks is not None:
                looks.close()
        figures: dict[str, Any] = json.loads(told)["report_to_command"]
    return {**figures, "frames_drawn": frames}


def main() -> None:
    """Pairs of runs, and the ratio of their medians."""
    table, pairs = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 3
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        touches = Path(folder) / "taps.hid"
        strokes = [Stroke(1 + EVERY_S * tap, 1 + EVERY_S * tap + DOWN_S, 0.1, 0.1) for tap in range(TAPS)]
        write_recording(make_recording(strokes), touches)
        words = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=words)
        for pair in range(pairs):
            for looked_on in (False, True):
                figures = measure(table, touches, browser if looked_on else None)
                sys.stdout.write(f"pair {pair} {'with' if looked_on else 'without'} the page: {json.dumps(figures)}\n")
                sys.stdout.flush()
        browser.close()


if __name__ == "__main__":
    main()
