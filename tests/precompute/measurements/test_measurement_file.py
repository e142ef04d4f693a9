"""A file of measurements is read by its ending; what has none that is known, or is not there, is refused."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from base.files import WriteError
from precompute.measurements.csv import write_csv
from precompute.measurements.measurement_file import MOST_BYTES, read_measurements, write_measurements
from precompute.measurements.types import Kind, MeasurementError, Measurements
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


def responses(kind: Kind = Kind.RESPONSE) -> Measurements:
    """Both actuators alone at three uneven frequencies and two places, at a fifth of full scale."""
    drives_hz = [drive for hz in (70.0, 81.3, 230.5) for drive in ((hz, NAN), (NAN, hz))]
    read = read_bar(DEVICE, {}, drives_hz, points=2, kind=kind)
    return replace(read, amplitude=0.2 * read.amplitude, is_simulated=False)


def sorted_rows(measurements: Measurements) -> Measurements:
    keys = np.nan_to_num(measurements.frequency_hz)
    return measurements.part(np.lexsort((keys[:, 0], keys[:, 1], measurements.position_m)))


def test_a_universal_file_holds_the_responses_at_full_scale(tmp_path: Path) -> None:
    path, written = tmp_path / "bar.uff", responses()
    write_measurements(path, written, DEVICE, "by hand")
    read = sorted_rows(read_measurements(path, DEVICE, 2e-3))
    wanted = sorted_rows(written)
    np.testing.assert_allclose(read.frequency_hz, wanted.frequency_hz)
    np.testing.assert_allclose(read.position_m, wanted.position_m, rtol=1e-4)
    np.testing.assert_allclose(read.acceleration, 5 * wanted.acceleration, rtol=1e-6)


@pytest.mark.parametrize(
    ("spoilt", "text"),
    [
        (responses(Kind.PEAK), "complex responses of one actuator"),
        (replace(responses(), finger_m=np.full(12, 0.1)), "no finger on the bar"),
        (responses().part(np.array([0, 1])), "a response of one frequency"),
    ],
)
def test_a_universal_file_refuses_what_it_cannot_hold(tmp_path: Path, spoilt: Measurements, text: str) -> None:
    with pytest.raises(MeasurementError, match=text):
        write_measurements(tmp_path / "bar.uff", spoilt, DEVICE, "by hand")
    assert not list(tmp_path.iterdir())
