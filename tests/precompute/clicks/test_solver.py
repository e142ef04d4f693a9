"""Laws of clicks: within their own limits, below their bound, beaten by no other search, mirrored with the bar."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.device import Device
from precompute.clicks.basis import EVALUATION_RATE_HZ, EVALUATIONS_PER_SAMPLE, RINGDOWN_S, SAMPLE_RATE_HZ
from precompute.clicks.design import Designer
from precompute.clicks.options import ClickOptions
from precompute.clicks.solver import FULL_SCALE, Click, ClickSolver
from tests.precompute.clicks.click_cases import CHEAP, placed
from tests.precompute.devices import mirrored, shipped

Array = NDArray[np.float64]
CASES = ["F--q-", "q--F-", "FqFq-", "qF-Fq", "F----", "qqFqq"]
any_case = pytest.mark.parametrize("letters", CASES)


@cache
def solver_of(device: Device, options: ClickOptions = CHEAP) -> ClickSolver:
    return ClickSolver(device, options)


@cache
def click_of(letters: str, options: ClickOptions = CHEAP, device: str = "reference-a") -> Click:
    return solver_of(shipped(device), options).solve(placed(shipped(device), letters))


def courses(click: Click, kind: str, options: ClickOptions = CHEAP, part: str = "optimised") -> Array:
    """Shape (scenario, finger, time) of the felt or the quiet ones, in the plants of the program or of `part`."""
    plants = solver_of(shipped("reference-a"), options).plants_of(click.placement.position_m)
    found: Array = getattr(plants, part).play(click.waveform)[:, getattr(click.placement, kind)]
    return found


def percentile_db(course: Array, strongest: bool, percent: float) -> float:
    peak = abs(course[1:]).max(axis=2)
    level = peak.max(axis=1) if strongest else peak.min(axis=1)
    return float(20 * np.log10(np.percentile(level, percent)))


@any_case
def test_displacements_are_within_full_scale_on_the_grid_of_the_wire(letters: str) -> None:
    waveform = click_of(letters).waveform
    assert abs(waveform).max() <= 1
    assert waveform * FULL_SCALE == pytest.approx(np.round(waveform * FULL_SCALE), abs=1e-9)
    assert not waveform[:, [0, -1]].any() and waveform.shape[1] == round(0.02 * SAMPLE_RATE_HZ) + 1


@any_case
def test_quiet_fingers_keep_to_their_level_at_all_times(letters: str) -> None:
    """In 95 % of the plants that it was trimmed on; also long after the time that was looked at."""
    click = click_of(letters)
    if click.placement.quiet:
        course = courses(click, "quiet", part="trimmed")
        assert percentile_db(course, True, 95) <= CHEAP.quiet_db + 0.01
        assert course.shape[2] == round((0.02 + RINGDOWN_S) * EVALUATION_RATE_HZ)


@any_case
def test_no_click_exceeds_its_bound(letters: str) -> None:
    click = click_of(letters)
    course = courses(click, "felt").mean(axis=0)
    assert 20 * np.log10(abs(course).max(axis=1).min()) <= click.bound_db + 1e-3
    assert -1e-3 <= click.gap_db < 1.5


@any_case
def test_the_program_violates_none_of_its_own_limits(letters: str) -> None:
    device = shipped("reference-a")
    placement, solver = placed(device, letters), solver_of(device)
    designer = Designer(device, CHEAP, solver.plants_of(placement.position_m), placement, 0.02)
    waveform = designer.waveform(designer.search.strongest(0.8).optimum.weight)  # a design is scaled after it
    assert abs(waveform).max() <= 1 + 1e-6
    course = abs(solver.plants_of(placement.position_m).optimised.play(waveform)[:, designer.quiet])
    assert course[..., ::EVALUATIONS_PER_SAMPLE].max(initial=0.0) <= 0.8 + 1e-6
    assert course.max(initial=0.0) <= 0.8 * 10 ** (0.3 / 20)  # between the samples of the waveform


@pytest.mark.parametrize("letters", ["F--q-", "Fq-F-"])
def test_a_mirrored_bar_gets_mirrored_clicks(letters: str) -> None:
    """The same waveforms, up to the sign that nobody feels and to what the program leaves open."""
    here = click_of(letters)
    turned = mirrored(shipped("reference-a"))
    there = solver_of(turned).solve(placed(turned, letters[::-1]))
    assert there.bound_db == pytest.approx(here.bound_db, abs=2e-2)
    assert there.evaluation.felt.nominal_db == pytest.approx(here.evaluation.felt.nominal_db, abs=0.1)
    sign = np.sign((there.waveform * here.waveform).sum())
    assert abs(sign * there.waveform - here.waveform).max() <= 0.1


def test_fewer_wishes_are_never_weaker() -> None:
    """More quiet, less of it, or a brake cost something; nothing gains."""
    base = click_of("F--q-").bound_db
    assert click_of("F----").bound_db >= base - 0.05
    assert click_of("F--q-", replace(CHEAP, quiet_db=6.0)).bound_db >= base + 0.5
    assert click_of("F--q-", replace(CHEAP, slew_per_s=300.0)).bound_db <= base + 0.1


def test_a_slew_that_is_asked_for_is_kept() -> None:
    click = click_of("F--q-", replace(CHEAP, slew_per_s=300.0))
    steps = abs(np.diff(click.waveform, axis=1)).max()
    assert steps <= 300.0 / SAMPLE_RATE_HZ + 2 / FULL_SCALE


def test_a_brake_leaves_no_residual() -> None:
    options, late = replace(CHEAP, brake_s=0.023), round(0.023 * EVALUATION_RATE_HZ)
    braked = click_of("F--q-", options)
    left, without = (abs(courses(click, "felt", CHEAP)[..., late:]).max() for click in (braked, click_of("F--q-")))
    assert left <= 1.5 < without
    assert left == pytest.approx(abs(courses(braked, "felt", options)[..., late:]).max())
    assert braked.evaluation.residual_from_s == 0.023


def test_a_wanted_level_is_reached_and_not_exceeded() -> None:
    options = replace(CHEAP, wanted_db=8.0)
    click = click_of("F--q-", options)
    assert click.achieved
    assert percentile_db(courses(click, "felt", options, "trimmed"), False, 5) == pytest.approx(8.0, abs=0.01)


def test_the_shortest_length_that_reaches_the_level_is_taken() -> None:
    reach_db = percentile_db(courses(click_of("F--q-"), "felt", part="trimmed"), False, 5)
    options = replace(CHEAP, lengths_s=(0.01, 0.02, 0.03), wanted_db=reach_db - 0.5)
    assert click_of("F--q-", options).length_s == 0.02


def test_what_is_out_of_reach_violates_the_quiet_level_by_the_least_and_says_so() -> None:
    options = replace(CHEAP, wanted_db=20.0)
    click = click_of("F--q-", options)
    assert not click.achieved and click.evaluation.quiet is not None
    assert percentile_db(courses(click, "felt", options, "trimmed"), False, 5) == pytest.approx(20.0, abs=0.1)
    assert click.evaluation.quiet.high_db > CHEAP.quiet_db + 1


def test_what_full_scale_does_not_reach_keeps_to_the_quiet_level() -> None:
    click = click_of("F--q-", replace(CHEAP, wanted_db=60.0))
    assert not click.achieved
    assert (click.waveform == click_of("F--q-").waveform).all()
