"""Laws of what becomes of a table for one device: what the device can play decides."""

from dataclasses import replace
from math import inf
from pathlib import Path

import pytest

from engine.device import Device
from engine.effects import DEFAULT_EFFECTS, Effect, Effects, Rule, Segment, Trigger
from engine.render.prepared import render_table
from engine.render.renderer import SILENCE, DriveCommand, PlayCommand, WhenNotAchieved
from engine.table import Table
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.messages import Features, decode_drive
from tests.engine.made_bursts import SHAPES, burst_of
from tests.engine.made_clicks import click_of
from tests.engine.made_entries import LEVEL_DB, entry_of, felt_states
from tests.engine.made_table import write_table

REFERENCE = Device.read(Path(__file__).parents[3] / "tables" / "devices" / "reference-a.toml")
STATES = felt_states(REFERENCE)[:4]
BOTH = Features.WAVEFORMS | Features.ONSET_SHAPES
STEADY = Effects((Rule(Trigger.TOUCH, Effect("held", (Segment(None, LEVEL_DB),))),))
MS = 1_000_000


def capabilities(features: Features) -> Capabilities:
    plain = Capabilities(2, 0.01, 1.0, 655.35, (0.52e-6, 0.52e-6), 100, 48_000, 1, 0, (0, 1, 0))
    return replace(plain, features=features, longest_waveform_ms=100, bank_capacity_bytes=1 << 18)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Table:
    """Clicks of two states; bursts of three, one as long as no click is; the steady drive of all."""
    bursts = [
        burst_of(REFERENCE, states, level_db=level_db, shape=i % 2, stop_s=stop_s)
        for i, (states, level_db, stop_s) in enumerate(
            zip(STATES, (26.0, 14.0, 20.0), (0.02, 0.035, 0.01), strict=False)
        )
    ]
    path = tmp_path_factory.mktemp("rendering") / "bar.nc"
    entries = [entry_of(REFERENCE, states) for states in STATES]
    clicks = [click_of(REFERENCE, states) for states in STATES[:2]]
    return Table.open(write_table(path, REFERENCE, entries, clicks, bursts=bursts, shapes=SHAPES))


def test_a_device_that_only_shapes_onsets_gets_bursts_for_clicks(table: Table) -> None:
    rendering = render_table(table, DEFAULT_EFFECTS, capabilities(Features.ONSET_SHAPES))
    assert (rendering.bank, rendering.configuration.onsets, rendering.bursts) == (None, SHAPES, 3)
    assert rendering.click_length_ns == 35 * MS
    commands = [rendering.renderer.render(burst.index, LEVEL_DB, is_click=True) for burst in table.bursts]
    for command, burst in zip(commands, table.bursts_at(LEVEL_DB), strict=True):
        assert isinstance(command, DriveCommand)
        assert (command.onset, command.stop_after_ns) == (burst.shape + 1, round(1e9 * burst.stop_s))
        channels = decode_drive(command.drive, 0.01)
        assert [channel.amplitude for channel in channels] == pytest.approx(burst.amplitudes, abs=1e-5)
        assert [channel.frequency_hz for channel in channels] == pytest.approx(burst.frequencies_hz, abs=0.005)
    assert commands[0] != commands[2]  # one softer than the other


def test_a_state_without_a_burst_and_a_steady_level_are_the_steady_drive(table: Table) -> None:
    renderer = render_table(table, DEFAULT_EFFECTS, capabilities(Features.ONSET_SHAPES)).renderer
    for state, is_click in ((table.bursts[0].index, False), (table.entries[3].index, True)):
        command = renderer.render(state, LEVEL_DB, is_click)
        assert isinstance(command, DriveCommand)
        assert (command.onset, command.stop_after_ns) == (0, None)
        assert command != SILENCE


@pytest.mark.parametrize("features", [BOTH, Features.WAVEFORMS])
def test_a_device_that_plays_waveforms_gets_no_onsets(table: Table, features: Features) -> None:
    rendering = render_table(table, DEFAULT_EFFECTS, capabilities(features))
    assert (rendering.configuration.onsets, rendering.bursts, rendering.click_length_ns) == ((), 0, 30 * MS)
    first, *_, third = (rendering.renderer.render(each.index, LEVEL_DB, is_click=True) for each in table.bursts)
    assert isinstance(first, PlayCommand)
    assert third == rendering.renderer.render(table.bursts[2].index, LEVEL_DB)


def test_a_device_that_does_neither_and_effects_without_clicks_get_steady_drives(table: Table) -> None:
    for effects, features in ((DEFAULT_EFFECTS, Features(0)), (STEADY, Features.ONSET_SHAPES)):
        rendering = render_table(table, effects, capabilities(features))
        assert (rendering.bank, rendering.configuration.onsets, rendering.bursts) == (None, (), 0)
        steady = rendering.renderer.render(table.bursts[0].index, LEVEL_DB)
        assert rendering.renderer.render(table.bursts[0].index, LEVEL_DB, is_click=True) == steady


def test_a_burst_short_of_its_level_is_counted_and_silent_where_it_is_refused(table: Table) -> None:
    weak = table.bursts[1].index
    for when in WhenNotAchieved:
        renderer = render_table(table, DEFAULT_EFFECTS, capabilities(Features.ONSET_SHAPES), when).renderer
        command = renderer.render(weak, LEVEL_DB, is_click=True)
        assert (command == SILENCE) == (when is WhenNotAchieved.REFUSE)
        assert (renderer.not_achieved_states, renderer.click_shortfalls) == (1, {LEVEL_DB: 1})
    assert table.bursts_at(inf)[1].achieved
