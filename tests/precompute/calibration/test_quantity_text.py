"""What is written of a quantity is read again."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.device.quantity import read_quantity
from engine.device.uncertainty import FITTED_UNITS
from precompute.calibration.quantity_text import interval_text, quantity_text


@given(st.sampled_from(sorted(set(FITTED_UNITS.values()))), st.floats(1e-12, 1e12))
def test_a_device_file_reads_what_is_written(unit: str, value: float) -> None:
    assert read_quantity(quantity_text(value, unit, 12), unit) == pytest.approx(value, rel=1e-11)


def test_quantities_have_the_units_that_people_use() -> None:
    assert quantity_text(18900.0, "N/m") == "18.9 kN/m"
    assert quantity_text(0.52e-6, "m") == "0.52 µm"
    assert interval_text((70e9, 71.5e9), "Pa") == "70 to 71.5 GPa"
    assert quantity_text(0.045, "N*s/m") == "0.045 N*s/m"
