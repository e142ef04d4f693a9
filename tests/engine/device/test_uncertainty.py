"""The [calibration] table: read, counted in the fingerprint, and refused by key where it cannot be."""

import pytest

from engine.device import Device, DeviceError
from tests.engine.device.test_description import TEXT

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
