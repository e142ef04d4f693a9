"""The chain from touches to the bar: what the table promises is what the simulated bar does."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.device import Device
from engine.effects import Effect, Effects, Rule, Segment, Trigger
from engine.effects.rules import burst
from engine.table import Entry, Table
from engine.table.entry import DEFAULT_LEVEL_DB
from engine.touch import ZoneState
from engine.touch.sources.recording import read_recording
from firmware_link.emulator import Cause, DriveEvent, PlayedWaveform
from precompute.builder.build import build_table
from precompute.clicks import ClickOptions
from tactable.rig.bar import ENVELOPE_S, Simulated, SimulatedBar
from tactable.rig.demo import find_missed
from tactable.rig.demo_reports import AGREEMENT, ClickReport, StateReport
from tactable.rig.rig import LiveRun, Wanted, first_applied, play, wanted_of
from tactable.shipped import DEMO_RECORDING, find_device
from tests.engine.shared_recordings import recording_params

TACTABLE = str(Path(sys.executable).parent / "tactable")
SHORTEST_S = 0.5
CHEAP = ClickOptions(scenarios=8, trimmed=20, judged=20)
BURSTS = Effects((Rule(Trigger.TOUCH, burst(DEFAULT_LEVEL_DB, 50)),))
HELD = Effects((Rule(Trigger.TOUCH, Effect("held", (Segment(None, DEFAULT_LEVEL_DB),))),))


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Table:
    """reference-a on a coarse sweep, beside its description: its entries are searched on their own refined grid."""
    folder = tmp_path_factory.mktemp("table")
    text = find_device("reference-a").text.replace('step = "1 Hz"', 'step = "8 Hz"')
    (folder / "bar.toml").write_text(text, encoding="utf-8")
    coarse = Device.read(folder / "bar.toml")
    build_table(coarse, folder / "bar.nc", created="test", clicks_up_to=2, click_options=CHEAP)
    return Table.open(folder / "bar.nc", device=coarse)


class Bench:
    """Measures each drive once, whichever recording asked for it."""

    def __init__(self, table: Table) -> None:
        self.table = table
        self.bar = SimulatedBar(table.device)
        self.known: dict[Wanted, StateReport] = {}

    def report(self, wanted: Wanted, event: DriveEvent) -> StateReport:
        """What a state at a level does when the drive that the firmware got is held."""
        if wanted not in self.known:
            entry = self.table.entry_at(wanted.state, wanted.level_db)
            assert entry is not None
            self.known[wanted] = StateReport(entry, self.bar.simulate_held(event, entry), 0.0, 0.0)
        return self.known[wanted]


@pytest.fixture(scope="module")
def bench(table: Table) -> Bench:
    return Bench(table)


@pytest.mark.parametrize("path", recording_params("touch", "*.hid"))
def test_a_real_recording_renders_what_was_promised(path: Path, table: Table, bench: Bench) -> None:
    recording = read_recording(path)
    duration_s = recording.reports[-1].time_s - recording.reports[0].time_s if recording.reports else 0.0
    run = play(table, recording, max(1.0, duration_s / SHORTEST_S), BURSTS)
    assert run.counters.reports == len(recording.reports)
    for key, event in first_applied(run).items():
        assert bench.report(key, event).disagreement <= AGREEMENT


def test_every_finger_of_the_demo_touches_is_promised_what_it_gets(table: Table, bench: Bench) -> None:
    """Fingers that feel as long as they touch, so that many states are rendered; quiet ones by a second rule."""
    quiet_in_the_middle = Rule(Trigger.TOUCH, Effect("nothing", (Segment(None, None),)), zones=frozenset({2}))
    applied = dict[Wanted, DriveEvent]()
    for effects in (HELD, Effects((quiet_in_the_middle, *HELD.rules))):
        applied |= first_applied(play(table, read_recording(DEMO_RECORDING), 10.0, effects))
    reports = [bench.report(key, event) for key, event in applied.items()]
    assert any(report.zones_in(ZoneState.QUIET) for report in reports)
    assert max(len(report.felt_zones) for report in reports) > 1
    assert max(report.disagreement for report in reports) <= AGREEMENT


def test_the_demo_tells_all_of_it_and_draws_it(tmp_path: Path, table: Table) -> None:
    built = ["--device", str(table.path.with_name("bar.toml")), "--table", str(table.path)]
    words = ["demo", "--json", "--figure", "demo.png", "--recording", str(DEMO_RECORDING), *built]
    done = subprocess.run([TACTABLE, *words], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr + done.stdout
    report = json.loads(done.stdout)
    assert report["agrees"]
    assert report["simulated"]
    assert report["touch_frames"] == 692
    rendered = {(tuple(click["felt"]), tuple(click["quiet"])) for click in report["clicks"]}
    alone = {(("I",), ()), (("III",), ()), (("II", "IV"), ())}
    # A machine that stalls while a click lasts does not render it, and says so.
    assert rendered <= {*alone, (("III",), ("I",)), (("V",), ("I", "III"))}
    # The table of the demo has clicks for two fingers: the third gets a steady drive.
    assert len(report["states"]) <= 1
    assert len(rendered) + len(report["states"]) + len(report["states_not_rendered"]) == 5
    assert {click["wanted_level_db"] for click in report["clicks"]} == {20.0}
    assert report["commands_applied"] + report["commands_late"] == report["commands_sent"] > 0
    assert (tmp_path / "demo.png").stat().st_size > 10_000


@pytest.mark.parametrize("faults", ["stall=0.06s/0.2s", "delay=30ms,jitter=30ms", "stall=0.3s/0.9s"])
def test_a_run_over_a_line_that_stalls_breaks_no_promise(table: Table, faults: str) -> None:
    """The firmware refuses what comes late, and whatever it takes is what the table has for the state."""
    run = play(table, read_recording(DEMO_RECORDING), 4.0, BURSTS, faults=faults)
    applied = first_applied(run)
    for key, event in applied.items():
        entry = table.entry_at(key.state, key.level_db)
        assert entry is not None
        drives = [(channel.frequency_hz, channel.amplitude) for channel in event.channels if channel.amplitude]
        tones = zip(entry.frequencies_hz, entry.amplitudes, strict=True)
        assert drives == [pytest.approx(tone, abs=5e-3) for tone in tones if tone[1] > 1e-4]
    missed, not_rendered = find_missed(table, run, applied)
    assert missed == ()
    assert run.log.faults["to_device.delayed"] > 0 or "delay=" in faults
    felt = {wanted for change in run.trace if (wanted := wanted_of(change)) is not None}
    assert felt == {*applied, *not_rendered}


def test_a_command_that_the_firmware_took_and_did_not_drive_is_missed(table: Table) -> None:
    run = play(table, read_recording(DEMO_RECORDING), 4.0, BURSTS)
    key = next(iter(first_applied(run)))
    silent = tuple(event for event in run.log.events if event.cause is not Cause.SET)
    deaf = replace(run, log=replace(run.log, events=silent))
    assert key in find_missed(table, deaf, first_applied(deaf))[0]
    unheard = replace(run, log=replace(run.log, events=(), received=()))
    assert key in find_missed(table, unheard, first_applied(unheard))[0]


@pytest.fixture(scope="module")
def rendered(table: Table) -> tuple[Entry, DriveEvent]:
    """A state with a felt and a quiet finger, and the event that it caused in the firmware."""
    applied = first_applied(play(table, read_recording(DEMO_RECORDING), 3.0, BURSTS))
    entries = {key: table.entry_at(key.state, key.level_db) for key in applied}
    key, entry = next((k, e) for k, e in entries.items() if e is not None and ZoneState.QUIET in e.states)
    return entry, applied[key]


def changed(entry: Entry, state: ZoneState, name: str, factor: float) -> Entry:
    """The entry with a greater promise in the zones of one state."""
    zones = (replace(z, **{name: factor * getattr(z, name)}) if z.state is state else z for z in entry.zones)
    return replace(entry, zones=tuple(zones))


def test_a_broken_promise_is_found(bench: Bench, rendered: tuple[Entry, DriveEvent]) -> None:
    entry, event = rendered
    simulated = bench.bar.simulate_held(event, entry)
    assert StateReport(entry, simulated, 0.0, 0.0).disagreement <= AGREEMENT
    boasts = [
        replace(entry, localized_factor=1.03 * entry.localized_factor),
        changed(entry, ZoneState.FELT, "peak_acceleration_m_per_s2", 1.03),
        changed(entry, ZoneState.FELT, "acceleration_at_finger_m_per_s2", 0.97),
        changed(entry, ZoneState.QUIET, "acceleration_at_finger_m_per_s2", 0.97),
    ]
    assert all(StateReport(boast, simulated, 0.0, 0.0).disagreement > AGREEMENT for boast in boasts)
    louder = replace(event, channels=tuple(replace(c, amplitude=1.03 * c.amplitude) for c in event.channels))
    assert StateReport(entry, bench.bar.simulate_held(louder, entry), 0.0, 0.0).disagreement > AGREEMENT


def test_a_promise_for_fingers_is_not_kept_without_them(bench: Bench, rendered: tuple[Entry, DriveEvent]) -> None:
    entry, event = rendered
    without = replace(entry, zones=tuple(replace(zone, state=ZoneState.FREE) for zone in entry.zones))
    untouched = replace(
        bench.bar.simulate_held(event, without), at_finger=bench.bar.simulate_held(event, entry).at_finger
    )
    assert StateReport(entry, untouched, 0.0, 0.0).disagreement > AGREEMENT


def test_the_level_in_the_run_is_the_promised_one_where_the_acceleration_is(table: Table) -> None:
    entry = table.entry_for(["I"])
    promise = entry.zones[0]
    at_finger, promised_db = promise.acceleration_at_finger_m_per_s2, promise.sensation_level_db
    assert at_finger is not None and promised_db is not None
    report = StateReport(entry, Simulated(*[np.zeros(0)] * 5), 0.0, 0.0)
    assert report.level_db(at_finger) == pytest.approx(promised_db)
    assert report.level_db(10 * at_finger) == pytest.approx(promised_db + 20)
    assert report.level_db(0.0) is None


def test_fingers_are_told_apart_by_what_they_are_to_feel(table: Table, bench: Bench) -> None:
    run = play(table, read_recording(DEMO_RECORDING), 2.0, BURSTS)
    felt = bench.bar.feel(run, 13.0)
    starts_s = [(change.time_ns - run.trace[0].time_ns) / 1e9 for change in run.trace]
    rings_until_s = 0.0
    for change, start_s, stop_s in zip(run.trace, starts_s, starts_s[1:], strict=False):
        during = (felt.time_s >= max(start_s, rings_until_s)) & (felt.time_s + ENVELOPE_S <= stop_s)
        if change.level_db is None:
            assert not felt.felt[during].any()
        else:
            rings_until_s = stop_s + 0.2 + ENVELOPE_S
            assert not during.any() or felt.felt[during].max() > 0


@pytest.fixture(scope="module")
def clicked(table: Table) -> tuple[LiveRun, dict[Wanted, DriveEvent]]:
    """The demo's touches with a click for each."""
    run = play(table, read_recording(DEMO_RECORDING), 3.0)
    return run, {wanted: event for wanted, event in first_applied(run).items() if event.waveform is not None}


def click_report(table: Table, bar: SimulatedBar, wanted: Wanted, event: DriveEvent) -> ClickReport:
    click = table.click_at(wanted.state, wanted.level_db)
    assert click is not None
    return ClickReport(click, bar.simulate_click(event, click.states), 0.0, 0.0)


def test_every_click_of_the_demo_does_what_was_promised(
    table: Table, bench: Bench, clicked: tuple[LiveRun, dict[Wanted, DriveEvent]]
) -> None:
    _, applied = clicked
    assert applied
    assert all(wanted.is_click for wanted in applied)
    for wanted, event in applied.items():
        report = click_report(table, bench.bar, wanted, event)
        assert report.disagreement <= AGREEMENT
        felt = report.felt_zones[0]
        promise = report.click.zones[felt]
        assert promise is not None
        at_promise = report.level_db(felt, promise.acceleration_at_finger_m_per_s2)
        assert at_promise == pytest.approx(promise.level_db)


def test_a_broken_promise_of_a_click_is_found(
    table: Table, bench: Bench, clicked: tuple[LiveRun, dict[Wanted, DriveEvent]]
) -> None:
    _, applied = clicked
    (wanted, event), *_ = applied.items()
    assert event.waveform is not None
    louder = replace(event, waveform=replace(event.waveform, amplitude=1.03 * event.waveform.amplitude))
    assert click_report(table, bench.bar, wanted, louder).disagreement > AGREEMENT
    reversed_samples = event.waveform.samples[::-1]
    other = replace(event, waveform=PlayedWaveform.of(event.waveform.sample_rate_hz, reversed_samples, 1.0))
    assert click_report(table, bench.bar, wanted, other).disagreement > AGREEMENT


def test_what_rings_down_counts_as_felt_by_the_finger_that_felt_it(
    bench: Bench, clicked: tuple[LiveRun, dict[Wanted, DriveEvent]]
) -> None:
    run, _ = clicked
    first = next(change for change in run.trace if change.is_click)
    felt = bench.bar.feel(run, 13.0)
    start_s = (first.time_ns - run.trace[0].time_ns) / 1e9
    ringing = (felt.time_s >= start_s + 0.03) & (felt.time_s < start_s + 0.15)
    assert felt.felt[ringing].max() > 0
    assert not felt.quiet[ringing].any()
