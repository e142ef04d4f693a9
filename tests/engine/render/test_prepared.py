"""Laws of what becomes of a table for one device: what the device can play decides."""

import pickle
from dataclasses import replace
from types import SimpleNamespace

import pytest

from engine.effects.rules import DEFAULT_EFFECTS, Drives, Effect, Effects, Rule, Segment, Trigger
from engine.render.board_fit import RendererError
from engine.render.prepared import render_table
from engine.render.renderer import SILENCE, PlayCommand
from engine.table import Table
from firmware_link.protocol.messages import Features
from tests.engine.made_clicks import click_of, in_zones
from tests.engine.made_states import LEVEL_DB
from tests.engine.made_table import write_table
from tests.engine.render.boards import board
from tests.precompute.devices import shipped

REFERENCE = shipped("reference-a")
PLACEMENTS = [in_zones(REFERENCE, [0]), in_zones(REFERENCE, [2], [0])]
STEADY = Effects((Rule(Trigger.TOUCH, Effect("held", (Segment(None, LEVEL_DB),))),))
MS = 1_000_000


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Table:
    """Clicks of two placements, the second softer."""
    path = tmp_path_factory.mktemp("rendering") / "bar.nc"
    clicks = [click_of(REFERENCE, at, level_db=level) for at, level in zip(PLACEMENTS, (26.0, 14.0), strict=True)]
    return Table.open(write_table(path, REFERENCE, clicks))


def test_a_placement_of_the_table_gets_its_click_and_another_has_none_yet(table: Table) -> None:
    rendering = render_table(table, DEFAULT_EFFECTS, board())
    assert (rendering.basis is not None, rendering.click_length_ns) == (True, 30 * MS)
    first, second = (rendering.renderer.render(placement, LEVEL_DB, is_click=True) for placement in PLACEMENTS)
    assert isinstance(first, PlayCommand) and isinstance(second, PlayCommand)
    assert rendering.renderer.render(in_zones(REFERENCE, [1]), LEVEL_DB, is_click=True) is None


def test_a_device_without_waveforms_and_effects_without_clicks_get_steady_drives(table: Table) -> None:
    for effects, features in ((DEFAULT_EFFECTS, Features(0)), (STEADY, Features.WAVEFORMS)):
        rendering = render_table(table, effects, board(features=features))
        renderer = rendering.renderer
        assert (rendering.basis, renderer.clicks.number, renderer.click_shortfalls) == (None, 0, {})
        for placement in (*PLACEMENTS, in_zones(REFERENCE, [1], [3, 4])):
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
