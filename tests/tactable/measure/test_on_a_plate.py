"""Laws of a measurement of a plate: the simulated bench is read as the model says, at the points of the walk."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from precompute.measurements.model import MeasurementModel
from precompute.measurements.types import Kind
from tactable.measure.board_sensor import fixed_position_m
from tactable.measure.sensor import SensorError
from tactable.measure.simulated_bench import ConverterFlaws, SimulatedBench
from tactable.measure.walk import even_walk, measurements_of, planned_walk
from tests.precompute.devices import tablet
from tests.tactable.measure.test_walk import walked

# Damped, so that tones are steady soon.
PLATE = replace(tablet(), surface=replace(tablet().surface, mass_damping_per_s=60.0))


@pytest.mark.long
def test_a_walk_over_points_reads_what_the_model_says_and_goes_on_after_an_interruption(tmp_path: Path) -> None:
    walk = tuple(replace(stop, tones=stop.tones[:1]) for stop in even_walk(PLATE, 4, [118.5])[1:3])
    assert [stop.position_m for stop in walk] == pytest.approx([0.294 + 0.0036j, 0.006 + 0.1764j])
    guided: list[complex] = []
    for stops in (walk[:1], walk):
        for _ in range(2):  # the second time everything is kept
            records = walked(tmp_path / str(len(stops)), stops, guide=guided.append, device=PLATE)
    assert guided == [walk[0].position_m, *(stop.position_m for stop in walk)]
    read = measurements_of(records, PLATE, 2e-3, Kind.RESPONSE, is_simulated=True)
    expected = np.exp(MeasurementModel(PLATE, read, ()).predict(np.zeros(0)).log_acceleration)
    assert read.acceleration == pytest.approx(expected, rel=5e-3)
    with pytest.raises(SensorError, match="310 x 10 mm is off the plate of 300 x 180 mm"):
        SimulatedBench(PLATE, ConverterFlaws(), seed=1).place(0.31 + 0.01j)


def test_a_sensor_is_fixed_at_a_point_and_a_plan_names_points() -> None:
    assert fixed_position_m("board:35x60mm", PLATE) == pytest.approx(0.035 + 0.06j)
    for text in ("board:35mm", "board:35x600mm"):
        with pytest.raises(SensorError, match=text):
            fixed_position_m(text, PLATE)
    assert all(isinstance(stop.position_m, complex) for stop in planned_walk(PLATE, 3, 2e-3))
