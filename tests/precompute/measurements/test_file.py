"""A file of measurements is read by its ending; what has none that is known, or is not there, is refused."""

from pathlib import Path

import pytest

from precompute.measurements.csv import write_csv
from precompute.measurements.file import read_measurements
from precompute.measurements.types import Kind, MeasurementError
from tests.precompute.devices import SHIPPED, shipped
from tests.precompute.measured import read_bar
from tests.precompute.measurements import test_netcdf, test_uff

DEVICE = shipped("reference-a")


def test_every_ending_has_its_reader(tmp_path: Path) -> None:
    read = read_bar(DEVICE, {}, points=3)
    csv = tmp_path / "x.CSV"
    csv.write_text(write_csv(read, DEVICE, "a test"), encoding="utf-8")
    netcdf = test_netcdf.written(test_netcdf.dataset(read), tmp_path)
    universal = test_uff.written(tmp_path, test_uff.nodes(), test_uff.response(1, 8))
    assert [len(read_measurements(path, DEVICE)) for path in (csv, netcdf, universal)] == [9, 9, 3]
    assert read_measurements(universal, DEVICE, 2e-3).kind is Kind.RESPONSE


def test_another_ending_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match=r"x\.xlsx: measurements end in \.csv, \.nc"):
        read_measurements(tmp_path / "x.xlsx", DEVICE)


@pytest.mark.parametrize("name", ["x.csv", "x.nc", "x.uff"])
def test_no_file_is_an_error_of_the_system(name: str, tmp_path: Path) -> None:
    with pytest.raises(OSError, match=name):
        read_measurements(tmp_path / name, DEVICE)


def test_the_shipped_measurements_are_read_and_say_that_they_are_simulated() -> None:
    paths = sorted((SHIPPED.parent / "measurements").glob("*.csv"))
    assert paths
    for path in paths:
        assert read_measurements(path, DEVICE).is_simulated
