"""A file of measurements is read by its ending; what has none that is known, or is not there, is refused."""

import os
from pathlib import Path

import pytest

from engine.files import WriteError
from precompute.measurements.csv import write_csv
from precompute.measurements.file import MOST_BYTES, read_measurements, write_measurements
from precompute.measurements.types import Kind, MeasurementError
from tests.engine.test_files import full_disk
from tests.precompute.devices import SHIPPED, shipped
from tests.precompute.measured import NAN, read_bar
from tests.precompute.measurements import test_netcdf, test_uff

DEVICE = shipped("reference-a")


@pytest.mark.machine
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


def test_what_is_no_plain_file_or_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    pipe, large = tmp_path / "pipe.csv", tmp_path / "large.csv"
    os.mkfifo(pipe)
    with large.open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    with pytest.raises(MeasurementError, match=r"pipe\.csv: is not a plain file"):
        read_measurements(pipe, DEVICE)
    with pytest.raises(MeasurementError, match=r"large\.csv: has 100 MB, expected at most 100 MB"):
        read_measurements(large, DEVICE)


@pytest.mark.parametrize("ending", [".csv", ".nc", ".uff"])
@pytest.mark.parametrize("room", [0, 4096, 8192, 12_288])
def test_a_full_disk_is_one_error_and_leaves_nothing(ending: str, room: int, tmp_path: Path) -> None:
    """HDF5 ends the process by a segmentation fault where it closes a file that the disk did not take."""
    read = read_bar(DEVICE, {}, ((150, NAN), (160, NAN), (NAN, 130), (NAN, 140)), points=100, kind=Kind.RESPONSE)
    path = tmp_path / f"bar{ending}"
    with full_disk(room), pytest.raises(WriteError, match=rf"bar\{ending}: cannot be written there: File too large"):
        write_measurements(path, read, DEVICE, "a test")
    assert list(tmp_path.iterdir()) == []


def test_the_shipped_measurements_are_read_and_say_that_they_are_simulated() -> None:
    paths = sorted((SHIPPED.parent / "measurements").glob("*.csv"))
    assert paths
    for path in paths:
        assert read_measurements(path, DEVICE).is_simulated
