"""An experiment in Chromium from start to report: an observer feels what the run plays, and presses buttons."""

import json
import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from engine.device.threshold import read_threshold_file
from tactable.control.client import Client, connect
from tactable.experiment.observer import Observer
from tactable.experiment.protocol import read_protocol
from tactable.experiment.session import Role, Trial
from tactable.shipped import find_device
from tests.system.page import IN_CHROMIUM, PATIENCE_S, TACTABLE

pytestmark = IN_CHROMIUM
PROTOCOL = """
name = "short"
title = "A short one"
[[task]]
name = "tone"
kind = "detection"
stimulus = "tone"
duration = "100 ms"
fingers = ["75 mm"]
levels = ["-14 dB", "18 dB"]
step = "2 dB"
trials = 4
practice = 1
catch = 1
[[task]]
name = "kept"
kind = "felt-and-quiet"
fingers = ["45 mm", "170 mm"]
base = "12 dB"
trials = 1
practice = 0
catch = 0
"""
OBSERVER = Observer(threshold=6.0, slope=4.0, lapse=0.0)
SHOWN = """() => ({ kind: document.body.dataset.kind ?? "", text: text.textContent,
    lit: [...intervals.children].findIndex((each) => each.hasAttribute("data-lit")),
    choices: [...choices.children].filter((each) => !each.disabled).map((each) => each.textContent) })"""


@pytest.fixture
def started(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    (tmp_path / "short.toml").write_text(PROTOCOL, encoding="utf-8")
    command = [TACTABLE, "experiment", "short.toml", "--demo", "--control-socket", "control.sock"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stderr is not None
    for line in process.stderr:
        if found := re.search(r"http://\S+", line):
            yield found[0], process
            break
    process.terminate()
    process.communicate()


def test_an_observer_in_a_browser_gets_from_consent_to_a_report_and_a_curve(
    started: tuple[str, subprocess.Popen[str]], browser: Browser, tmp_path: Path
) -> None:
    """It knows what a person knows, which moment is lit and what is felt: levels come from the run, not the page."""
    url, process = started
    protocol = read_protocol(str(tmp_path / "short.toml"), find_device("reference-a"))
    page = browser.new_page(viewport={"width": 390, "height": 844})
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text))
    page.goto(url)
    answered, felt = 0, dict[int, tuple[float, int]]()
    with connect(tmp_path / "control.sock", name="the observer") as run:
        run.subscribe("played")
        for _ in range(PATIENCE_S * 50):
            page.wait_for_timeout(20)
            shown = page.evaluate(SHOWN)
            for level_db, finger in feel(run):
                felt[max(shown["lit"], 0)] = level_db, finger
            if shown["kind"] == "done":
                break
            if (pictures := os.environ.get("TACTABLE_PICTURES")) and shown["kind"]:
                page.screenshot(path=f"{pictures}/{shown['kind']}-{len(shown['choices'])}.png")
            if shown["kind"] == "question" and shown["choices"]:
                task = protocol.tasks[len(shown["choices"]) == 4]
                side = next(iter(felt), 0) if task.kind.has_intervals else next(iter(felt.values()), (0, 0))[1]
                strength = next((level_db for level_db, _ in felt.values()), None)
                trial = Trial(answered, task, Role.TEST, side, side, strength)
                page.keyboard.press(str(1 + OBSERVER.answer(trial, None)))
                answered, felt = answered + 1, {}
            elif len(shown["choices"]) == 1:
                assert "dB" not in shown["text"]
                page.get_by_role("button", name=shown["choices"][0]).click()
    assert complaints == [] and shown["kind"] == "done", shown
    said, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0 and "SIMULATED" in said
    folder = tmp_path / "experiment"
    described = json.loads((folder / "sub-01_task-short_beh.json").read_text())
    rows = (folder / "sub-01_task-short_beh.csv").read_text().splitlines()
    assert rows[0].split(",") == list(described["Columns"]) and len(rows) - 1 == answered == 8
    curve = read_threshold_file(folder / "sub-01_task-short_threshold.toml")
    assert curve.measured_hz is not None and 60 < curve.measured_hz[0] < 300
    assert (folder / "sub-01_task-short_report.png").stat().st_size > 10_000


def feel(run: Client) -> Iterator[tuple[float, int]]:
    """The level of each stimulus that was played since, and which finger it was made for, in their order."""
    for event in run.events(timeout_s=0.0):
        if event["event"] == "played" and event["level_db"] is not None:
            yield event["level_db"], [each["role"] for each in event["fingers"]].index("felt")
