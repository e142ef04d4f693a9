"""The [calibration] table is read and refused by key; a device's values have names, which the fingerprint counts."""

from dataclasses import replace

import pytest

from engine.device import Device, DeviceError
from engine.device.values import Change, compare_values, device_values
from tests.engine.device.test_description import TEXT
from tests.precompute.devices import shipped

DAMPING = 'name = "bar.mass_damping"\nlow = "0 1/s"\nhigh = "100 1/s"\nknee = "0.3 1/s"'
TABLE = f"""
[calibration]
created = "2026-11-21T12:00:00+00:00"
measurements = "measurements.csv"
covariance = [[4e-6, 1e-6], [1e-6, 9e-4]]
[[calibration.fitted]]
name = "actuator[1].stiffness"
low = "10 kN/m"
high = "30 kN/m"
[[calibration.fitted]]
{DAMPING}
"""


def test_what_was_fitted_is_read_in_si_and_counts_in_the_fingerprint_but_not_its_making() -> None:
    uncertainty = Device.parse(TEXT + TABLE, "x.toml").uncertainty
    assert uncertainty is not None
    stiffness, damping = uncertainty.fitted
    assert (stiffness.name, stiffness.low, stiffness.high, stiffness.knee) == ("actuator[1].stiffness", 1e4, 3e4, 0.0)
    assert (damping.low, damping.knee) == (0.0, 0.3)
    assert uncertainty.covariance == ((4e-6, 1e-6), (1e-6, 9e-4))
    device = Device.parse(TEXT + TABLE, "x.toml")
    later = Device.parse(TEXT + TABLE.replace("2026-11-21", "2027-01-01"), "y.toml")
    surer = Device.parse(TEXT + TABLE.replace("4e-6", "5e-6"), "x.toml")
    assert device.fingerprint == later.fingerprint
    assert len({device.fingerprint, surer.fingerprint, Device.parse(TEXT, "x.toml").fingerprint}) == 3


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("actuator[1].stiffness", "actuator[3].stiffness", "fitted[1].name: 'actuator[3].stiffness': there are 2"),
        ("actuator[1].stiffness", "actuator[0].stiffness", "expected such as actuator[1].stiffness"),
        ("actuator[1].stiffness", "bar.length", "fitted[1].name: 'bar.length'"),
        ('"actuator[1].stiffness"', "7", "fitted[1].name: 7"),
        (DAMPING, 'name = "actuator[1].stiffness"\nlow = "1 N/m"\nhigh = "2 N/m"', "names a value twice"),
        ('low = "10 kN/m"', 'low = "0 kN/m"', "fitted[1].low: '0 N/m': expected more than 0"),
        ('high = "30 kN/m"', 'high = "3 kN/m"', "fitted[1].high: '3 kN/m': expected more than 10000 N/m"),
        ('high = "30 kN/m"', 'high = "30 kN/m"\nmiddle = 1', "unknown key"),
        ("[1e-6, 9e-4]", "[1e-6]", "expected 2 rows of 2 numbers"),
        ("[1e-6, 9e-4]", "[2e-6, 9e-4]", "symmetric"),
        ("[[4e-6, 1e-6], [1e-6, 9e-4]]", "[[4e-6, 1e-3], [1e-3, 9e-4]]", "none above what its diagonal allows"),
        ("4e-6", "nan", "calibration.covariance"),
        ("4e-6", '"4e-6"', "calibration.covariance"),
        ('created = "2026', 'made = "2026', "calibration.made"),
    ],
)
def test_what_cannot_be_is_refused_by_key(old: str, new: str, message: str) -> None:
    assert old in TABLE
    with pytest.raises(DeviceError) as caught:
        Device.parse(TEXT + TABLE.replace(old, new), "x.toml")
    assert message in str(caught.value)


DEVICE = shipped("reference-a")


def test_a_value_has_the_name_of_its_place_and_its_unit() -> None:
    values = device_values(DEVICE)
    assert values["actuator[1].stiffness_n_per_m"] == 18900.0
    assert values["actuator[2].band_hz[1]"] == 60.0
    assert values["bar.length_m"] == 0.2794
    assert values["zone[5].name"] == "V"
    assert values["touch_axis.active_length_m"] is None


def test_what_came_and_what_went_is_named_and_per_cent_is_told_of_numbers_only() -> None:
    changes = compare_values({"a": 1.0, "b": "x", "c": 2.0}, {"b": "y", "c": 2.0, "d": 0.5})
    assert changes == (Change("a", 1.0, None), Change("b", "x", "y"), Change("d", None, 0.5))
    assert Change("mass_kg", 2.0, 2.5).percent == 25.0
    for before, after in ((0.0, 1.0), ("x", "y"), (None, 1.0), (False, True)):
        assert Change("key", before, after).percent is None


def test_a_device_is_shown_short_in_a_line_and_as_a_table_in_a_notebook() -> None:
    assert repr(DEVICE).startswith("<Device reference-a: 279.4 mm, 2 actuators, 5 zones, ")
    shown = DEVICE._repr_html_()
    assert "<td>bar</td><td>279.4 mm by " in shown
    assert "<td>actuators</td><td>left at 44.7 mm, 60 to 300 Hz; right at 273 mm, 60 to 300 Hz</td>" in shown
    assert DEVICE.threshold.title in shown and "bar.width" in shown
    assert "<b>" not in replace(DEVICE, name="<b>")._repr_html_().removeprefix("<b>Device</b>")
