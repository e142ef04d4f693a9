"""Laws of measurements: rows taken apart, drives named, rows that cannot be refused by place, column and value."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from precompute.measurements.types import Kind, MeasurementError, check_measurements
from tests.precompute.devices import shipped
from tests.precompute.measured import NAN, read_bar

DEVICE = shipped("reference-a")
READ = read_bar(DEVICE, {}, ((150, 130), (140, NAN)), points=3)


def test_drives_are_numbered_as_they_appear_and_named_as_one_says_it() -> None:
    assert READ.drive_of_row.tolist() == [0, 0, 0, 1, 1, 1]
    turned = READ.part(np.array([5, 0, 4, 1]))
    assert turned.drive_of_row.tolist() == [0, 1, 0, 1]
    assert READ.drive_text(0) == "150 Hz and 130 Hz"
    assert READ.drive_text(3) == "140 Hz and still"
    assert replace(READ, amplitude=0.6j * READ.amplitude).drive_text(3) == "140 Hz at 60 % and still"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"position_m": -1e-3}, "position: -1 mm: expected 0 to 279.4 mm"),
        ({"finger_m": 0.3}, "finger position: 300 mm"),
        ({"frequency_hz": [NAN, 130.0]}, "frequency left: nan Hz: expected more than 0 Hz"),
        ({"amplitude": [1.0, 1.2]}, "amplitude right: 120 %: expected at most 100 %"),
        ({"amplitude": [0.0, 0.0]}, "no actuator moves"),
        ({"sensor_mass_kg": -1e-3}, "sensor mass: -1 g"),
        ({"sensor_mass_kg": 1e297}, "sensor mass: 1e+300 g: expected 0 to 1000 g"),
        ({"acceleration": 0.0}, "acceleration: 0 m/s^2: expected more than 0"),
        ({"acceleration": np.inf}, "acceleration: inf m/s^2"),
        ({"acceleration": 1e300}, "acceleration: 1e+300 m/s^2: expected at most 1e+06"),
        ({"kind": Kind.RESPONSE}, "150 Hz and 130 Hz: a complex response has one frequency"),
    ],
)
def test_a_row_that_cannot_be_is_refused_by_place_column_and_value(changes: dict[str, Any], message: str) -> None:
    bad: dict[str, Any] = {key: value for key, value in changes.items() if key == "kind"}
    for key, value in changes.items():
        if key != "kind":
            bad[key] = np.array(getattr(READ, key))
            bad[key][1] = value
    with pytest.raises(MeasurementError) as caught:
        check_measurements(replace(READ, **bad), DEVICE, "some.csv", lambda row: f"row {row + 2}")
    assert str(caught.value).startswith("some.csv: row 3: " if "kind" not in bad else "some.csv: row 2: ")
    assert message in str(caught.value)
