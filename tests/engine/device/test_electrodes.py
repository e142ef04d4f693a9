"""Laws of electrodes: distortion is that of the squared voltage, and a file that no board can serve is refused."""

import numpy as np
import pytest

from engine.device import Device, DeviceError, Electrodes
from tests.engine.device.test_description import TEXT

TURNS = 2 * np.pi * np.arange(4096) / 4096


def harmonics(electrodes: Electrodes, amplitude: float) -> tuple[float, float]:
    """Amplitudes of the force and of its second harmonic, from the voltages of a tone."""
    swing = amplitude * min(electrodes.bias, 1 - electrodes.bias)
    force = (electrodes.bias + swing * np.sin(TURNS)) ** 2
    if electrodes.number == 2:
        force -= (electrodes.bias + swing * np.sin(TURNS + np.radians(electrodes.phase_gap_deg))) ** 2
    spectrum = 2 * abs(np.fft.rfft(force)) / len(TURNS)
    return float(spectrum[1]), float(spectrum[2])


@pytest.mark.parametrize("bias", [0.3, 0.5, 0.8])
@pytest.mark.parametrize(("number", "gap_deg"), [(1, 180.0), (2, 180.0), (2, 120.0), (2, 35.0)])
@pytest.mark.parametrize("amplitude", [1.0, 0.25])
def test_the_second_harmonic_is_of_squared_voltages(bias: float, number: int, gap_deg: float, amplitude: float) -> None:
    electrodes = Electrodes(number, bias, gap_deg, "nothing")
    force, second = harmonics(electrodes, amplitude)
    assert electrodes.second_harmonic(amplitude) == pytest.approx(second / force, rel=1e-9, abs=1e-12)


def with_electrodes(*lines: str) -> str:
    """Reference-a with this table for both actuators."""
    table = "\n".join(["[actuator.electrodes]", *lines])
    return TEXT.replace('[[actuator]]\nname = "right"', f'{table}\n\n[[actuator]]\nname = "right"').replace(
        "[zones]", f"{table}\n\n[zones]"
    )


def test_the_file_says_what_is_there() -> None:
    device = Device.parse(with_electrodes("number = 2", 'bias = "50 %"', 'phase_gap = "90 deg"'), "bar")
    assert [each.electrodes for each in device.actuators] == [Electrodes(2, 0.5, 90.0, "nothing")] * 2
    device = Device.parse(with_electrodes("number = 1", 'bias = "75 %"', 'linearised_by = "board"'), "bar")
    assert device.actuators[1].electrodes == Electrodes(1, 0.75, 180.0, "board")
    assert device.fingerprint != Device.parse(TEXT, "bare").fingerprint


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (("number = 3", 'bias = "50 %"'), "number: 3: expected a whole number from 1 to 2"),
        (("number = 1",), r"\[actuator\[1\].electrodes\] has no key 'bias'"),
        (("number = 1", 'bias = "0 %"'), "bias: '0 %': expected more than 0"),
        (("number = 1", 'bias = "100 %"'), "bias: '100 %': expected less than 100 %"),
        (("number = 1", 'bias = "50 %"', 'phase_gap = "90 deg"'), "one electrode has none; leave it out"),
        (("number = 2", 'bias = "50 %"', 'phase_gap = "360 deg"'), "less than 360 deg"),
        (("number = 2", 'bias = "50 %"', 'phase_gap = "half"'), "phase_gap: .*is no angle"),
        (("number = 1", 'bias = "50 %"', 'linearised_by = "me"'), "expected one of board, amplifier, nothing"),
        (("number = 2", 'bias = "50 %"', 'linearised_by = "board"'), "linear without; leave it out"),
        (("number = 1", 'bias = "50 %"', 'gap = "1 mm"'), "gap: '1 mm': unknown key"),
    ],
)
def test_a_wrong_table_is_refused_by_name(lines: tuple[str, ...], message: str) -> None:
    with pytest.raises(DeviceError, match=message):
        Device.parse(with_electrodes(*lines), "bar")


def test_a_board_linearises_with_one_bias() -> None:
    text = with_electrodes("number = 1", 'bias = "70 %"', 'linearised_by = "board"')
    with pytest.raises(DeviceError, match=r"60 % and 70 %: a board has one bias"):
        Device.parse(text.replace("70 %", "60 %", 1), "bar")
