"""Laws of the NetCDF form: the same measurements as from CSV, in any unit; what is wrong is named."""

from pathlib import Path

import numpy as np
import pytest
import xarray

from precompute.measurements.netcdf import read_netcdf
from precompute.measurements.types import MeasurementError, Measurements
from tests.precompute.devices import shipped
from tests.precompute.measured import NAN, read_bar
from tests.precompute.measurements.test_csv import assert_same

DEVICE = shipped("reference-a")
READ = read_bar(DEVICE, {}, ((150, 130), (140, NAN)), points=3)


def dataset(read: Measurements) -> xarray.Dataset:
    each, pair = ("measurement",), ("measurement", "actuator")
    return xarray.Dataset(
        {
            "position": (each, 1e3 * read.position_m, {"units": "mm"}),
            "frequency": (pair, read.frequency_hz, {"units": "Hz"}),
            "amplitude": (pair, np.abs(read.amplitude), {"units": "1"}),
            "sensor_mass": (each, 1e3 * read.sensor_mass_kg, {"units": "g"}),
            "peak_acceleration": (each, read.acceleration.real, {"units": "m s-2"}),
        },
        coords={"actuator": [actuator.name for actuator in DEVICE.actuators]},
        attrs={"source": "SIMULATED by a test"},
    )


def written(data: xarray.Dataset, folder: Path) -> Path:
    path = folder / "x.nc"
    data.to_netcdf(path, engine="h5netcdf")
    return path


def test_the_same_is_read_as_was_written(tmp_path: Path) -> None:
    assert_same(read_netcdf(written(dataset(READ), tmp_path), DEVICE, 0.0), READ)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.assign_coords(actuator=["right", "left"]), "expected a coordinate with left, right"),
        (lambda d: d.drop_vars("actuator"), "expected a coordinate with left, right"),
        (lambda d: d.assign(weight=d.position), "weight: unknown variable; over 'measurement' are known position"),
        (lambda d: d.assign(position=d.position.drop_attrs()), "position: has no attribute 'units'"),
        (lambda d: d.assign(position=d.position.assign_attrs(units="kg")), "position: '1 kg' is a mass"),
        (lambda d: d.drop_vars("peak_acceleration"), "expected either a column 'peak acceleration'"),
        (lambda d: d.assign(position=(("measurement",), ["a"] * 6, {"units": "mm"})), "position: could not convert"),
    ],
)
def test_what_is_wrong_is_named(change: object, message: str, tmp_path: Path) -> None:
    assert callable(change)
    with pytest.raises(MeasurementError) as caught:
        read_netcdf(written(change(dataset(READ)), tmp_path), DEVICE, 0.0)
    assert message in str(caught.value)


def test_a_value_that_is_no_number_is_named_by_its_place(tmp_path: Path) -> None:
    data = dataset(READ)
    data.peak_acceleration[4] = np.nan
    with pytest.raises(MeasurementError, match="measurement 4: peak_acceleration: nan"):
        read_netcdf(written(data, tmp_path), DEVICE, 0.0)


def test_another_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.nc").write_text("no NetCDF")
    with pytest.raises(MeasurementError, match="not a NetCDF-4 file"):
        read_netcdf(tmp_path / "x.nc", DEVICE, 0.0)
