"""Laws of readings at points of a plate: files keep them, the model predicts them, and a table follows them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from engine.device import Finger
from precompute.measurements.csv import parse_csv
from precompute.measurements.mat import arrays_to_measurements, load_content
from precompute.measurements.measurement_file import read_measurements, write_measurements
from precompute.measurements.model import MeasurementModel, even_places
from precompute.measurements.response_table import MeasuredResponses, estimate_errors, measured_plant
from precompute.measurements.types import Kind, MeasurementError, Measurements
from precompute.model.assembly import assemble
from precompute.model.response import solve_response
from tests.precompute.devices import tablet
from tests.precompute.measured import NAN, read_bar

PLATE = tablet()
DRIVES_HZ = ((70.0, NAN, NAN), (NAN, 82.5, NAN), (150.0, NAN, NAN), (NAN, 230.0, NAN))


def touched(kind: Kind) -> Measurements:
    """Readings at six points, every other one with a finger on the plate."""
    read = read_bar(PLATE, {}, DRIVES_HZ, points=6, kind=kind)
    return replace(read, finger_m=np.where(np.arange(len(read)) % 2 == 0, 0.11 + 0.07j, NAN))


@pytest.mark.parametrize("ending", [".csv", ".uff"])
def test_files_keep_both_coordinates(tmp_path: Path, ending: str) -> None:
    written, path = touched(Kind.RESPONSE), tmp_path / f"plate{ending}"
    if ending == ".uff":
        written = replace(written, finger_m=np.full(len(written), NAN))
    write_measurements(path, written, PLATE, "by hand")
    read = read_measurements(path, PLATE, 2e-3)
    columns = "position_m", "finger_m", "frequency_hz", "acceleration"
    before, after = (m.part(np.lexsort((m.acceleration.real, np.round(m.position_m, 6)))) for m in (written, read))
    for column in columns:
        np.testing.assert_allclose(getattr(after, column), getattr(before, column), rtol=1e-5)


def test_headings_of_other_programs_name_points(tmp_path: Path) -> None:
    text = "frequency (Hz),a 35 x 60 mm real (m/s^2),a 35 x 60 mm imag (m/s^2)\n90,1,2\n120,3,4\n"
    value, places_mm = np.array([[1 + 2j, 3 + 4j], [5, 6j]]), [[35.0, 60.0], [200.0, 20.0]]
    path = tmp_path / "plate.mat"
    scipy.io.savemat(path, {"frequency_Hz": [90.0, 120.0], "position_mm": places_mm, "a_acceleration_m_s2": value.T})
    of_csv = parse_csv(text, PLATE, 0.0, "x.csv")
    of_mat = arrays_to_measurements(load_content(path), path, PLATE, 0.0)
    assert set(of_csv.position_m) == {0.035 + 0.06j}
    assert of_mat.position_m == pytest.approx(np.repeat([0.035 + 0.06j, 0.2 + 0.02j], 2))
    assert of_mat.acceleration == pytest.approx(value.ravel())


@pytest.mark.parametrize(
    ("header", "cells", "message"),
    [
        ("position (mm)", "10", r"two columns, position \(mm\) and position across \(mm\)"),
        ("position (mm),position across (mm)", "10,181", r"10 x 181 mm: expected 0 to 300 x 180 mm, the plate's sides"),
        ("position (mm),position across (mm),finger position (mm),finger position across (mm)", "1,1,2,", "give both"),
    ],
)
def test_places_that_are_no_points_of_the_plate_are_refused(header: str, cells: str, message: str) -> None:
    text = f"{header},frequency a (Hz),peak acceleration (m/s^2)\n{cells},90,1\n"
    with pytest.raises(MeasurementError, match=message):
        parse_csv(text, PLATE, 0.0, "x.csv")


def test_readings_are_those_of_the_plate_with_sensor_and_finger_assembled() -> None:
    read = touched(Kind.RESPONSE)
    sensor, found = Finger(2e-3, 0.0, 0.0, 1.0), MeasurementModel(PLATE, read, ()).predict(np.zeros(0))
    for row in range(0, len(read), 5):
        at_m, finger_m = read.position_m[row].item(), read.finger_m[row].item()
        fingers: list[tuple[complex, Any]] = [(at_m, sensor)]
        fingers += [] if np.isnan(finger_m) else [(finger_m, PLATE.finger)]
        which = int(np.abs(read.amplitude[row]).argmax())
        plant = assemble(PLATE).with_fingers(*zip(*fingers, strict=True))
        unit = solve_response(plant, read.frequency_hz[row, [which]]).acceleration(np.array([at_m]))
        assert np.exp(found.log_acceleration[row]) == pytest.approx(unit[0, which, 0], rel=1e-5)


def test_between_measured_points_the_plate_moves_as_it_does() -> None:
    hz, place_m = np.linspace(60.0, 300.0, 25), even_places(PLATE, 70)
    measured = solve_response(assemble(PLATE), hz).acceleration(place_m)
    responses = MeasuredResponses(hz, place_m, measured, "plate.csv", "5ha", True)
    plant = measured_plant(PLATE, responses)
    at_m = 0.02 + 0.26 * np.random.default_rng(1).random(40) + 1j * (0.02 + 0.14 * np.random.default_rng(2).random(40))
    found, true = (solve_response(each, hz).acceleration(at_m) for each in (plant, assemble(PLATE)))
    error = abs(found - true).max() / abs(true).max()
    assert error < 0.02
    estimated = estimate_errors(PLATE, responses)
    assert (estimated.between_places > error).all() and (estimated.model < 1e-9).all()
    with pytest.raises(ValueError, match="measured responses"):
        plant.with_fingers([0.1 + 0.1j], PLATE.finger)
