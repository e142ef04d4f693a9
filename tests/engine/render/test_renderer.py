"""Laws of the drives of all states."""

from dataclasses import replace
from math import inf
from pathlib import Path

import pytest

from engine.device import Device
from engine.render import SILENCE, DriveCommand, LimitError, PlayCommand, Renderer, RendererError, WhenNotAchieved
from engine.render.chosen_basis import ChosenBasis
from engine.table.click import played_at
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.messages import Play, decode_body, decode_drive, encode_play_body
from tests.engine.made_clicks import basis_of, click_of
from tests.engine.made_entries import LEVEL_DB, entry_of, felt_states, states_of

REFERENCE = Device.read(Path(__file__).parents[3] / "tables" / "devices" / "reference-a.toml")
CAPABILITIES = Capabilities(2, 0.01, 1.0, 655.35, (0.52e-6, 0.52e-6), 100, 48_000, 1, 0, (0, 1, 0))
STATES = felt_states(REFERENCE)
ENTRY = entry_of(REFERENCE, STATES[0])
WEAK = replace(ENTRY, achieved=False)


def drive_of(renderer: Renderer, state: int, level_db: float) -> bytes:
    command = renderer.render(state, level_db)
    assert isinstance(command, DriveCommand)
    return command.drive


def test_every_state_gives_the_drive_of_its_entry_at_the_level_asked_for() -> None:
    entries = {
        level_db: [
            entry_of(REFERENCE, states, frequencies_hz=(60 + i, 61.25), amplitudes=(scale, scale / 4))
            for i, states in enumerate(STATES)
        ]
        for level_db, scale in ((10.0, 0.2), (20.0, 0.6), (inf, 1.0))
    }
    renderer = Renderer(entries, REFERENCE, CAPABILITIES)
    for level_db, entries_of_level in entries.items():
        for entry in entries_of_level:
            left, right = decode_drive(drive_of(renderer, entry.index, level_db), CAPABILITIES.frequency_resolution_hz)
            assert (left.frequency_hz, right.frequency_hz) == pytest.approx(entry.frequencies_hz, abs=0.005)
            assert (left.amplitude, right.amplitude) == pytest.approx(entry.amplitudes, abs=1e-5)
            assert (left.phase_rad, right.phase_rad) == pytest.approx(entry.phases_rad, abs=1e-4)
    assert (renderer.unknown_states, renderer.not_achieved_states) == (0, 0)


def test_the_drive_is_clamped() -> None:
    device = replace(REFERENCE, limits=replace(REFERENCE.limits, amplitude=0.5))
    payload = drive_of(Renderer({LEVEL_DB: [ENTRY]}, device, CAPABILITIES), ENTRY.index, LEVEL_DB)
    assert [channel.amplitude for channel in decode_drive(payload, 0.01)] == pytest.approx([0.5, 0.125], abs=1e-5)


@pytest.mark.parametrize("state", [0, 1, 3 + 27])
def test_nothing_felt_is_silence_and_no_unknown_state(state: int) -> None:
    renderer = Renderer({LEVEL_DB: []}, REFERENCE, CAPABILITIES)
    assert renderer.render(state, None) == SILENCE
    assert renderer.unknown_states == 0


def test_an_unknown_state_is_silence_and_counted() -> None:
    renderer = Renderer({LEVEL_DB: []}, REFERENCE, CAPABILITIES)
    assert [renderer.render(state, LEVEL_DB) for state in (7, 7, 242)] == [SILENCE] * 3
    assert renderer.unknown_states == 3


@pytest.mark.parametrize("when", [WhenNotAchieved.WARN, WhenNotAchieved.GO_ON])
def test_an_entry_short_of_its_level_is_played_and_counted(when: WhenNotAchieved) -> None:
    renderer = Renderer({LEVEL_DB: [WEAK]}, REFERENCE, CAPABILITIES, when)
    good = Renderer({LEVEL_DB: [ENTRY]}, REFERENCE, CAPABILITIES, when)
    assert renderer.render(WEAK.index, LEVEL_DB) == good.render(ENTRY.index, LEVEL_DB)
    assert (renderer.not_achieved_states, good.not_achieved_states) == (1, 0)


def test_an_entry_short_of_its_level_is_silent_and_counted_where_it_is_refused() -> None:
    other = entry_of(REFERENCE, STATES[1])
    renderer = Renderer({LEVEL_DB: [WEAK, other]}, REFERENCE, CAPABILITIES, WhenNotAchieved.REFUSE)
    assert renderer.render(WEAK.index, LEVEL_DB) == SILENCE
    assert renderer.render(other.index, LEVEL_DB) != SILENCE
    assert (renderer.not_achieved_states, renderer.unknown_states) == (1, 0)


def test_how_many_states_fall_short_is_known_before_the_first_touch() -> None:
    states = [states_of(REFERENCE, [zone]) for zone in range(5)]
    entries = {
        10.0: [entry_of(REFERENCE, state) for state in states],
        30.0: [entry_of(REFERENCE, state, achieved=i > 1) for i, state in enumerate(states)],
    }
    assert Renderer(entries, REFERENCE, CAPABILITIES).shortfalls == {10.0: 0, 30.0: 2}


def test_a_device_with_too_few_actuators_is_refused() -> None:
    with pytest.raises(RendererError, match="reference-a has 2 actuators, the connected device drives 1: connect"):
        Renderer({}, REFERENCE, replace(CAPABILITIES, number_of_actuators=1))


@pytest.mark.parametrize(("low_hz", "high_hz"), [(101.0, 655.35), (1.0, 99.0)])
def test_a_frequency_that_the_firmware_would_move_is_refused(low_hz: float, high_hz: float) -> None:
    capabilities = replace(CAPABILITIES, frequency_minimum_hz=low_hz, frequency_maximum_hz=high_hz)
    with pytest.raises(RendererError, match=r"the connected device plays .* Hz: narrow the actuators' bands"):
        Renderer({LEVEL_DB: [ENTRY]}, REFERENCE, capabilities)


def test_an_entry_for_other_zones_is_refused() -> None:
    device = replace(REFERENCE, zones=REFERENCE.zones[:4])
    with pytest.raises(RendererError, match="is for zones I, II, III, IV, V, reference-a has I, II, III, IV: build"):
        Renderer({LEVEL_DB: [ENTRY]}, device, CAPABILITIES)


def test_two_entries_for_one_state_are_refused() -> None:
    with pytest.raises(RendererError, match="two entries"):
        Renderer({LEVEL_DB: [ENTRY] * 2}, REFERENCE, CAPABILITIES)


def test_a_broken_entry_is_refused_when_the_table_is_opened() -> None:
    with pytest.raises(LimitError):
        Renderer({LEVEL_DB: [replace(ENTRY, frequencies_hz=(30.0, 100.0))]}, REFERENCE, CAPABILITIES)


def test_only_a_device_that_understands_the_drives_alike_fits() -> None:
    renderer = Renderer({}, REFERENCE, CAPABILITIES)
    assert renderer.fits(replace(CAPABILITIES, boot_id=2))
    assert not renderer.fits(replace(CAPABILITIES, frequency_resolution_hz=0.02))


HELD = ChosenBasis(basis_of(2, 121), {0: 0})


def test_a_click_is_played_from_the_basis_as_loud_as_it_is_wanted() -> None:
    clicks = [click_of(REFERENCE, states, level_db=26.0) for states in STATES[:3]]
    levels = {level_db: [played_at(click, level_db) for click in clicks] for level_db in (20.0, 26.0, inf)}
    entries = {level_db: [entry_of(REFERENCE, states) for states in STATES] for level_db in levels}
    renderer = Renderer(entries, REFERENCE, CAPABILITIES, clicks=levels, basis=HELD)
    for level_db, amplitude in ((20.0, 10 ** (-6 / 20)), (26.0, 1.0), (inf, 1.0)):
        for click in clicks:
            command = renderer.render(click.index, level_db, is_click=True)
            assert isinstance(command, PlayCommand)
            _, message = decode_body(encode_play_body(1, command.click.play, 2))
            assert isinstance(message, Play)
            assert message.weights == (click.index,) * 2
            assert message.amplitude == pytest.approx(65_535 * amplitude, abs=0.5)
            assert command.click.length_us == 30_000
            assert isinstance(renderer.render(click.index, level_db), DriveCommand)
    assert renderer.click_shortfalls == dict.fromkeys(levels, 0)


def test_a_click_of_a_set_that_the_device_does_not_hold_is_the_steady_drive() -> None:
    clicks = [click_of(REFERENCE, states) for states in STATES[:2]]
    clicks[1] = replace(clicks[1], basis_set=1)
    renderer = Renderer(
        {LEVEL_DB: [entry_of(REFERENCE, states) for states in STATES]},
        REFERENCE,
        CAPABILITIES,
        clicks={LEVEL_DB: clicks},
        basis=HELD,
    )
    assert isinstance(renderer.render(clicks[0].index, LEVEL_DB, is_click=True), PlayCommand)
    steady = renderer.render(clicks[1].index, LEVEL_DB)
    assert renderer.render(clicks[1].index, LEVEL_DB, is_click=True) == steady != SILENCE


@pytest.mark.parametrize("when", list(WhenNotAchieved))
def test_a_click_short_of_its_level_is_counted_and_silent_where_it_is_refused(when: WhenNotAchieved) -> None:
    weak = played_at(click_of(REFERENCE, STATES[0], level_db=14.0), LEVEL_DB)
    assert not weak.achieved
    renderer = Renderer({LEVEL_DB: [ENTRY]}, REFERENCE, CAPABILITIES, when, clicks={LEVEL_DB: [weak]}, basis=HELD)
    refuses = when is WhenNotAchieved.REFUSE
    assert (renderer.render(weak.index, LEVEL_DB, is_click=True) == SILENCE) == refuses
    assert (renderer.not_achieved_states, renderer.click_shortfalls) == (1, {LEVEL_DB: 1})
