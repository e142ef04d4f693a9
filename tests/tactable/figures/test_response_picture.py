"""Responses along the bar: what is drawn is the model's acceleration, and readings lie where they were read."""

from dataclasses import replace

import numpy as np
import pytest

from precompute.measurements.simulate import Flaws, even_places, simulate_measurements
from precompute.measurements.types import Measurements, lay_out
from precompute.model.assembly import assemble
from precompute.model.response import solve_response
from tactable.figures.response_picture import plot_response, reading_at
from tactable.figures.style import surface_field
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
NAN = np.nan


def drives(*hz: tuple[float, float]) -> Measurements:
    return lay_out(np.array(hz), np.zeros(1), 0.0)


def readings(*hz: tuple[float, float]) -> Measurements:
    return simulate_measurements(DEVICE, lay_out(np.array(hz), even_places(DEVICE), 2e-3), Flaws(), seed=0)


def test_noiseless_readings_lie_on_the_curve_that_has_the_sensor_at_each_place() -> None:
    read = readings((150.0, 130.0), (NAN, 200.0))
    picture = plot_response(DEVICE, read, has_readings=True)
    assert np.asarray(picture.columns["computed (m/s^2)"]) == pytest.approx(abs(read.acceleration), rel=1e-6)
    place_m, first = surface_field(DEVICE).position_m.real, slice(0, 22)
    level = reading_at(DEVICE, read, 0, place_m)
    assert np.interp(read.position_m[first].real, place_m, level) == pytest.approx(
        abs(read.acceleration[first]), rel=0.01
    )
    bare = reading_at(DEVICE, drives((150.0, 130.0)), 0, place_m)
    assert abs(level / bare - 1).max() > 0.1, "2 g are felt on this bar"


def test_what_is_simulated_says_so_and_what_is_measured_does_not() -> None:
    read = readings((150.0, 130.0))
    for is_simulated, what in ((True, "SIMULATED"), (False, "measured.")):
        picture = plot_response(DEVICE, replace(read, is_simulated=is_simulated), has_readings=True)
        assert ("SIMULATED" in picture.caption) is is_simulated
        assert picture.figure.get_supxlabel().startswith(f"Curves computed, points {what}")
        labels = {line.get_label() for axes in picture.figure.axes for line in axes.lines}
        assert labels >= {"computed, with the sensor at each place"} and ("measured" in labels) is not is_simulated


def test_readings_of_a_plate_lie_on_the_map_that_has_the_sensor_at_each_place() -> None:
    plate, hz = shipped("reference-c"), np.array([(150.0, 130.0, NAN)])
    read = simulate_measurements(plate, lay_out(hz, surface_field(plate, 12).position_m, 2e-3), Flaws(), seed=0)
    picture = plot_response(plate, read, has_readings=True)
    assert np.asarray(picture.columns["computed (m/s^2)"]) == pytest.approx(abs(read.acceleration), rel=1e-6)
    assert np.asarray(picture.columns["position, across (m)"]) == pytest.approx(read.position_m.imag)
    bare = plot_response(plate, lay_out(hz, np.zeros(1), 0.0), has_readings=False)
    (drive,) = bare.summary["drives"]
    at_m = np.array([complex(*drive["greatest_position_m"])])
    field = solve_response(assemble(plate), np.array([130.0, 150.0])).acceleration(at_m)[..., 0]
    assert drive["greatest_m_per_s2"] == pytest.approx(abs(field[1, 0]) + abs(field[0, 1]), rel=1e-3)
    assert "nodes_m" not in drive
