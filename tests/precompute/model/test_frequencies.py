"""Frequency grids: no peak between their steps is missed, and each is one that the wire carries."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from precompute.model.assembly import assemble
from precompute.model.frequencies import fine_frequencies, in_band, on_the_wire
from precompute.model.response import solve_response
from tests.precompute.devices import every_device, shipped


@pytest.mark.parametrize("name", every_device())
def test_no_peak_between_them_is_missed_by_more_than_a_tenth_of_a_decibel(name: str) -> None:
    device = every_device()[name]
    plant, place_m = assemble(device), np.linspace(0.0, device.bar.length_m, 15)
    fine_hz = fine_frequencies(plant)
    dense_hz = np.arange(device.sweep.start_hz, device.sweep.stop_hz, 0.02)
    found, true = (abs(solve_response(plant, hz).acceleration(place_m)).max(axis=0) for hz in (fine_hz, dense_hz))
    assert (20 * np.log10(true / found) < 0.1).all()


def test_they_rise_on_the_steps_of_the_wire_within_the_sweep() -> None:
    plant = assemble(shipped("reference-a"))
    hz = fine_frequencies(plant)
    assert (np.diff(hz) > 0).all()
    assert np.round(hz, 2) == pytest.approx(hz, abs=1e-12)
    assert (hz[0], hz[-1]) == (60.0, 300.0)
    assert set(plant.device.sweep.frequency_hz) <= set(hz.tolist())


def test_an_actuator_plays_its_band_and_its_edges_are_looked_at() -> None:
    device = shipped("reference-a")
    left, right = device.actuators
    plant = assemble(replace(device, actuators=(replace(left, band_hz=(100.37, 200.0)), right)))
    hz = fine_frequencies(plant)
    usable = in_band(plant.device, hz)
    assert 100.37 in hz.tolist()
    assert (usable[:, 0] == ((hz >= 100.37) & (hz <= 200.0))).all()
    assert usable[:, 1].all()


@given(st.floats(20, 1000))
def test_the_wire_is_half_a_step_away_at_most(frequency_hz: float) -> None:
    wire_step_hz, found = 0.01, on_the_wire(np.array([frequency_hz]))
    assert abs(found[0] - frequency_hz) <= wire_step_hz / 2 + 1e-9
    assert found[0] / wire_step_hz == pytest.approx(round(found[0] / wire_step_hz), abs=1e-6)
    assert on_the_wire(found) == found
