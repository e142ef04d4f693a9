"""Laws of the judge: its click is below its bound, and within its own limits."""

from functools import cache

import numpy as np
import pytest

from engine.device import Device
from engine.touch import Placement
from precompute.clicks.click_basis import EVALUATIONS_PER_SAMPLE, lines_for
from precompute.clicks.click_options import ClickOptions
from precompute.clicks.click_plants import SampledPlants
from precompute.clicks.click_responses import Responses
from precompute.sampling.plants import sample_scenarios
from tests.precompute.clicks.click_cases import placed
from tests.precompute.clicks.judge.design import Designer
from tests.precompute.devices import shipped

OPTIONS = ClickOptions(length_s=0.02, crowding=1.0)
OPTIMISED, TRIMMED = 6, 20
any_case = pytest.mark.parametrize("letters", ["F--q-", "FqFq-", "F----", "qqFqq"])


@cache
def plants_of(device: Device, count: int) -> SampledPlants:
    return SampledPlants(sample_scenarios(device, count, seed=count), lines_for(device, OPTIONS.length_s))


def responses(device: Device, placement: Placement, count: int) -> Responses:
    plants = plants_of(device, count)
    return Responses(plants.transfer(plants.scenarios.place(placement.position_m)), plants.lines)


def designer_of(device: Device, letters: str) -> tuple[Designer, Responses, Responses]:
    placement = placed(device, letters)
    optimised, trimmed = (responses(device, placement, count) for count in (OPTIMISED, TRIMMED))
    return Designer(device, OPTIONS, optimised, trimmed, placement), optimised, trimmed


@any_case
def test_no_click_exceeds_its_bound_and_95_percent_of_the_trimmed_plants_stay_quiet(letters: str) -> None:
    device = shipped("reference-a")
    designer, optimised, trimmed = designer_of(device, letters)
    design = designer.design()
    course = optimised.under(designer.felt).mean().play(design.waveform)[0]
    felt_db = 20 * np.log10(abs(course).max(axis=1).min())
    # The bound is over the instants that were tried; a peak lies up to a sample beside them.
    assert design.bound_db - design.gap_db - 1e-3 <= felt_db <= design.bound_db + 0.02
    assert -1e-3 <= design.gap_db < 1.5
    assert abs(design.waveform).max() <= device.limits.amplitude + 1e-6
    if designer.quiet:
        peak = trimmed.peaks(design.waveform, designer.quiet)[1:].max(axis=1)
        assert 20 * np.log10(np.percentile(peak, 95)) <= OPTIONS.quiet_db + 0.01


@any_case
def test_the_program_violates_none_of_its_own_limits(letters: str) -> None:
    designer, optimised, _ = designer_of(shipped("reference-a"), letters)
    waveform = designer.waveform(designer.search.strongest(0.8).optimum.weight)  # a design is scaled after it
    assert abs(waveform).max() <= 1 + 1e-6
    course = abs(optimised.play(waveform)[:, designer.quiet])
    assert course[..., ::EVALUATIONS_PER_SAMPLE].max(initial=0.0) <= 0.8 + 1e-6
    assert course.max(initial=0.0) <= 0.8 * 10 ** (0.3 / 20)  # between the samples of the waveform
