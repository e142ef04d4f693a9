"""Laws of a measurement of a plate: the simulated bench is read as the model says, at the points of the walk."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from precompute.measurements.model import MeasurementModel
from precompute.measurements.types import Kind
from tactable.measure.apparatus import Apparatus
from tactable.measure.board_sensor import fixed_position_m
from tactable.measure.driven_device import DrivenDevice
from tactable.measure.sensor import SensorError
from tactable.measure.simulated_bench import ConverterFlaws, SimulatedBench, SimulatedSensor
from tactable.measure.stepped_sine import SteppedSineOptions
from tactable.measure.walk import Method, RawFolder, even_walk, measure_walk, measurements_of, planned_walk
from tests.precompute.devices import tablet

# Damped, so that tones are steady soon.
PLATE = replace(tablet(), surface=replace(tablet().surface, mass_damping_per_s=60.0))


@pytest.mark.long
def test_a_walk_over_points_reads_what_the_model_says_and_goes_on_after_an_interruption(tmp_path: Path) -> None:
    walk = tuple(replace(stop, tones=stop.tones[:1]) for stop in even_walk(PLATE, 4, [118.5])[1:3])
    assert [stop.position_m for stop in walk] == pytest.approx([0.294 + 0.0036j, 0.006 + 0.1764j])
    bench = SimulatedBench(PLATE, ConverterFlaws(), seed=1)
    guided: list[complex] = []

    def go_to(position_m: complex) -> None:
        guided.append(position_m)
        bench.place(position_m)

    def open_driven() -> DrivenDevice:
        return DrivenDevice(PLATE, bench, bench, (1.0, 1.0, 1.0))

    apparatus = Apparatus(SimulatedSensor(bench), open_driven, go_to, bench.turn_over)
    for stops in (walk[:1], walk):
        raw = RawFolder(tmp_path / str(len(stops)), PLATE, stops, {})
        for _ in range(2):  # the second time everything is kept
            records = measure_walk(PLATE, stops, apparatus, Method(SteppedSineOptions()), raw)
    assert guided == [walk[0].position_m, *(stop.position_m for stop in walk)]
    read = measurements_of(records, PLATE, 2e-3, Kind.RESPONSE, is_simulated=True)
    expected = np.exp(MeasurementModel(PLATE, read, ()).predict(np.zeros(0)).log_acceleration)
    assert read.acceleration == pytest.approx(expected, rel=5e-3)
    with pytest.raises(SensorError, match="310 x 10 mm is off the plate of 300 x 180 mm"):
        bench.place(0.31 + 0.01j)


def test_a_sensor_is_fixed_at_a_point_and_a_plan_names_points() -> None:
    assert fixed_position_m("board:35x60mm", PLATE) == pytest.approx(0.035 + 0.06j)
    for text in ("board:35mm", "board:35x600mm"):
        with pytest.raises(SensorError, match=text):
            fixed_position_m(text, PLATE)
    assert all(isinstance(stop.position_m, complex) for stop in planned_walk(PLATE, 3, 2e-3))
