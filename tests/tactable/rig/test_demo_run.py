"""The chain from touches to the bar: what the table promises is what the simulated bar does."""

import io
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from engine.device import Device
from engine.effects.rules import DEFAULT_EFFECTS, Drives, Effect, Effects, Rule, Segment, Trigger, burst
from engine.table import ClickEntry, Table
from engine.table.best_rows import BestRows
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.touch import Placement, open_digitizer
from engine.touch.sources.recording import Playback, Recording, read_recording, write_recording
from firmware_link.emulator.drive_log import Cause, DriveEvent
from firmware_link.emulator.emulator_process import decode_log
from firmware_link.host.serial_port import ReopeningPort
from precompute.builder.table_build import build_table
from precompute.clicks import ClickOptions, ClickSolver
from tactable.figures.demo_picture import draw_demo
from tactable.rig import demo_run
from tactable.rig.demo_page import print_demo
from tactable.rig.demo_run import (
    AGREEMENT,
    ClickReport,
    DemoReport,
    DriveReport,
    Reporter,
    demo_json,
    find_missed,
    run_demo,
)
from tactable.rig.emulate import configuration_of
from tactable.rig.promises import Promises
from tactable.rig.rig import LiveRun, Wanted, first_applied, play_to, wanted_of
from tactable.run.click_process import solver_of
from tactable.shipped import DEMO_RECORDING, find_device
from tests.engine.made_table import rows_of
from tests.engine.shared_recordings import recording_params
from tests.precompute.builder.test_table_build import SMALL
from tests.tactable.cli.in_process import summary_of
from tests.tactable.page.test_live_bar import PLATE
from tests.tactable.rig.strokes import DEMO_STROKES, Stroke, make_recording
from tests.tools.virtual import VirtualLine

SHORTEST_S = 0.5
CHEAP = ClickOptions(pitch_m=56e-3, pool=90, judged=20)
BURSTS = Effects((Rule(Trigger.TOUCH, burst(DEFAULT_LEVEL_DB, 50)),))
THREE_FINGERS = make_recording([Stroke(0.1, 0.3, place, place) for place in (0.1, 0.5, 0.9)])
HELD = Effects((Rule(Trigger.TOUCH, Effect("held", (Segment(None, DEFAULT_LEVEL_DB),))),))


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Table:
    """reference-a on a coarse sweep and without entries, beside its description: steady drives are solved live."""
    folder = tmp_path_factory.mktemp("table")
    text = find_device("reference-a").text.replace('step = "1 Hz"', 'step = "8 Hz"')
    (folder / "bar.toml").write_text(text, encoding="utf-8")
    coarse = Device.read(folder / "bar.toml")
    build_table(coarse, folder / "bar.nc", created="test", click_options=CHEAP)
    return Table.open(folder / "bar.nc", device=coarse)


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> Table:
    """A small plate on two actuators, with a coarse sweep."""
    path, device = (
        tmp_path_factory.mktemp("plate") / "plate.nc",
        Device.parse(PLATE.replace('"1 Hz"', '"20 Hz"'), "plate"),
    )
    build_table(device, path, created="test", click_options=CHEAP)
    return Table.open(path, device=device)


@pytest.fixture(scope="module")
def reporter(table: Table) -> Reporter:
    return Reporter(table)


@dataclass
class SolvingHere:
    solver: ClickSolver
    is_there: bool = True
    _ready: list[tuple[str, ClickEntry]] = field(default_factory=list)

    def fileno(self) -> int:
        return -2

    def ask_for_click(self, placement: Placement, device: Device) -> None:
        self._ready.append((device.fingerprint, self.solver.solve(placement)))

    def poll(self) -> Sequence[tuple[str, ClickEntry]]:
        ready, self._ready = self._ready, []
        return ready


def play(
    table: Table, recording: Recording, speed: float, effects: Effects = DEFAULT_EFFECTS, faults: str = ""
) -> LiveRun:
    """As the demo does, in virtual time."""
    line = VirtualLine(configuration_of(table.device), faults)
    reopening, solving = ReopeningPort(line.open, line), SolvingHere(solver_of(table.path))
    return play_to(
        *(line, line, table, Playback(recording, speed), effects),
        lambda: decode_log(line.server.log()),
        reopening,
        solving if effects.have_clicks else None,
    )


def report_of(reporter: Reporter, wanted: Wanted, event: DriveEvent) -> DriveReport | ClickReport:
    """What a command of the firmware does under its fingers."""
    return (reporter.report_drive if event.waveform is None else reporter.report_click)(wanted, event)


def some_of(applied: dict[Wanted, DriveEvent], most: int = 12) -> list[tuple[Wanted, DriveEvent]]:
    """Some commands, evenly over a run: a finger that drags under a steady drive gets hundreds of them."""
    commands = list(applied.items())
    return [commands[k * len(commands) // most] for k in range(most)] if len(commands) > most else commands


@pytest.mark.parametrize("path", recording_params("touch", "*.hid", long_but=1)[::16])
def test_a_real_recording_renders_what_was_promised_for_its_positions(
    path: Path, table: Table, reporter: Reporter
) -> None:
    recording = read_recording(path)
    duration_s = recording.reports[-1].time_s - recording.reports[0].time_s if recording.reports else 0.0
    for effects in (DEFAULT_EFFECTS, HELD):
        run = play(table, recording, max(1.0, duration_s / SHORTEST_S), effects)
        assert run.counters.reports == len(recording.reports)
        for wanted, event in some_of(first_applied(run), 4):
            assert report_of(reporter, wanted, event).disagreement <= AGREEMENT


def test_every_finger_of_the_demo_touches_is_promised_what_it_gets(table: Table, reporter: Reporter) -> None:
    """Fingers that feel as long as they touch, so that many drives are rendered; quiet ones by a second rule."""
    quiet_in_the_middle = Rule(Trigger.TOUCH, Effect("nothing", (Segment(None, None),)), zones=frozenset({2}))
    applied = dict[Wanted, DriveEvent]()
    for effects in (HELD, Effects((quiet_in_the_middle, *HELD.rules))):
        applied |= first_applied(play(table, read_recording(DEMO_RECORDING), 10.0, effects))
    several = {wanted: event for wanted, event in applied.items() if len(wanted.placement.position_m) > 1}
    reports = [report_of(reporter, *command) for command in [*some_of(applied, 4), *some_of(several, 6)]]
    assert any(report.placement.quiet for report in reports)
    assert max(len(report.placement.felt) for report in reports) > 1
    assert max(report.disagreement for report in reports) <= AGREEMENT


def test_a_table_that_a_user_names_is_built_there_and_nothing_lies_beside_it(
    tmp_path: Path, table: Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    def build(_device: Device, path: Path, **_options: Any) -> None:
        path.write_bytes(table.path.read_bytes())

    monkeypatch.setattr(demo_run, "build_table", build)
    for _ in range(2):  # built, and then found
        with demo_run.table_at(table.device, tmp_path / "mine.nc", lambda *_: None) as found:
            assert found.fingerprint == table.fingerprint
    assert [path.name for path in tmp_path.iterdir()] == ["mine.nc"]


@pytest.fixture
def virtual(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_run, "play", play)


@pytest.mark.usefixtures("virtual")
def test_the_demo_tells_all_of_it_and_draws_it(tmp_path: Path, table: Table) -> None:
    report = demo_here(tmp_path, table.path, DEMO_RECORDING, "--figure", "demo.png")
    assert report["touch_frames"] == 692
    rendered = [(tuple(click["felt"]), tuple(click["quiet"])) for click in report["clicks"]]
    alone = [(("I",), ()), (("I",), ()), (("III",), ()), (("II", "IV"), ())]
    assert sorted(rendered) == sorted([*alone, (("III",), ("I",)), (("V",), ("I", "III"))])
    assert report["states_not_rendered"] == report["states"] == []
    first = report["clicks"][0]
    assert first["fingers"][0]["position_m"] == pytest.approx(0.1 * table.device.bar.length_m, abs=1e-4)
    assert {click["wanted_level_db"] for click in report["clicks"]} == {20.0}
    assert report["commands_applied"] == report["commands_sent"] > 0
    assert (tmp_path / "demo.png").stat().st_size > 10_000


@pytest.mark.long
@pytest.mark.usefixtures("virtual")
def test_a_plate_s_fingers_are_told_and_drawn_as_points(tmp_path: Path, plate: Table) -> None:
    for effects in (DEFAULT_EFFECTS, HELD):
        report = run_demo(plate, THREE_FINGERS, effects)
        assert report.agrees and (report.drives if effects is HELD else report.clicks)
        draw_demo(report, tmp_path / "demo.png")
        told = io.StringIO()
        print_demo(Console(file=told, width=200), report, tmp_path / "demo.png")
        assert "20 x 59.94 mm" in told.getvalue() and "plate" in told.getvalue()
        first = (demo_json(report)["states"] or demo_json(report)["clicks"])[0]["fingers"][0]
        assert first["position_m"] == pytest.approx([0.02, 0.06], abs=2e-4)


@pytest.mark.machine
def test_the_demo_plays_taps_and_three_fingers_through_its_processes_in_real_time(
    tmp_path: Path, click_table: Path
) -> None:
    taps = [Stroke(0.3 * number, 0.3 * number + 0.15, 1 / 6, 1 / 6) for number in range(5)]
    three = [Stroke(1.8, 2.2, place, place) for place in (1 / 6, 3 / 6, 5 / 6)]
    write_recording(make_recording([*taps, *three]), tmp_path / "taps.hid")
    (tmp_path / "bar.toml").write_text(SMALL, encoding="utf-8")
    report = demo_here(tmp_path, Path(shutil.copy(click_table, tmp_path)), tmp_path / "taps.hid")
    # The click of three fingers is solved when they come, perhaps after they lifted; and a machine that stalls while a
    # click lasts does not render it, and says so.
    assert report["states"] == []
    rendered = [click["felt"] for click in report["clicks"]]
    assert all(felt in (["I"], ["I", "II", "III"]) for felt in rendered)
    assert ["I"] in rendered or report["states_not_rendered"]
    assert report["commands_applied"] + report["commands_late"] == report["commands_sent"] > 0


def demo_here(folder: Path, table: Path, recording: Path, *more: str) -> dict[str, Any]:
    built = [str(table.with_name("bar.toml")), "--table", str(table)]
    report: dict[str, Any] = summary_of(folder, "demo", "--recording", str(recording), *built, *more)
    assert report["agrees"] and report["simulated"]
    return report


def in_zones(table: Table, rows: BestRows) -> DemoReport:
    """Fingers that come to I, III and V together, as in the paper's Figure 8, with drives of zones."""
    table.best_rows = rows
    return run_demo(table, THREE_FINGERS, replace(HELD, drives=Drives.ZONES))


@pytest.mark.usefixtures("virtual")
def test_zones_play_the_row_of_figure_8_which_has_a_greater_factor_than_the_paper_reports(table: Table) -> None:
    report = in_zones(table, table.best_rows)
    (drive,) = report.drives
    assert report.agrees and drive.felt_zones == (0, 2, 4)
    row = table.best_row(["I", "III", "V"])
    assert drive.drive == row and row.localized_factor > 0.8626
    told = demo_json(report)["states"][0]
    assert (told["drives"], told["row"]["localized_factor"]) == ("zones", row.localized_factor)


@pytest.mark.usefixtures("virtual")
def test_a_row_of_two_frequencies_sounds_as_two_and_keeps_its_promise(table: Table, tmp_path: Path) -> None:
    before = table.best_rows
    try:
        report = in_zones(table, rows_of(table.device))
    finally:
        table.best_rows = before
    (drive,) = report.drives
    assert report.agrees and drive.drive.frequencies_hz == (121.0, 190.0) and drive.frequency_text == "121 & 190 Hz"
    (event,) = (event for event in first_applied(report.run).values())
    assert [channel.frequency_hz for channel in event.channels] == pytest.approx([121.0, 190.0], abs=5e-3)
    draw_demo(report, tmp_path / "demo.png")
    print_demo(Console(file=io.StringIO()), report, tmp_path / "demo.png")


@pytest.mark.parametrize("faults", ["stall=0.06s/0.2s", "delay=30ms,jitter=30ms", "stall=0.3s/0.9s"])
def test_a_run_over_a_line_that_stalls_breaks_no_promise(table: Table, faults: str) -> None:
    """The firmware refuses what comes late, and whatever it takes is what was solved for the fingers."""
    run = play(table, read_recording(DEMO_RECORDING), 4.0, BURSTS, faults=faults)
    applied, promises = first_applied(run), Promises(table)
    for wanted, event in applied.items():
        drive, _ = promises.of_drive(wanted.placement, wanted.level_db)
        drives = [(channel.frequency_hz, channel.amplitude) for channel in event.channels if channel.amplitude]
        tones = zip(drive.frequencies_hz, drive.amplitudes, strict=True)
        assert drives == [pytest.approx(tone, abs=5e-3) for tone in tones if tone[1] > 1e-4]
    missed, not_rendered = find_missed(run, applied)
    assert missed == ()
    assert run.log.faults["to_device.delayed"] > 0 or "delay=" in faults
    felt = {found for change in run.trace if (found := wanted_of(change)) is not None}
    assert felt == {*applied, *not_rendered}


@pytest.fixture(scope="module")
def bursts(table: Table) -> LiveRun:
    """The demo's touches with a short steady drive for each."""
    return play(table, read_recording(DEMO_RECORDING), 2.0, BURSTS)


def test_a_command_that_the_firmware_took_and_did_not_drive_is_missed(bursts: LiveRun) -> None:
    key = next(iter(first_applied(bursts)))
    silent = tuple(event for event in bursts.log.events if event.cause is not Cause.SET)
    deaf = replace(bursts, log=replace(bursts.log, events=silent))
    assert key in find_missed(deaf, first_applied(deaf))[0]
    unheard = replace(bursts, log=replace(bursts.log, events=(), received=()))
    assert key in find_missed(unheard, first_applied(unheard))[0]


def test_a_broken_promise_is_found_and_one_for_positions_is_not_kept_elsewhere(
    reporter: Reporter, bursts: LiveRun
) -> None:
    wanted, event = next((wanted, event) for wanted, event in first_applied(bursts).items() if wanted.placement.quiet)
    report = reporter.report_drive(wanted, event)
    assert report.disagreement <= AGREEMENT
    assert replace(report, promised_factor=1.03 * report.promised_factor).disagreement > AGREEMENT
    for finger in range(len(wanted.placement.position_m)):
        boast = report.promise.acceleration_m_per_s2.copy()
        boast[finger] *= 0.97
        assert replace(report, promise=replace(report.promise, acceleration_m_per_s2=boast)).disagreement > AGREEMENT
    louder = replace(event, channels=tuple(replace(c, amplitude=1.03 * c.amplitude) for c in event.channels))
    assert reporter.report_drive(wanted, louder).disagreement > AGREEMENT
    moved_m = [at_m + 2e-3 for at_m in wanted.placement.position_m]
    assert replace(report, simulated=reporter.surface.simulate_held(event, moved_m)).disagreement > AGREEMENT


def test_what_rings_down_counts_as_felt_by_the_finger_that_felt_it_and_a_board_that_is_not_driven_moves_nothing(
    reporter: Reporter, table: Table
) -> None:
    run = play(table, read_recording(DEMO_RECORDING), 3.0)
    first = next(change for change in run.trace if change.is_click)
    felt = reporter.surface.feel(run, 13.0)
    start_s = (first.time_ns - run.moments[0].time_ns) / 1e9
    ringing = (felt.time_s >= start_s + 0.03) & (felt.time_s < start_s + 0.15)
    assert felt.felt[ringing].max() > 0
    assert not felt.quiet[ringing].any()
    still = reporter.surface.feel(replace(run, log=replace(run.log, events=())), 1.0)
    assert len(still.time_s) > 10
    assert not still.drive.any() and not still.felt.any() and not still.quiet.any()


def test_the_shipped_recording_is_what_the_digitizer_as_long_as_the_bar_makes() -> None:
    # Remade by: write_recording(make_recording(DEMO_STROKES), DEMO_RECORDING)
    shipped, made = read_recording(DEMO_RECORDING), make_recording(DEMO_STROKES)
    assert shipped.descriptor == made.descriptor
    assert [report.data for report in shipped.reports] == [report.data for report in made.reports]
    assert "SIMULATED" in shipped.name
    assert open_digitizer(shipped.descriptor).surface.x.extent_mm == pytest.approx(279.4, abs=1e-6)
