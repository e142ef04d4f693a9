"""Laws of transfer functions from responses: those of the true actuators, within their errors, or a refusal by name."""

from dataclasses import replace

import numpy as np
import pytest

from engine.device import Device
from precompute.calibration.fitted import text_with_transfers
from precompute.calibration.transfer_fit import GREATEST_ERROR, TransferError, find_transfers
from precompute.measurements.types import Kind, Measurements
from tests.engine.device.test_actuator_transfer import coupled, lag
from tests.precompute.measured import NAN, read_bar
from tests.precompute.model.test_transfers import BARE, DEVICE

HZ = np.arange(62.0, 300.0, 14.0)


def readings_of(true: Device, noise: float = 0.0) -> Measurements:
    """Responses of each actuator alone, at 40 % and ahead by a quarter turn, at all frequencies and five places."""
    drives_hz = [drive for hz in HZ.tolist() for drive in ((hz, NAN), (NAN, hz))]
    read = read_bar(true, {}, drives_hz, points=5, kind=Kind.RESPONSE)
    random, size = np.random.default_rng(3), noise * abs(read.acceleration).mean()
    flaw = size * (random.standard_normal(len(read)) + 1j * random.standard_normal(len(read)))
    return replace(read, amplitude=0.4j * read.amplitude, acceleration=0.4j * (read.acceleration + flaw))


def test_a_bar_that_is_known_shows_the_transfer_functions_of_its_actuators() -> None:
    exact = replace(BARE, spread=replace(BARE.spread, stiffness=0.0, mass=0.0))
    for found, system in zip(find_transfers(exact, readings_of(DEVICE)), (lag, coupled), strict=True):
        assert found.value == pytest.approx(system(2j * np.pi * HZ), rel=2e-3)
        assert found.frequency_hz == pytest.approx(HZ)
        assert found.error.max() < 1e-3


def test_of_a_bar_that_is_not_known_the_errors_say_so() -> None:
    """The true bar is 1.5 % stiffer and its first mount 2 % softer than described: within the spread of the file."""
    left, right = DEVICE.actuators
    true = replace(
        DEVICE,
        surface=replace(DEVICE.bar, youngs_modulus_pa=1.015 * DEVICE.bar.youngs_modulus_pa),
        actuators=(replace(left, stiffness_n_per_m=0.98 * left.stiffness_n_per_m), right),
    )
    for found, system in zip(find_transfers(BARE, readings_of(true, noise=0.01)), (lag, coupled), strict=True):
        off = abs(found.value / system(2j * np.pi * found.frequency_hz) - 1)
        assert 3 <= len(found.frequency_hz) < len(HZ)
        assert len(found.frequency_hz) + len(found.left_out_hz) == len(HZ)
        assert found.error.max() <= GREATEST_ERROR
        assert np.mean(off < 2.5 * found.error) > 0.8


def test_those_of_the_file_are_replaced_and_the_text_is_read_again() -> None:
    exact = replace(DEVICE, spread=replace(DEVICE.spread, stiffness=0.0, mass=0.0), text=BARE.text)
    found = find_transfers(exact, readings_of(DEVICE))
    read = Device.parse(text_with_transfers(BARE, [each.transfer for each in found]), "new.toml")
    for actuator, each in zip(read.actuators, found, strict=True):
        assert actuator.transfer is not None
        assert actuator.transfer.value == pytest.approx(each.value, rel=1e-3)
    again = Device.parse(text_with_transfers(read, [each.transfer for each in found]), "again.toml")
    assert again.fingerprint == read.fingerprint


def test_what_shows_no_transfer_function_is_refused() -> None:
    readings = readings_of(BARE)
    with pytest.raises(TransferError, match="need complex responses"):
        find_transfers(BARE, replace(readings, kind=Kind.PEAK))
    with pytest.raises(TransferError, match="finger on it"):
        find_transfers(BARE, replace(readings, finger_m=np.full(len(readings), 0.1)))
    with pytest.raises(TransferError, match="one actuator alone"):
        find_transfers(BARE, replace(readings, amplitude=np.ones((len(readings), 2), dtype=np.complex128)))
    two = readings.part(readings.position_m < 0.1)
    with pytest.raises(TransferError, match=r"left: 0 of 17 frequencies were read at 3 places or more"):
        find_transfers(BARE, two)
    unknown = replace(BARE, spread=replace(BARE.spread, stiffness=0.15, mass=0.15))
    with pytest.raises(TransferError, match=r"left: \d+ of 17 frequencies give it within 10 %: .*calibrate it first"):
        find_transfers(unknown, readings)
