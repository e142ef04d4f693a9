"""Tests that CSV and universal files of responses and peaks are read as they were written."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from precompute.measurements.measurement_file import read_measurements, write_measurements
from precompute.measurements.types import Kind, MeasurementError, Measurements
from tests.precompute.devices import shipped
from tests.precompute.measured import NAN, read_bar

DEVICE = shipped("reference-a")


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
