"""A file of measurements is read by its ending; what has none that is known, or is not there, is refused."""

import os
from pathlib import Path

import pytest

from base.files import WriteError
from precompute.measurements.csv import write_csv
from precompute.measurements.measurement_file import MOST_BYTES, read_measurements, write_measurements
from precompute.measurements.types import Kind, MeasurementError
from tests.base.test_files import full_disk
from tests.precompute.devices import shipped
from tests.precompute.measured import NAN, read_bar
from tests.precompute.measurements import test_uff
from tests.quick import first_quick

DEVICE = shipped("reference-a")


def test_every_ending_has_its_reader(tmp_path: Path) -> None:
    read = read_bar(DEVICE, {}, points=3)
    csv = tmp_path / "x.CSV"
    csv.write_text(write_csv(read, DEVICE, "a test"), encoding="utf-8")
    universal = test_uff.written(tmp_path, test_uff.nodes(), test_uff.response(1, 8))
    assert [len(read_measurements(path, DEVICE)) for path in (csv, universal)] == [9, 3]
    assert read_measurements(universal, DEVICE, 2e-3).kind is Kind.RESPONSE


@pytest.mark.parametrize("ending", [".csv", ".uff"])
@pytest.mark.parametrize("room", first_quick([0, 8192, 4096, 12_288], 2))
def test_a_full_disk_is_one_error_and_leaves_nothing(ending: str, room: int, tmp_path: Path) -> None:
    read = read_bar(DEVICE, {}, ((150, NAN), (160, NAN), (NAN, 130), (NAN, 140)), points=100, kind=Kind.RESPONSE)
    path = tmp_path / f"bar{ending}"
    with full_disk(room), pytest.raises(WriteError, match=rf"bar\{ending}: cannot be written there: File too large"):
        write_measurements(path, read, DEVICE, "a test")
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_file_of_measurements_is_refused_by_name(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    with (tmp_path / "large.csv").open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    for name, says in (("x.xlsx", ".csv, .uff"), ("pipe.csv", "plain file"), ("large.csv", "at most 100 MB")):
        with pytest.raises(MeasurementError) as caught:
            read_measurements(tmp_path / name, DEVICE)
        assert name in str(caught.value) and says in str(caught.value)
    for name in ("x.csv", "x.uff"):
        with pytest.raises(OSError, match=name):
            read_measurements(tmp_path / name, DEVICE)
