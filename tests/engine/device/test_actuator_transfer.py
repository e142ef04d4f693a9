"""Laws of transfer functions: points of a causal system give it between them, beside them and off the axis."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from base.arrays import Array
from engine.device import Device, DeviceError, Electrodes, Transfer
from engine.device.actuator_transfer import GREATEST_GROWTH, _fitted
from engine.device.description import MOST_TRANSFER_POINTS
from tests.engine.device.test_description import TEXT

Complex = NDArray[np.complexfloating[Any, Any]]
HZ = np.linspace(60.0, 300.0, 13)
FINE_HZ = np.linspace(60.0, 300.0, 481)
TURN = 2 * np.pi


def lag(s: Complex) -> Complex:
    """An amplifier that falls from 400 Hz on, and half a millisecond of delay."""
    out: Complex = np.exp(-5e-4 * s) / (1 + s / (TURN * 400))
    return out


def coupled(s: Complex) -> Complex:
    """An amplifier that passes no direct current, and falls from 700 Hz on."""
    out: Complex = s / (s + TURN * 20) / (1 + s / (TURN * 700))
    return out


def resonant(s: Complex) -> Complex:
    """A suspension of its own, of 250 Hz and quality 6, in the band."""
    w = TURN * 250
    return np.asarray(w**2 / (s**2 + w * s / 6 + w**2), dtype=np.complex128)


def points_of(system: Callable[[Complex], Complex], frequency_hz: Array = HZ, noise: float = 0) -> Transfer:
    random = np.random.default_rng(4)
    value = system(1j * TURN * frequency_hz)
    value = value * (1 + noise * (random.standard_normal(value.shape) + 1j * random.standard_normal(value.shape)))
    phases_deg = np.degrees(np.angle(value))
    return Transfer(tuple(frequency_hz.tolist()), tuple(abs(value).tolist()), tuple(phases_deg.tolist()))


def rows_of(transfer: Transfer) -> str:
    rows = zip(transfer.frequency_hz, transfer.magnitude, transfer.phase_deg, strict=True)
    return "[" + ", ".join(f'["{hz!r} Hz", "{100 * size!r} %", "{deg!r} deg"]' for hz, size, deg in rows) + "]"


def flat_rows(*hz: float) -> str:
    return rows_of(Transfer(hz, (1.0,) * len(hz), (0.0,) * len(hz)))


def text_with(rows: str) -> str:
    """Reference-a whose first actuator has this transfer function."""
    return TEXT.replace('name = "left"\n', f'name = "left"\ntransfer = {rows}\n')


@pytest.mark.parametrize("system", [lag, coupled, resonant])
def test_points_of_a_system_give_it_between_them_and_beside_the_axis(system: Callable[[Complex], Complex]) -> None:
    transfer, s = points_of(system), 25.0 + 1j * TURN * FINE_HZ
    assert transfer.misses().max() < 2e-3
    assert abs(transfer.at(FINE_HZ) / system(1j * TURN * FINE_HZ) - 1).max() < 2e-3
    assert abs(transfer.series.at(s) / system(s) - 1).max() < 2e-3
    assert all(pole.real < 0 for pole in transfer.series.pole_per_s)


def test_the_file_gives_the_points_and_its_fingerprint_them() -> None:
    transfer, bare = points_of(lag), Device.parse(TEXT, "bare")
    device = Device.parse(text_with(rows_of(transfer)), "bar")
    found = device.actuators[0].transfer
    assert found is not None
    assert found.frequency_hz == transfer.frequency_hz
    assert found.value == pytest.approx(transfer.value, rel=1e-12)
    assert device.actuators[1].transfer is None
    assert device.fingerprint != bare.fingerprint
    other = Transfer(transfer.frequency_hz, transfer.magnitude, tuple(deg - 0.1 for deg in transfer.phase_deg))
    assert Device.parse(text_with(rows_of(other)), "bar").fingerprint != device.fingerprint


def test_a_device_without_transfer_functions_keeps_its_fingerprint() -> None:
    """It is written in every table that was built before there were any."""
    wanted = "2e16832afbecd6b348a3b7f6ecf674640fd22d605887c4f1c7553c59156bce3e"
    then = Device.parse(TEXT, "reference-a").with_values({"spread.finger_position": "4 mm"})
    assert then.fingerprint == wanted


def test_phases_of_the_wrong_sign_are_refused_with_the_remedy() -> None:
    right = points_of(lag, np.linspace(60.0, 300.0, 25))
    wrong = Transfer(right.frequency_hz, right.magnitude, tuple(-deg for deg in right.phase_deg))
    assert right.growth() < 1.1
    assert wrong.growth() > GREATEST_GROWTH
    with pytest.raises(DeviceError, match=r"actuator\[1\].transfer: 25 points: .*turn their sign"):
        Device.parse(text_with(rows_of(wrong)), "bar")


def test_all_points_are_counted_before_a_function_is_fitted_to_any_of_them() -> None:
    """Each of the two actuators has points enough to fit; the first one alone would be read."""
    rows = rows_of(points_of(lag, np.linspace(60.0, 300.0, MOST_TRANSFER_POINTS // 2 + 1)))
    fitted = _fitted.cache_info().misses
    with pytest.raises(
        DeviceError, match=r"actuator\[1\].transfer, actuator\[2\].transfer: 1002 points: .*every other"
    ):
        Device.parse(text_with(rows).replace('name = "right"\n', f'name = "right"\ntransfer = {rows}\n'), "bar")
    assert _fitted.cache_info().misses == fitted


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ('"driver.csv"', r"expected points such as"),
        ('[["60 Hz", "1"]]', r"expected points such as"),
        (flat_rows(60, 300), r"'2 points': expected 3 to 1000"),
        (flat_rows(60, 200, 200), r"'200 Hz': comes after 200 Hz; expected rising frequencies"),
        (flat_rows(60, 200, 250), r"'60-250 Hz': expected points over all of the band, 60-300 Hz"),
        ('[["60 Hz", "0 %", "0 deg"], ["200 Hz", "1 %", "0 deg"], ["300 Hz", "1 %", "0 deg"]]', r"more than 0"),
        ('[["60 Hz", "1 %", "10 %"], ["200 Hz", "1 %", "0 deg"], ["300 Hz", "1 %", "0 deg"]]', r"'10 %' is no angle"),
    ],
)
def test_a_wrong_transfer_is_refused_by_name(rows: str, message: str) -> None:
    with pytest.raises(DeviceError, match=rf"actuator\[1\].transfer: .*{message}"):
        Device.parse(text_with(rows), "bar")


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
