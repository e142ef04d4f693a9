"""Laws of the core's linearisation: squares of voltages follow displacements, within the greatest voltage, cleanly."""

import ctypes

import numpy as np
import pytest

from base.arrays import Array, Integers
from firmware_link.emulator.c_core import CompiledFirmware
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.messages import LINEARISES, Hello
from tests.firmware_link.firmware.compiled_core import FULL_OUTPUT, core_library
from tests.firmware_link.law_host import greeting
from tests.firmware_link.virtual_rig import decode_messages

GREATEST = 65_535
BIASES = [1, 13_107, 32_768, 46_340, 46_341, 60_000, 65_535]
DISPLACEMENTS = np.arange(-32_768, 32_768, 7)


def voltages(bias: int, displacements: Integers) -> Array:
    """What the core sends, as fractions of the greatest voltage."""
    function = core_library().electrode_output
    function.argtypes, function.restype = (ctypes.c_uint16, ctypes.c_int16), ctypes.c_int16
    outputs = np.array([function(bias, displacement) for displacement in displacements.tolist()])
    return (outputs + 32_768) / GREATEST


def second_harmonic_db(voltage: Array) -> float:
    """Of the force of a whole number of turns of a tone, below the tone."""
    spectrum = abs(np.fft.rfft(voltage**2))
    tone = int(spectrum[1:].argmax()) + 1
    return float(20 * np.log10(spectrum[2 * tone] / spectrum[tone]))


@pytest.mark.parametrize("bias", BIASES)
def test_squares_follow_displacements_within_rounding_and_no_voltage_passes_the_greatest(bias: int) -> None:
    found, b = voltages(bias, DISPLACEMENTS), bias / GREATEST
    moved = np.maximum(DISPLACEMENTS, -FULL_OUTPUT) / FULL_OUTPUT
    exact = np.sqrt(np.maximum(b**2 + min(b**2, 1 - b**2) * moved, 0.0))
    assert found.min() >= 0.0
    assert found.max() <= 1.0
    assert (np.diff(found) >= 0).all()
    # Half a step, and near no voltage what rounding to whole squares does to a root: that of one.
    assert abs(found - exact).max() <= 1.0 / GREATEST
    assert voltages(bias, np.array([0]))[0] == pytest.approx(b, abs=1e-9)


@pytest.mark.parametrize("amplitude", [0.1, 0.5, 1.0])
def test_the_force_of_a_linearised_tone_has_no_second_harmonic(amplitude: float) -> None:
    turns = 2 * np.pi * 7 * np.arange(4_096) / 4_096
    displacements = np.rint(amplitude * FULL_OUTPUT * np.sin(turns)).astype(np.int64)
    straight = 0.5 + displacements / 65_534  # outputs as displacements, about half of the greatest voltage
    assert second_harmonic_db(straight) == pytest.approx(20 * np.log10(amplitude / 4), abs=0.01)
    linearised = voltages(46_340, displacements)
    assert second_harmonic_db(linearised) < -80
    of_12_bits = np.floor(linearised * 4_096) / 4_096
    assert second_harmonic_db(of_12_bits) < -55


@pytest.mark.parametrize("bias", [0, 46_340])
def test_a_board_that_linearises_says_so_and_another_keeps_its_displacements(bias: int) -> None:
    configuration = DeviceConfiguration(boot_id=1, electrode_bias=bias)
    firmware, greeted = CompiledFirmware(core_library(), configuration), encode_message(greeting(), 0)
    said = firmware.receive(greeted, 1_000)
    outputs = [_outputs_of(firmware, pair) for pair in ((0, 32_767), (-32_767, -32_768))]
    firmware.close()
    assert said == EmulatedFirmware(configuration).receive(greeted, 1_000)
    assert [LINEARISES in each.features for each in decode_messages(said) if isinstance(each, Hello)] == [bias > 0]
    at_ends = [[46_340 - 32_768, 32_767], [-32_768, -32_768]]
    assert outputs == (at_ends if bias else [[0, 32_767], [-32_767, -32_768]])


def _outputs_of(firmware: CompiledFirmware, displacements: tuple[int, int]) -> list[int]:
    """What a board sends for the displacements of one instant."""
    values = (ctypes.c_int16 * len(displacements))(*displacements)
    core_library().host_linearise(ctypes.c_void_p(firmware._host), values)
    return list(values)
