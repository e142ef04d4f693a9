"""Laws of threshold curves: shipped points are met, straight lines lie between, every way to write one is the same."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.device import Device, DeviceError, Threshold
from engine.device.threshold import DEFAULT, read_threshold_file, shipped_threshold
from tactable.shipped import device_folder, find_device
from tests.engine.device.test_description import TEXT
from tests.precompute.sampled import threshold

OWN, ANDROID = shipped_threshold(DEFAULT), shipped_threshold("android")
GRAVITY_M_PER_S2 = 9.80665
CURVES = device_folder().parent / "thresholds"


def level_db(curve: Threshold, *frequency_hz: float, reference: float = 1e-6) -> list[float]:
    decibels: list[float] = (20 * np.log10(curve.peak_m_per_s2(np.array(frequency_hz)) / reference)).tolist()
    return decibels


def test_androids_curve_has_the_41_points_of_its_source_and_of_the_present_one_two_were_measured() -> None:
    assert len(ANDROID.frequency_hz) == 41 and (ANDROID.frequency_hz[0], ANDROID.frequency_hz[-1]) == (0.4, 400.0)
    known = dict(zip(ANDROID.frequency_hz, ANDROID.level_db, strict=True))
    assert (known[40.0], known[86.4], known[250.0]) == (-32.81, -31.94, -28.98)
    assert level_db(ANDROID, *known, reference=GRAVITY_M_PER_S2) == pytest.approx(list(known.values()))
    assert ANDROID.measured_hz is None
    assert OWN.measured_hz == (40.0, 250.0) and OWN.people_db == 8.0


@given(st.floats(40, 300) | st.sampled_from(OWN.frequency_hz))
def test_between_points_each_curve_is_what_numpy_interpolates(frequency_hz: float) -> None:
    assert OWN.peak_m_per_s2(np.array([frequency_hz]))[0] == pytest.approx(threshold(frequency_hz))
    between = np.interp(frequency_hz, ANDROID.frequency_hz, ANDROID.level_db)
    assert level_db(ANDROID, frequency_hz, reference=GRAVITY_M_PER_S2) == pytest.approx([between])


@given(st.floats(0.05, 1.0))
def test_beyond_the_points_one_goes_on_and_the_other_is_held(octaves: float) -> None:
    first, second = level_db(OWN, 40 / 2**octaves, 40.0)
    assert (first - second) / octaves == pytest.approx((113.0 - 110.6) / np.log2(60 / 40))
    last, beyond = level_db(OWN, 300.0, 300 * 2**octaves)
    assert (beyond - last) / octaves == pytest.approx((105.5 - 102.3) / np.log2(300 / 250))
    ends = level_db(ANDROID, 0.4 / 2**octaves, 400 * 2**octaves, reference=GRAVITY_M_PER_S2)
    assert ends == pytest.approx([-97.81, -19.81])


def test_rms_displacement_means_the_same_acceleration_as_its_peak() -> None:
    moved = replace(OWN, quantity="displacement", amplitude="rms")
    hz = np.array([60.0, 250.0])
    assert moved.peak_m_per_s2(hz) == pytest.approx(OWN.peak_m_per_s2(hz) * np.sqrt(2) * (2 * np.pi * hz) ** 2)


def test_a_device_has_the_present_curve_unless_its_file_names_another_one() -> None:
    device = find_device("reference-a")
    assert device.threshold is OWN
    named = Device.parse(f'threshold = "{DEFAULT}"\n{TEXT}', "named")
    assert named.fingerprint == device.fingerprint
    other = Device.parse(f'threshold = "android"\n{TEXT}', "other")
    assert other.threshold is ANDROID and other.fingerprint != device.fingerprint
    assert device.with_values({"threshold": "android"}).fingerprint == other.fingerprint


def test_a_file_of_ones_own_becomes_part_of_the_description(tmp_path: Path) -> None:
    curve = (CURVES / "android.toml").read_text(encoding="utf-8").replace('name = "android"', 'name = "mine"')
    (tmp_path / "mine.toml").write_text(curve, encoding="utf-8")
    (tmp_path / "bar.toml").write_text(f'threshold = "mine.toml"\n{TEXT}', encoding="utf-8")
    device = Device.read(tmp_path / "bar.toml")
    (tmp_path / "mine.toml").unlink()
    again = Device.parse(device.text, "a table's attribute")
    assert again.threshold == device.threshold and again.threshold.name == "mine"
    assert again.fingerprint == device.fingerprint == device.with_values({"threshold": "android"}).fingerprint
    assert again.with_values({"threshold": DEFAULT}).fingerprint == find_device("reference-a").fingerprint


FORCES_DB = {0.2: (111.3, 103.8), 2.0: (113.0, 102.2), 4.9: (111.1, 99.7), 7.8: (109.6, 97.6), 10.8: (109.5, 98.6)}


def test_at_another_force_the_curve_moves_by_what_was_measured_and_else_not_at_all() -> None:
    base = np.array(level_db(OWN, 40.0, 250.0))
    for force_n, measured in FORCES_DB.items():
        pressed = OWN.at_force(force_n)
        assert np.array(level_db(pressed, 40.0, 250.0)) - base == pytest.approx(np.subtract(measured, FORCES_DB[2.0]))
        assert pressed.above == f"above threshold oh-choi-2019 at {force_n:g} N"
    same = OWN.at_force(2.0)
    assert same.level_db == OWN.level_db and OWN.above == "above threshold oh-choi-2019 at 2 N (assumed)"
    assert same.values == OWN.values  # so that no table becomes stale
    between = np.sqrt(2.0 * 4.9)
    assert level_db(OWN.at_force(between), 250.0)[0] - base[1] == pytest.approx((99.7 - 102.2) / 2)
    middle = level_db(OWN.at_force(7.8), 100.0)[0] - level_db(OWN, 100.0)[0]
    assert middle == pytest.approx(np.interp(np.log(100), np.log([40, 250]), [-3.4, -4.6]))
    assert OWN.at_force(50.0).level_db == OWN.at_force(10.8).level_db
    with pytest.raises(DeviceError, match="android: says nothing of forces; take oh-choi-2019"):
        ANDROID.at_force(5.0)
    assert ANDROID.above == "above threshold android"


WRONG = {
    "android": (
        ("level_db = [\n    -97.81,", "level_db = [", "level_db: .* expected one level for each of 41 frequencies"),
        ("0.4, 2.0,", "2.0, 2.0,", "frequency_hz: .* expected rising frequencies"),
        ("-97.81", "-1e4", "level_db: .* expected 2 to 1000 numbers from -300 to 300"),
        ('"9.80665 m/s^2"', '"1 m"', "reference: '1 m' is a length; expected an acceleration"),
        ('amplitude = "peak"', 'amplitude = "mean"', "amplitude: 'mean': expected one of peak, rms"),
        ('beyond = "held"', 'beyond = "held"\nbegins = 1', "begins: 1: unknown key"),
        ('beyond = "held"', 'beyond = "held"\nmeasured_hz = [41]', "measured_hz: .* expected some of frequency_hz"),
        ('beyond = "held"', 'beyond = "held"\npeople_db = -1', "people_db: -1: expected a number from 0 to 300"),
    ),
    DEFAULT: (
        ("force_n = 2.0", "force_n = 0", "force_n: 0: expected a number from 0.001"),
        ("force_n = 2.0", "", "force_n"),
        ("[0.2, 2.0, 4.9,", "[2.0, 0.2, 4.9,", "forces_db: .* expected a row for each of the rising forces_n"),
        ("[113.0, 102.2]", "[113.0]", "forces_db: .* a level in it for each of measured_hz"),
        ("measured_hz = [40.0, 250.0]", "", "forces_db: "),
    ),
}
"""What is wrong in a curve: its text before and after, and what the message says."""


@pytest.mark.parametrize(
    ("name", "before", "after", "text"), [(name, *row) for name, rows in WRONG.items() for row in rows]
)
def test_a_wrong_value_of_a_curve_is_refused_by_name(
    tmp_path: Path, name: str, before: str, after: str, text: str
) -> None:
    curve = (CURVES / f"{name}.toml").read_text(encoding="utf-8")
    assert before in curve
    path = tmp_path / "wrong.toml"
    path.write_text(curve.replace(before, after), encoding="utf-8")
    with pytest.raises(DeviceError, match=text):
        read_threshold_file(path)


@pytest.mark.parametrize(
    ("value", "says"), [('"louder"', "android, oh-choi-2019"), ("3", "android"), ('"mine.toml"', "names no other file")]
)
def test_what_is_no_curve_is_refused(tmp_path: Path, value: str, says: str) -> None:
    with pytest.raises(DeviceError, match=rf"threshold: .*{says}"):
        Device.parse(f"threshold = {value}\n{TEXT}", "text")
    (tmp_path / "bar.toml").write_text(f'threshold = "gone.toml"\n{TEXT}', encoding="utf-8")
    with pytest.raises(DeviceError, match=r"threshold: .*gone\.toml: .*No such file"):
        Device.read(tmp_path / "bar.toml")
