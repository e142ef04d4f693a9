"""The bench of the click solver: the reference is the same problem, and the figures are those of its rows."""

import io

import numpy as np
import pytest
from numpy.typing import NDArray
from rich.console import Console

from precompute.clicks import ClickSolver
from precompute.clicks.basis import EVALUATIONS_PER_SAMPLE, make_tones, orthogonalised
from precompute.clicks.design import drive_rows
from precompute.clicks.program import TOLERANCE
from tactable.bench.click_solver import print_solver_bench, run_solver_bench
from tactable.bench.reference_clicks import HighsProgram, ReferenceSolver
from tests.precompute.clicks.click_cases import CHEAP, placed
from tests.precompute.clicks.dense_rows import program_of
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


def test_figures_are_those_of_the_rows() -> None:
    told = list[float]()
    result = run_solver_bench([shipped("reference-d")], CHEAP, 4, 5, lambda _, done: told.append(done))
    (device,) = result["devices"]
    rows, summary = device["states"], device["summary"]
    assert told == pytest.approx([0.225, 0.45, 0.675, 0.9])
    assert [len(row["is_felt"]) for row in rows] == [1, 3, 4, 5]
    for row in rows:
        assert row["fast"]["felt_db"] == pytest.approx(row["reference"]["felt_db"], abs=1.0)
        assert (row["fast"]["quiet_db"] is None) == all(row["is_felt"])
    differences = [row["fast"]["felt_db"] - row["reference"]["felt_db"] for row in rows]
    assert summary["felt_difference_db"]["least"] == pytest.approx(min(differences))
    assert summary["programs"] == sum(row["programs"] for row in rows) > 4
    assert summary["pivots"] > summary["programs"] and summary["fallbacks"] == 0
    reference_s, fast_s = (sum(row[way]["programs_s"] for row in rows) for way in ("reference", "fast"))
    assert summary["programs_ratio"] == pytest.approx(reference_s / fast_s)
    for solved in ("as a table", "in a run"):
        two, five = device["two_fingers"][solved], device["five_fingers"][solved]
        assert (two["clicks"], five["clicks"]) == (5, 1) and two["median_ms"] <= two["p99_ms"] <= two["most_ms"]
    page = Console(file=io.StringIO(), width=200)
    print_solver_bench(page, result)
    assert isinstance(page.file, io.StringIO)
    assert "SIMULATED" in page.file.getvalue() and f"{summary['programs_ratio']:.1f}" in page.file.getvalue()
