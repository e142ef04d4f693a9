"""Laws of standard fingers under a click: what the nominal one of the sampled plants and the plant in time give."""

import numpy as np
import pytest
import scipy.signal

from engine.device import Device
from engine.table.click import played_at
from precompute.clicks.basis import SAMPLE_RATE_HZ
from precompute.clicks.nominal import NominalFingers
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.threshold_filter import threshold_filter
from precompute.model.transient import TransientPlant
from tests.precompute.clicks.click_cases import CHEAP, placed, solver_of

PER_SAMPLE = 12
"""Steps of the plant in time for each sample of a waveform."""
cases = pytest.mark.parametrize(
    ("name", "letters"), [("reference-a", "F--q-"), ("reference-a", "F----"), ("reference-t", "FqFqF")]
)


@cases
def test_they_are_the_nominal_fingers_of_the_evaluation(name: str, letters: str) -> None:
    solver = solver_of(name)
    click = solver.solve_entry(placed(solver.device, letters))
    found = NominalFingers(solver.device, CHEAP).under(click, click.placement.position_m)
    for one, other in zip(found, click.fingers, strict=True):
        assert one.level_db == pytest.approx(other.level_db, abs=0.02)
        assert one.acceleration_at_finger_m_per_s2 == pytest.approx(other.acceleration_at_finger_m_per_s2, rel=5e-3)


@cases
def test_they_feel_what_the_plant_in_time_gives(name: str, letters: str) -> None:
    solver = solver_of(name)
    click = solver.solve_entry(placed(solver.device, letters))
    # Fingers elsewhere too, where no click was made for them.
    for position_m in (click.placement.position_m, tuple(at_m - 4e-3 for at_m in click.placement.position_m)):
        found = NominalFingers(solver.device, CHEAP).under(click, position_m)
        expected_db = levels_in_time(solver.device, click.samples / 32767, position_m)
        assert [finger.level_db for finger in found] == pytest.approx(expected_db, abs=0.1)


def levels_in_time(device: Device, waveform: np.ndarray, position_m: tuple[float, ...]) -> list[float]:
    """Peaks in dB above threshold under fingers of the plant in time; waveform (time, actuator)."""
    rate_hz = PER_SAMPLE * SAMPLE_RATE_HZ
    plant = TransientPlant(compute_basis(assemble(device), 60), np.array(position_m), rate_hz)
    plant.touch([(at_m, device.finger) for at_m in position_m])
    at = np.arange((len(waveform) - 1) * PER_SAMPLE + 1) / PER_SAMPLE
    moved = np.stack([np.interp(at, np.arange(len(waveform)), row) for row in waveform.T], axis=1)
    course = plant.accelerate(np.pad(moved, ((0, round(0.08 * rate_hz)), (0, 0))))
    weighted = scipy.signal.fftconvolve(course, threshold_filter(device.threshold, rate_hz)[:, None], axes=0)
    levels_db: list[float] = (20 * np.log10(abs(weighted[: len(course)]).max(axis=0))).tolist()
    return levels_db


def test_a_weaker_click_gives_them_as_much_less() -> None:
    solver = solver_of("reference-a")
    click = solver.solve_entry(placed(solver.device, "F--q-"))
    nominal = NominalFingers(solver.device, CHEAP)
    whole, softer = (
        nominal.under(each, click.placement.position_m) for each in (click, played_at(click, click.level_db - 5.0))
    )
    assert [one.level_db - other.level_db for one, other in zip(whole, softer, strict=True)] == pytest.approx([5.0] * 2)
