"""Laws of the baselines: within the same limits, judged alike, and weaker than the click that was solved."""

import numpy as np
import pytest
import scipy.linalg

from engine.device import Device
from engine.steady import SteadyDrive
from engine.touch import Placement
from precompute.clicks.baselines import BASELINES, energy_contrast, solve_baseline
from precompute.clicks.click_basis import EVALUATION_RATE_HZ, Tones, make_tones
from precompute.clicks.click_solver import ClickSolver
from precompute.predict.at_positions import SteadyDesigner
from tests.precompute.clicks.click_cases import CHEAP, placed
from tests.precompute.devices import coarsely_swept, shipped
from tests.quick import first_quick

any_baseline = pytest.mark.parametrize("name", BASELINES)


@pytest.fixture(scope="module")
def solver() -> ClickSolver:
    return ClickSolver(coarsely_swept(shipped("reference-a")), CHEAP)


def tones_with(solver: ClickSolver) -> Tones:
    return make_tones(solver.device, CHEAP.length_s, CHEAP.crowding)


def drives_of(device: Device, placement: Placement) -> list[SteadyDrive]:
    solver = SteadyDesigner(device).solver
    return [solver.solve(placement.position_m, placement.is_felt, level_db) for level_db in (*device.levels_db, np.inf)]


@any_baseline
@pytest.mark.parametrize("letters", first_quick(["F--q-", "-q--F"]))
def test_a_baseline_keeps_to_the_limits_and_loses_to_the_click(solver: ClickSolver, name: str, letters: str) -> None:
    placement = placed(solver.device, letters)
    drives = drives_of(solver.device, placement)
    click, own = solve_baseline(solver, placement, drives, name), solver.solve(placement)
    assert click.weights is None is not own.weights
    assert abs(click.waveform).max() <= 1 and not click.waveform[:, [0, -1]].any()
    assert click.evaluation.quiet is not None and own.evaluation.quiet is not None
    pool = solver.plants_of(placement.position_m).pool.peaks(click.waveform, placement.quiet)[1:].max(axis=1)
    assert np.percentile(20 * np.log10(pool), 95) <= CHEAP.quiet_db + 0.01
    assert click.evaluation.felt.low_db < own.evaluation.felt.low_db


def test_without_a_quiet_finger_contrast_is_against_the_drive(solver: ClickSolver) -> None:
    """The most energy under the finger for that of the displacement: a singular vector of what the tones do."""
    placement = placed(solver.device, "F----")
    waveform, tones = energy_contrast(solver, placement), tones_with(solver)
    optimised, steps = solver.plants_of(placement.position_m).pool.first(41), round(CHEAP.length_s * EVALUATION_RATE_HZ)
    rows = optimised.play_each(tones)[:, 0, :steps].reshape(-1, len(tones.wave))
    of_drive = (tones.wave @ tones.wave.T) * (tones.actuator[:, None] == tones.actuator)
    best = scipy.linalg.eigvalsh(rows.T @ rows, of_drive)
    energy = (optimised.play(waveform)[:, 0, :steps] ** 2).sum()
    assert energy / (waveform**2).sum() == pytest.approx(best[-1], rel=1e-3)
