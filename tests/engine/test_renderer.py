"""Laws of the drives of all states."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest

from engine.device_file import read_device
from engine.entry import Entry, ZonePromise
from engine.limits import LimitError
from engine.renderer import Renderer, RendererError
from engine.zones import ZoneState
from firmware_link.link_values import Capabilities
from firmware_link.messages import decode_drive

REFERENCE = read_device(Path(__file__).parents[2] / "tables" / "devices" / "reference-a.toml")
CAPABILITIES = Capabilities(2, 0.01, 1.0, 655.35, (0.52e-6, 0.52e-6), 100, 48_000, 1, 0, (0, 1, 0))
STATES = [states for states in product((ZoneState.FREE, ZoneState.FELT), repeat=5) if any(states)]


def entry_of(states: tuple[ZoneState, ...], *, frequency_hz: float = 100.0, amplitude: float = 1.0) -> Entry:
    zones = tuple(
        ZonePromise(zone.name, state, 0.2, 1.0, 0.0, 0.0, 0.0)
        for zone, state in zip(REFERENCE.zones, states, strict=True)
    )
    drive = ((frequency_hz, 61.25), (amplitude, 0.25), (0.0, 1.5))
    return Entry(*drive, zones, 0.5, 0.6, 3.0, 0.1, "two tones", "full scale", True)


def test_every_state_gives_the_drive_of_its_entry() -> None:
    entries = [entry_of(states, frequency_hz=60 + i) for i, states in enumerate(STATES)]
    renderer = Renderer(entries, REFERENCE, CAPABILITIES)
    for entry in entries:
        payload = renderer.render(entry.index)
        assert payload is not None
        left, right = decode_drive(payload, CAPABILITIES.frequency_resolution_hz)
        assert (left.frequency_hz, right.frequency_hz) == pytest.approx(entry.frequencies_hz, abs=0.005)
        assert (left.amplitude, right.amplitude) == pytest.approx(entry.amplitudes, abs=1e-5)
        assert (left.phase_rad, right.phase_rad) == pytest.approx(entry.phases_rad, abs=1e-4)
    assert renderer.unknown_states == 0


def test_the_drive_is_clamped() -> None:
    device = replace(REFERENCE, limits=replace(REFERENCE.limits, amplitude=0.5))
    payload = Renderer([entry_of(STATES[0])], device, CAPABILITIES).render(entry_of(STATES[0]).index)
    assert payload is not None
    assert [channel.amplitude for channel in decode_drive(payload, 0.01)] == pytest.approx([0.5, 0.125], abs=1e-5)


def test_nothing_touched_is_silence_and_no_unknown_state() -> None:
    renderer = Renderer([], REFERENCE, CAPABILITIES)
    assert renderer.render(0) is None
    assert renderer.unknown_states == 0


def test_an_unknown_state_is_silence_and_counted() -> None:
    renderer = Renderer([], REFERENCE, CAPABILITIES)
    assert [renderer.render(state) for state in (7, 7, 242)] == [None] * 3
    assert renderer.unknown_states == 3


def test_a_device_with_too_few_actuators_is_refused() -> None:
    with pytest.raises(RendererError, match="reference-a has 2 actuators, the connected device drives 1: connect"):
        Renderer([], REFERENCE, replace(CAPABILITIES, number_of_actuators=1))


@pytest.mark.parametrize(("low_hz", "high_hz"), [(101.0, 655.35), (1.0, 99.0)])
def test_a_frequency_that_the_firmware_would_move_is_refused(low_hz: float, high_hz: float) -> None:
    capabilities = replace(CAPABILITIES, frequency_minimum_hz=low_hz, frequency_maximum_hz=high_hz)
    with pytest.raises(RendererError, match=r"the connected device plays .* Hz: narrow the actuators' bands"):
        Renderer([entry_of(STATES[0])], REFERENCE, capabilities)


def test_an_entry_for_other_zones_is_refused() -> None:
    device = replace(REFERENCE, zones=REFERENCE.zones[:4])
    with pytest.raises(RendererError, match="is for zones I, II, III, IV, V, reference-a has I, II, III, IV: build"):
        Renderer([entry_of(STATES[0])], device, CAPABILITIES)


def test_two_entries_for_one_state_are_refused() -> None:
    with pytest.raises(RendererError, match="two entries"):
        Renderer([entry_of(STATES[0])] * 2, REFERENCE, CAPABILITIES)


def test_a_broken_entry_is_refused_when_the_table_is_opened() -> None:
    with pytest.raises(LimitError):
        Renderer([entry_of(STATES[0], frequency_hz=30.0)], REFERENCE, CAPABILITIES)


def test_only_a_device_that_understands_the_drives_alike_fits() -> None:
    renderer = Renderer([], REFERENCE, CAPABILITIES)
    assert renderer.fits(replace(CAPABILITIES, boot_id=2))
    assert not renderer.fits(replace(CAPABILITIES, frequency_resolution_hz=0.02))
