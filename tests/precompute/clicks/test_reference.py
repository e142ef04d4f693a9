"""HiGHS finds the optima of the click solver, and plants by state space move as plants by modes do."""

import numpy as np
import pytest
from numpy.typing import NDArray

from precompute.clicks import ClickSolver
from precompute.clicks.basis import EVALUATIONS_PER_SAMPLE, make_tones, orthogonalised
from precompute.clicks.design import drive_rows
from precompute.clicks.program import TOLERANCE
from tests.precompute.clicks.click_cases import CHEAP, placed
from tests.precompute.clicks.dense_rows import program_of
from tests.precompute.clicks.reference_clicks import HighsProgram, ReferenceSolver
from tests.precompute.devices import shipped

Array = NDArray[np.float64]


@pytest.mark.parametrize("letters", ["F--q-", "qF-Fq", "q--qF"])
def test_highs_finds_the_same_optimum_of_a_click_s_program(letters: str) -> None:
    """Values within the tolerance of both, and each below the bound that the other proves."""
    device = shipped("reference-a")
    placement, solver = placed(device, letters), ClickSolver(device, CHEAP)
    tones = orthogonalised(make_tones(device, 0.02))
    played = solver.plants_of(placement.position_m).optimised.play_each(tones)[:, :, ::EVALUATIONS_PER_SAMPLE]
    watched = played[:, placement.quiet].reshape(-1, *played.shape[2:])
    drive, course = drive_rows(tones, device.limits.amplitude, None), played[:, placement.felt].mean(axis=0)
    ours, highs = (make(drive, watched, len(placement.felt)) for make in (program_of, HighsProgram))
    for instant, limit in ((60, 1.0), (75, 1.0), (60, 0.7)):
        aims = course[:, instant]
        ours.set_limit(limit)
        highs.set_limit(limit)
        own, judged = ours.maximise(aims), highs.maximise(aims)
        assert own.value == pytest.approx(judged.value, rel=2 * TOLERANCE)
        assert own.value <= judged.bound.at(limit) * (1 + 2e-5)
        assert judged.value <= own.bound.at(limit) * (1 + 2e-5)


@pytest.mark.parametrize("name", ["reference-a", "reference-t"])
def test_both_kinds_of_plants_agree(name: str) -> None:
    """Peaks of the state-space plants with 16 modes and of those by modes, to 0.3 dB in each plant and 0.1 at most."""
    device = shipped(name)
    placement = placed(device, "F--q-")
    fast, reference = ClickSolver(device, CHEAP), ReferenceSolver(device, CHEAP)
    tones = make_tones(device, 0.02)
    waveform = tones.waveform(np.random.default_rng(1).normal(size=len(tones.wave)))
    plants = fast.plants_of(placement.position_m)
    for ours, theirs in zip(
        (plants.optimised, plants.trimmed, plants.evaluated), reference.plants_of(placement.position_m), strict=True
    ):
        difference_db = 20 * np.log10(ours.peaks(waveform, (0, 1)) / theirs.peaks(waveform, (0, 1)))
        assert abs(difference_db).max() <= 0.3
        assert np.median(abs(difference_db)) <= 0.1
