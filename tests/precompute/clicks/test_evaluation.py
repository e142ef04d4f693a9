"""Laws of the judge: levels rise with the waveform, the nominal plant is not a sample, times are when it happens."""

import numpy as np
import pytest
from numpy.typing import NDArray

from precompute.clicks.basis import EVALUATION_RATE_HZ, lines_for, make_tones
from precompute.clicks.evaluation import decibels, evaluate_waveform
from precompute.clicks.plants import SampledPlants
from precompute.clicks.responses import Responses
from precompute.sampling.plants import sample_scenarios
from tests.precompute.devices import shipped

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def responses() -> Responses:
    scenarios = sample_scenarios(shipped("reference-a"), 40, seed=8)
    plants = SampledPlants(scenarios, lines_for(scenarios.device, (0.02,)))
    return Responses(plants.transfer(scenarios.place((30e-3, 80e-3, 190e-3))), plants.lines)


@pytest.fixture(scope="module")
def waveform() -> Array:
    tones = make_tones(shipped("reference-a"), 0.02)
    return tones.waveform(0.2 * np.random.default_rng(0).normal(size=len(tones.wave)))


def test_levels_are_of_the_weakest_felt_and_the_strongest_quiet_finger(responses: Responses, waveform: Array) -> None:
    evaluation = evaluate_waveform(waveform, responses, [0, 2], [1], 0.05)
    peak_db = 20 * np.log10(abs(responses.play(waveform)).max(axis=2))
    felt_db = peak_db[:, [0, 2]].min(axis=1)
    assert evaluation.quiet is not None
    assert evaluation.felt.nominal_db == pytest.approx(felt_db[0], abs=0.05)
    assert evaluation.quiet.nominal_db == pytest.approx(peak_db[0, 1], abs=0.05)
    expected = np.percentile(felt_db[1:], [5, 50, 95])
    assert (evaluation.felt.low_db, evaluation.felt.middle_db, evaluation.felt.high_db) == pytest.approx(
        tuple(expected), abs=0.05
    )
    assert evaluation.quiet.high_db == pytest.approx(np.percentile(peak_db[1:, 1], 95), abs=0.05)


def test_times_are_those_of_the_nominal_course(responses: Responses, waveform: Array) -> None:
    evaluation = evaluate_waveform(waveform, responses, [1], [], 0.05)
    course = abs(responses.play(waveform)[0, 1])
    assert evaluation.quiet is None and evaluation.exceeds_s is not None
    first, peak = round(evaluation.exceeds_s * EVALUATION_RATE_HZ), round(evaluation.peak_s * EVALUATION_RATE_HZ)
    assert course[first] > 1 and (course[:first] <= 1).all()
    assert course[peak] == course.max()
    assert evaluation.residual_db == pytest.approx(float(decibels(course[round(0.05 * EVALUATION_RATE_HZ) :].max())))


def test_what_stays_below_threshold_never_exceeds_it(responses: Responses, waveform: Array) -> None:
    faint = waveform * (0.99 / float(abs(responses.play(waveform)[0, 0]).max()))
    evaluation = evaluate_waveform(faint, responses, [0], [], 0.05)
    assert evaluation.exceeds_s is None and evaluation.felt.nominal_db == pytest.approx(20 * np.log10(0.99), abs=0.05)
