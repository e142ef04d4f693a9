"""Laws of the command for fingers, steady drives and clicks, and of what is prepared for one table and device."""

import pickle
from dataclasses import replace
from functools import cache
from math import inf
from types import SimpleNamespace

import numpy as np
import pytest

from engine.effects.rules import DEFAULT_EFFECTS, Drives, Effect, Effects, Rule, Segment, Trigger
from engine.render.board_fit import ChosenBasis, RendererError
from engine.render.prepared import render_table
from engine.render.renderer import (
    SILENCE,
    DriveCommand,
    PlayCommand,
    RenderedClicks,
    Renderer,
    SteadyDrives,
    ZoneDrives,
)
from engine.steady import Modes
from engine.steady.cases import MeasuredFinger, cases_at, sample_deviations
from engine.steady.steady_solver import SteadySolver
from engine.table import ClickEntry, Table
from engine.table.best_rows import BestRows
from engine.touch import Placement
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.drive_words import decode_drive
from firmware_link.protocol.messages import Features, Play, decode_body, encode_play_body
from precompute.predict.at_positions import SteadyDesigner
from tests.engine.made_table import (
    LEVEL_DB,
    basis_of,
    click_of,
    in_zones,
    made_clicks,
    number_of,
    places_of,
    row_of,
    rows_of,
    write_table,
)
from tests.engine.render.made_steady import MadeSteady, board, plain_board
from tests.precompute.devices import shipped

REFERENCE = shipped("reference-a")
CAPABILITIES = plain_board()
HELD = ChosenBasis(basis_of(2, 121), {0: 0})
PLACEMENTS = [in_zones(REFERENCE, [0]), in_zones(REFERENCE, [2], [0]), in_zones(REFERENCE, [0, 4])]
CLICKS = [click_of(REFERENCE, placement) for placement in PLACEMENTS]
LEVELS_DB = (20.0, 26.0, inf)


def renderer_of(
    clicks: list[ClickEntry], steady: MadeSteady | None = None, basis: ChosenBasis = HELD, *, refuses: bool = False
) -> Renderer:
    rendered = RenderedClicks(made_clicks(REFERENCE, clicks), basis, refuses)
    return Renderer(CAPABILITIES, steady or MadeSteady(REFERENCE), rendered, LEVELS_DB)


def test_a_click_is_played_from_the_basis_as_loud_as_it_is_wanted() -> None:
    renderer = renderer_of(CLICKS)
    for level_db, amplitude in ((20.0, 10 ** (-6 / 20)), (26.0, 1.0), (inf, 1.0)):
        for placement in PLACEMENTS:
            command = renderer.render(placement, level_db, is_click=True)
            assert isinstance(command, PlayCommand)
            _, message = decode_body(encode_play_body(1, command.click.play, 2))
            assert isinstance(message, Play)
            assert message.weights == (number_of(REFERENCE, placement),) * 2
            assert message.amplitude == pytest.approx(65_535 * amplitude, abs=0.5)
            assert command.click.length_us == 30_000
    assert renderer.not_achieved == 0 and renderer.click_shortfalls == dict.fromkeys(LEVELS_DB, 0)


def test_the_click_of_fingers_between_places_is_that_of_the_nearest() -> None:
    renderer, half_m = renderer_of(CLICKS), places_of(REFERENCE).pitch_m / 2
    expected = renderer.render(PLACEMENTS[1], LEVEL_DB, is_click=True)
    for off_m in (-0.99 * half_m, 0.99 * half_m):
        moved = replace(PLACEMENTS[1], position_m=tuple(at_m + off_m for at_m in PLACEMENTS[1].position_m))
        assert renderer.render(moved, LEVEL_DB, is_click=True) == expected
    beyond = replace(PLACEMENTS[1], position_m=tuple(at_m + 1.01 * half_m for at_m in PLACEMENTS[1].position_m))
    assert renderer.render(beyond, LEVEL_DB, is_click=True) is None


def test_a_click_that_nobody_has_solved_is_unknown_until_it_is_learned_for_just_these_fingers() -> None:
    renderer, placement = renderer_of(CLICKS), Placement((0.08, 0.2, 0.25), (True, False, False))
    assert renderer.render(placement, LEVEL_DB, is_click=True) is None
    assert renderer.fallback(placement, LEVEL_DB) == renderer.render(placement, LEVEL_DB)
    renderer.clicks.learn(click_of(REFERENCE, placement))
    assert isinstance(renderer.render(placement, LEVEL_DB, is_click=True), PlayCommand)
    elsewhere = Placement((0.05, 0.2, 0.25), (True, False, False))
    other_basis = replace(click_of(REFERENCE, elsewhere), basis=basis_of(2, 121, 241))
    renderer.clicks.learn(other_basis)  # of a table before this one
    assert renderer.render(elsewhere, LEVEL_DB, is_click=True) is None
    near = replace(placement, position_m=(0.0801, 0.2, 0.25))
    assert renderer.render(near, LEVEL_DB, is_click=True) is None
    assert renderer.clicks.number == len(CLICKS)


def test_the_earliest_learned_click_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("engine.render.renderer.MOST_LEARNED", 2)
    rendered = RenderedClicks(made_clicks(REFERENCE, CLICKS), HELD, refuses=False)
    learned = [in_zones(REFERENCE, [felt], [zone for zone in (0, 2, 4) if zone != felt]) for felt in (0, 2, 4)]
    for placement in learned:
        rendered.learn(click_of(REFERENCE, placement))
    assert [rendered.is_unknown(placement) for placement in learned] == [True, False, False]


def test_a_click_of_a_set_that_the_device_does_not_hold_is_the_steady_drive() -> None:
    other = replace(CLICKS[1], basis=basis_of(2, 121, 241))
    clicks = [replace(CLICKS[0], basis=other.basis), replace(other, basis_set=1)]
    renderer = renderer_of(clicks, basis=ChosenBasis(basis_of(2, 121), {0: 0}))
    assert isinstance(renderer.render(PLACEMENTS[0], LEVEL_DB, is_click=True), PlayCommand)
    steady = renderer.render(PLACEMENTS[1], LEVEL_DB)
    assert renderer.render(PLACEMENTS[1], LEVEL_DB, is_click=True) == steady != SILENCE
    assert renderer.clicks.number == 1


@pytest.mark.parametrize("refuses", [False, True])
def test_what_is_short_of_its_level_is_counted_and_silent_where_it_is_refused(refuses: bool) -> None:
    weak = click_of(REFERENCE, PLACEMENTS[0], level_db=14.0)
    renderer = renderer_of([weak], MadeSteady(REFERENCE, short_of=[0], refuses=refuses), refuses=refuses)
    assert (renderer.render(PLACEMENTS[0], LEVEL_DB, is_click=True) == SILENCE) == refuses
    assert (renderer.render(PLACEMENTS[0], LEVEL_DB) == SILENCE) == refuses
    assert (renderer.not_achieved, renderer.click_shortfalls) == (2, {20.0: 1, 26.0: 1, inf: 0})


def test_only_a_device_that_understands_the_drives_alike_fits() -> None:
    renderer = renderer_of([])
    assert renderer.fits(replace(CAPABILITIES, boot_id=2))
    assert not renderer.fits(replace(CAPABILITIES, frequency_resolution_hz=0.02))
    assert not renderer.fits(replace(CAPABILITIES, full_scales_m=(0.52e-6, 0.6e-6)))
    assert renderer.suits_device_of(renderer_of(CLICKS))


STEADY = Effects((Rule(Trigger.TOUCH, Effect("held", (Segment(None, LEVEL_DB),))),))
MS = 1_000_000


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Table:
    """Clicks of two placements, the second softer."""
    path = tmp_path_factory.mktemp("rendering") / "bar.nc"
    clicks = [click_of(REFERENCE, at, level_db=level) for at, level in zip(PLACEMENTS[:2], (26.0, 14.0), strict=True)]
    return Table.open(write_table(path, REFERENCE, clicks))


def test_a_placement_of_the_table_gets_its_click_and_another_has_none_yet(table: Table) -> None:
    rendering = render_table(table, DEFAULT_EFFECTS, board())
    assert (rendering.basis is not None, rendering.click_length_ns) == (True, 30 * MS)
    first, second = (rendering.renderer.render(placement, LEVEL_DB, is_click=True) for placement in PLACEMENTS[:2])
    assert isinstance(first, PlayCommand) and isinstance(second, PlayCommand)
    assert rendering.renderer.render(in_zones(REFERENCE, [1]), LEVEL_DB, is_click=True) is None


def test_a_device_without_waveforms_and_effects_without_clicks_get_steady_drives(table: Table) -> None:
    for effects, features in ((DEFAULT_EFFECTS, Features(0)), (STEADY, Features.WAVEFORMS)):
        rendering = render_table(table, effects, board(features=features))
        renderer = rendering.renderer
        assert (rendering.basis, renderer.clicks.number, renderer.click_shortfalls) == (None, 0, {})
        for placement in (*PLACEMENTS[:2], in_zones(REFERENCE, [1], [3, 4])):
            steady = renderer.render(placement, LEVEL_DB)
            assert renderer.render(placement, LEVEL_DB, is_click=True) == steady != SILENCE


def test_clicks_are_made_for_fingers_as_late_as_panel_line_and_peak_are(table: Table) -> None:
    ahead_ns = render_table(table, DEFAULT_EFFECTS, board(), 921_600).click_ahead_ns
    assert 20 * MS < ahead_ns < 22 * MS  # the peak of both clicks is at 20 ms
    late = replace(table.device, touch_axis=replace(table.device.touch_axis, latency_s=0.015))
    parts = SimpleNamespace(device=late, clicks=table.clicks, modes=table.modes, path=table.path)
    assert render_table(parts, DEFAULT_EFFECTS, board(), 921_600).click_ahead_ns == ahead_ns + 15 * MS  # type: ignore[arg-type]
    slow = render_table(table, DEFAULT_EFFECTS, board(), 115_200).click_ahead_ns
    assert slow - 20 * MS == pytest.approx(8 * (ahead_ns - 20 * MS), rel=0.01)
    assert render_table(table, STEADY, board()).click_ahead_ns == 0


def test_a_rendering_survives_the_way_from_another_process(table: Table) -> None:
    rendering = render_table(table, DEFAULT_EFFECTS, board())
    before = [rendering.renderer.render(PLACEMENTS[0], LEVEL_DB, is_click) for is_click in (False, True)]
    there = pickle.loads(pickle.dumps(rendering))
    assert [there.renderer.render(PLACEMENTS[0], LEVEL_DB, is_click) for is_click in (False, True)] == before


def test_zones_of_a_table_without_rows_are_refused_by_name(table: Table) -> None:
    with pytest.raises(RendererError, match=r"no best rows.*build it again"):
        render_table(table, replace(DEFAULT_EFFECTS, drives=Drives.ZONES), board(features=Features.WAVEFORMS))


DEVICE = shipped("reference-a")
PLACEMENT = Placement((0.0371, 0.1234), (True, False))


@cache
def modes() -> Modes:
    return SteadyDesigner(DEVICE).modes


def drives_of(*, refuses: bool = False, capabilities: Capabilities = CAPABILITIES) -> SteadyDrives:
    return SteadyDrives(DEVICE, capabilities, modes(), refuses, (1.0, 1.0))


def test_the_command_is_what_the_solver_finds_to_a_step_of_the_wire() -> None:
    for level_db in (20.0, inf):
        solved = SteadySolver(DEVICE, modes()).solve(PLACEMENT.position_m, PLACEMENT.is_felt, level_db)
        command, is_achieved = drives_of().rendered(PLACEMENT, level_db)
        assert isinstance(command, DriveCommand) and is_achieved == solved.achieved
        for channel, amplitude, phase_rad in zip(
            decode_drive(command.drive, 0.01), solved.amplitudes, solved.phases_rad, strict=True
        ):
            assert channel.frequency_hz == pytest.approx(solved.frequency_hz, abs=0.005)
            assert channel.amplitude == pytest.approx(amplitude, abs=1e-5)
            assert abs((channel.phase_rad - phase_rad + 3) % 6.283185307 - 3) < 1e-4


def test_a_measured_finger_is_solved_for_where_it_lies_and_no_other() -> None:
    drives, device = drives_of(), DEVICE
    before = drives.rendered(PLACEMENT, 20.0)
    drives.take_fingers([MeasuredFinger(PLACEMENT.position_m[1] + 9e-3, 1.0, 0.1)])
    assert drives.rendered(PLACEMENT, 20.0) == before
    known = MeasuredFinger(PLACEMENT.position_m[1] + 2e-3, 1.0, 0.1)
    drives.take_fingers([known])
    solved = SteadySolver(device, modes()).solve(PLACEMENT.position_m, PLACEMENT.is_felt, 20.0, None, [None, known])
    command, _ = drives.rendered(PLACEMENT, 20.0)
    assert isinstance(command, DriveCommand) and command.frequency_hz == solved.frequency_hz
    assert command != before.command
    drives.take_fingers([])
    assert drives.rendered(PLACEMENT, 20.0) == before


def test_the_cases_of_a_measured_finger_are_about_what_was_measured() -> None:
    deviations = sample_deviations(2, 8)
    plain = cases_at(np.array(PLACEMENT.position_m), deviations, DEVICE).impedance
    known = MeasuredFinger(PLACEMENT.position_m[0], 0.5, 0.1)
    found = cases_at(np.array(PLACEMENT.position_m), deviations, DEVICE, [known, None]).impedance
    assert (found[:, 1] == plain[:, 1]).all()
    ratio = np.log(found[:, 0] / plain[0, 0])
    assert ratio[0] == pytest.approx(0.5) and abs(ratio - 0.5).max() == pytest.approx(0.196 * 7 / 8, rel=0.15)
    unsure = cases_at(np.array(PLACEMENT.position_m), deviations, DEVICE, [known._replace(load=0.0, error=9.0), None])
    assert unsure.impedance == pytest.approx(plain), "never wider than the device's own spread"


def test_a_level_out_of_reach_is_silence_where_it_is_refused() -> None:
    command, is_achieved = drives_of(refuses=True).rendered(PLACEMENT, 90.0)
    assert (command, is_achieved) == (SILENCE, False)
    command, is_achieved = drives_of().rendered(PLACEMENT, 90.0)
    assert command != SILENCE and not is_achieved


def zone_drives(*, refuses: bool = False) -> ZoneDrives:
    rows = rows_of(DEVICE, (LEVEL_DB, inf), short_of=(2,))
    return ZoneDrives(DEVICE, CAPABILITIES, rows, refuses, (1.0, 0.5))


def test_zones_play_the_row_of_those_that_feel_scaled_to_the_board() -> None:
    first, second, _, fourth, _ = ((zone.start_m + zone.stop_m) / 2 for zone in DEVICE.zones)
    command, is_achieved = zone_drives().rendered(Placement((first, second, fourth), (True, False, True)), LEVEL_DB)
    row = row_of(DEVICE, (0, 3))
    assert isinstance(command, DriveCommand) and is_achieved and command.frequency_hz is None
    left, right = decode_drive(command.drive, 0.01)
    assert (left.frequency_hz, right.frequency_hz) == pytest.approx(row.frequencies_hz)
    assert (left.amplitude, right.amplitude) == pytest.approx((0.5, 0.125), abs=1e-4)


def test_zones_without_a_row_are_silent_and_so_are_those_out_of_reach_where_they_are_refused() -> None:
    middle_m = DEVICE.bar.length_m / 2
    placement = Placement((middle_m,), (True,))
    assert zone_drives(refuses=True).rendered(placement, LEVEL_DB) == (SILENCE, False)
    command, is_achieved = zone_drives().rendered(placement, LEVEL_DB)
    assert command != SILENCE and not is_achieved
    gap = ZoneDrives(DEVICE, CAPABILITIES, BestRows([], 1.0), refuses=False, scales=(1.0, 1.0))
    assert gap.rendered(placement, LEVEL_DB) == (SILENCE, False)
