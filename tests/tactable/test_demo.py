"""The chain from touches to the bar: what the table promises is what the simulated bar does."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from engine.device import Device
from engine.sources.recording import read_recording
from engine.table import Table, open_table
from precompute.build import build_table
from tactable.demo import AGREEMENT, StateReport
from tactable.rig import Measured, SimulatedBar, first_applied, play
from tactable.shipped import DEMO_RECORDING, find_device
from tests.engine.shared_recordings import recording_params

TACTABLE = str(Path(sys.executable).parent / "tactable")
SHORTEST_S = 0.5


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Table:
    """reference-a on a coarse sweep: its entries are searched on their own refined grid."""
    device = find_device("reference-a")
    text = device.text.replace('step = "1 Hz"', 'step = "8 Hz"')
    coarse = replace(device, sweep=replace(device.sweep, step_hz=8.0), text=text)
    path = tmp_path_factory.mktemp("table") / "bar.nc"
    build_table(coarse, path, created="test")
    return open_table(path, device=coarse)


class Bench:
    """Measures each drive once, whichever recording asked for it."""

    def __init__(self, device: Device) -> None:
        self.bar = SimulatedBar(device)
        self.known: dict[object, Measured] = {}


@pytest.fixture(scope="module")
def bench(table: Table) -> Bench:
    return Bench(table.device)


@pytest.mark.parametrize("path", recording_params("touch", "*.hid"))
def test_a_real_recording_renders_what_was_promised(path: Path, table: Table, bench: Bench) -> None:
    recording = read_recording(path)
    duration_s = recording.reports[-1].time_s - recording.reports[0].time_s if recording.reports else 0.0
    run = play(table, recording, max(1.0, duration_s / SHORTEST_S))
    assert run.counters.reports == len(recording.reports)
    entries = {entry.index: entry for entry in table.entries}
    for state, event in first_applied(run, list(entries)).items():
        if event.channels not in bench.known:
            bench.known[event.channels] = bench.bar.measure_held(event, entries[state])
        report = StateReport(entries[state], bench.known[event.channels], 0.0)
        assert report.disagreement <= AGREEMENT


def test_the_demo_tells_all_of_it_and_draws_it(tmp_path: Path) -> None:
    words = ["demo", "--json", "--figure", "demo.png", "--table", "a.nc", "--recording", str(DEMO_RECORDING)]
    done = subprocess.run([TACTABLE, *words], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr + done.stdout
    report = json.loads(done.stdout)
    assert report["agrees"]
    assert report["simulated"]
    assert report["touch_frames"] == 692
    felt = [tuple(state["felt"]) for state in report["states"]]
    assert {("I",), ("II",), ("III",), ("IV",), ("V",), ("I", "III", "V"), ("II", "IV")} <= set(felt)
    assert report["commands_applied"] == report["commands_sent"] > 0
    assert (tmp_path / "demo.png").stat().st_size > 10_000


def test_a_broken_promise_is_found(table: Table, bench: Bench) -> None:
    run = play(table, read_recording(DEMO_RECORDING), 20.0)
    entries = {entry.index: entry for entry in table.entries}
    state, event = next(iter(first_applied(run, list(entries)).items()))
    entry = entries[state]
    measured = bench.bar.measure_held(event, entry)
    assert StateReport(entry, measured, 0.0).disagreement <= AGREEMENT
    boast = replace(entry, localized_factor=min(1.0, 1.03 * entry.localized_factor))
    assert StateReport(boast, measured, 0.0).disagreement > AGREEMENT
    louder = replace(event, channels=tuple(replace(c, amplitude=1.03 * c.amplitude) for c in event.channels))
    assert StateReport(entry, bench.bar.measure_held(louder, entry), 0.0).disagreement > AGREEMENT
