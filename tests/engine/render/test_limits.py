"""Laws of the drive that a device can bear."""

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.device import Device
from engine.render.limits import LimitError, clamp, link_configuration
from engine.table.best_rows import BestRow
from tests.engine.made_table import row_of
from tests.precompute.devices import shipped

REFERENCE = shipped("reference-a")
LOW_HZ, HIGH_HZ = REFERENCE.actuators[0].band_hz
frequencies = st.floats(LOW_HZ, HIGH_HZ)
amplitudes = st.floats(0, 10)
phases = st.floats(-100, 100)
limits = st.floats(1e-3, 1)
COLUMNS = ("frequencies_hz", "amplitudes", "phases_rad")


def drive_of(frequencies_hz: tuple[float, ...], amplitudes: tuple[float, ...], *phases_rad: float) -> BestRow:
    phases_rad = phases_rad or (0.0,) * len(frequencies_hz)
    return replace(row_of(REFERENCE, [0]), frequencies_hz=frequencies_hz, amplitudes=amplitudes, phases_rad=phases_rad)


def limited_to(amplitude: float) -> Device:
    return replace(REFERENCE, limits=replace(REFERENCE.limits, amplitude=amplitude))


@given(st.tuples(frequencies, frequencies), st.tuples(amplitudes, amplitudes), st.tuples(phases, phases), limits)
def test_a_drive_is_the_solved_one_with_amplitudes_scaled_together(
    frequencies_hz: tuple[float, float], wanted: tuple[float, float], phases_rad: tuple[float, float], limit: float
) -> None:
    drive = clamp(drive_of(frequencies_hz, wanted, *phases_rad), limited_to(limit))
    given_out = tuple(channel.amplitude for channel in drive.channels)
    assert tuple(channel.frequency_hz for channel in drive.channels) == frequencies_hz
    assert tuple(channel.phase_rad for channel in drive.channels) == phases_rad
    assert all(0 <= amplitude <= limit for amplitude in given_out)
    assert given_out[0] * wanted[1] == pytest.approx(given_out[1] * wanted[0], rel=1e-12, abs=1e-300)
    if max(wanted) <= limit:
        assert given_out == wanted
    else:
        assert max(given_out) == pytest.approx(limit)


@given(st.floats(-1e6, 1e6))
def test_a_silent_actuator_gets_a_legal_frequency(frequency_hz: float) -> None:
    silent, _ = clamp(drive_of((frequency_hz, 100.0), (0.0, 1.0)), REFERENCE).channels
    assert silent.amplitude == 0
    assert LOW_HZ <= silent.frequency_hz <= HIGH_HZ


@given(st.floats().filter(lambda hz: not LOW_HZ <= hz <= HIGH_HZ))
def test_a_frequency_outside_the_band_is_never_moved_but_refused(frequency_hz: float) -> None:
    with pytest.raises(LimitError, match="build"):
        clamp(drive_of((100.0, frequency_hz), (0.5, 0.5)), REFERENCE)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_what_is_not_finite_is_refused_even_on_a_silent_actuator(bad: float, place: int) -> None:
    values = [100.0, 0.0, 0.0]
    values[place] = bad
    frequency_hz, amplitude, phase_rad = values
    with pytest.raises(LimitError, match="finite"):
        clamp(drive_of((frequency_hz, 100.0), (amplitude, 0.0), phase_rad, 0.0), REFERENCE)


def test_the_link_arms_the_firmware_with_the_limits_of_the_device() -> None:
    configuration = link_configuration(limited_to(0.75), bit_rate_hz=9600)
    assert configuration.amplitude_limits == (0.75, 0.75)
    assert (configuration.slew_limit_per_s, configuration.lease_ms, configuration.bit_rate_hz) == (200, 40, 9600)


@given(st.floats(1, 1e9), st.floats(1e-3, 0.2))
def test_the_link_never_arms_with_more_than_the_device_allows(slew_per_s: float, lease_s: float) -> None:
    device = replace(REFERENCE, limits=replace(REFERENCE.limits, slew_per_s=slew_per_s, lease_s=lease_s))
    configuration = link_configuration(device)
    assert 1 <= configuration.slew_limit_per_s <= min(65_535, slew_per_s * (1 + 1e-8))
    assert 1 <= configuration.lease_ms <= max(1, 1e3 * lease_s * (1 + 1e-8))


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        ({"amplitudes": (-0.1, 0.5)}, r"actuator left: amplitude -0\.1"),
        *(({key: (None, 1.0)}, "the table is broken") for key in COLUMNS),  # a NaN of a table is read as None
        *(({key: (1.0,)}, "build the table for this device") for key in COLUMNS),
        *((dict.fromkeys(COLUMNS, (100.0,) * n), f"for {n} actuators, reference-a has 2") for n in (1, 3)),
    ],
)
def test_a_drive_that_is_none_of_this_device_is_refused_by_name(changes: dict[str, Any], names: str) -> None:
    with pytest.raises(LimitError, match=names):
        clamp(replace(drive_of((150.0, 150.0), (0.1, 0.1)), **changes), REFERENCE)


def test_a_slew_that_the_firmware_cannot_count_is_refused() -> None:
    with pytest.raises(LimitError, match=r"limits\.ramp: 2 s"):
        link_configuration(replace(REFERENCE, limits=replace(REFERENCE.limits, slew_per_s=0.5)))
