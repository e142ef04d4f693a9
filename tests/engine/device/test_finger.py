"""Laws of fingers as data: what is stated is taken, what was measured is fitted, and what does not fit is refused."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.device import Device, DeviceError, Finger
from engine.device.finger import impedance_of
from engine.device.named_files import IMPEDANCE_HEADER
from tactable.shipped import find_device
from tests.engine.device.test_description import TEXT

BARE = TEXT[: TEXT.index("[finger]")] + TEXT[TEXT.index("[spread]") :]
HZ = np.arange(40.0, 401.0, 20.0)
FINGER = Finger(2e-4, 1.5, 1500.0, 3.0)


def points(finger: Finger, hz: object = HZ, error: float = 0.0) -> list[list[float]]:
    """Impedances of a finger, each off by a relative error of chance direction."""
    hz = np.asarray(hz)
    off = 1 + error * np.exp(2j * np.pi * np.random.default_rng(3).random(len(hz)))
    values = impedance_of(finger, hz) * off
    return np.stack([hz, np.maximum(values.real, 0), values.imag], axis=1).tolist()  # type: ignore[no-any-return]


def measured(rows: object, more: str = "spread = 3.0") -> Device:
    return Device.parse(f"{BARE}[finger]\n{more}\nimpedance = {rows}\n", "text")


def test_the_shipped_finger_is_that_of_the_shipped_devices() -> None:
    device, named = find_device("reference-a"), Device.parse(f'finger = "fingertip"\n{BARE}', "text")
    assert named.finger == device.finger and named.fingerprint == device.fingerprint
    assert sorted(named.inferred) == sorted(device.inferred)
    assert named.finger_origin.name == "fingertip" and "RoboMech" in named.finger_origin.source
    assert Device.parse(named.text, "again").finger_origin == named.finger_origin


@given(st.floats(0.01, 10), st.floats(0.03, 30), st.floats(30, 3e4))
def test_a_mass_damper_and_spring_is_found_from_its_impedance(mass_g: float, damping: float, stiffness: float) -> None:
    finger = Finger(1e-3 * mass_g, damping, stiffness, 3.0)
    found = measured(points(finger))
    assert found.finger.damping_n_s_per_m == pytest.approx(damping)
    assert impedance_of(found.finger, HZ) == pytest.approx(impedance_of(finger, HZ), rel=1e-9)
    assert found.finger_origin.misfit == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("mass_kg", "stiffness_n_per_m"), [(-2e-5, 800.0), (1e-3, -200.0)])
def test_no_mass_and_no_stiffness_comes_out_negative(mass_kg: float, stiffness_n_per_m: float) -> None:
    found = measured(points(Finger(mass_kg, 1.0, stiffness_n_per_m, 3.0))).finger
    assert min(found.mass_kg, found.stiffness_n_per_m) == 0 < max(found.mass_kg, found.stiffness_n_per_m)


def test_a_value_beside_an_impedance_replaces_its_own_as_a_calibration_does() -> None:
    device = measured(points(FINGER)).with_values({"finger.stiffness": "2 kN/m"})
    assert device.finger.stiffness_n_per_m == 2000 and device.finger.mass_kg == pytest.approx(2e-4)
    assert device.finger_origin.misfit and device.finger_origin.misfit > 0.1


def test_files_become_part_of_the_description(tmp_path: Path) -> None:
    lines = [",".join(f"{value!r}" for value in row) for row in points(FINGER)]
    (tmp_path / "hands").mkdir()
    (tmp_path / "hands" / "mine.csv").write_text("# measured\n" + "\n".join([IMPEDANCE_HEADER, *lines]) + "\n")
    text = 'name = "mine"\nsource = "a bench"\nimpedance = "mine.csv"\nspread = 2\ninferred = ["spread"]\n'
    (tmp_path / "hands" / "mine.toml").write_text(text)
    (tmp_path / "bar.toml").write_text(f'finger = "hands/mine.toml"\n{BARE}')
    device = Device.read(tmp_path / "bar.toml")
    (tmp_path / "bar.toml").write_text(f'{BARE}[finger]\nimpedance = "hands/mine.csv"\nspread = 2\n')
    assert Device.read(tmp_path / "bar.toml").fingerprint == device.fingerprint
    again = Device.parse(device.text, "a table's attribute")
    assert again.fingerprint == device.fingerprint and again.finger_origin == device.finger_origin
    assert again.finger_origin.name == "mine" and len(again.finger_origin.impedance) == len(HZ)
    assert again.finger.mass_kg == pytest.approx(2e-4) and "finger.spread" in again.inferred


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        (points(Finger(1e-4, 1, 1e3, 3), np.arange(80, 401, 20)), "80 to 400 Hz': does not cover the sweep, 60-300 Hz"),
        (points(Finger(1e-4, 1, 1e3, 3), np.arange(40, 281, 20)), "40 to 280 Hz': does not cover the sweep, 60-300 Hz"),
        ([[40, 1, 1], [400, 1, 1]], "expected 3 to 10000 points"),
        ([[40, 1, 1], [40, 1, 1], [400, 1, 1]], "point 2: expected .* by rising frequency"),
        ([[40, 1, 1], [50, -1, 1], [400, 1, 1]], "point 2: expected .* real parts of 0 or more"),
        ([[40, 1, 1], [50, 0, 0], [400, 1, 1]], "point 2: expected"),
        ([[40, 1, 1], [50, 1], [400, 1, 1]], "expected 3 to 10000 points"),
        ([[40, 1, 1], [150, 90, 1], [400, 1, 1]], "no mass, damper and spring comes nearer than a factor of"),
        ('"mine.csv"', "a text that is no file names no other file"),
    ],
)
def test_what_is_no_impedance_of_a_finger_on_this_bar_is_refused(rows: object, text: str) -> None:
    with pytest.raises(DeviceError, match=f"finger.impedance: .*{text}"):
        measured(rows)
    with pytest.raises(DeviceError, match=r"finger: 'thumb': .*fingertip"):
        Device.parse(f'finger = "thumb"\n{BARE}', "text")


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("1,2,3\n", "line 1: expected the header"),
        (f"{IMPEDANCE_HEADER}\n40,1,1\n50,x,1\n", "line 3: '50,x,1': expected three numbers"),
        (f"{IMPEDANCE_HEADER}\n40,1,nan\n", "line 2: .*expected three numbers"),
    ],
)
def test_a_wrong_line_of_a_csv_file_is_named(tmp_path: Path, content: str, text: str) -> None:
    (tmp_path / "mine.csv").write_text(content)
    (tmp_path / "bar.toml").write_text(f'{BARE}[finger]\nimpedance = "mine.csv"\n')
    with pytest.raises(DeviceError, match=f"mine.csv: {text}"):
        Device.read(tmp_path / "bar.toml")
