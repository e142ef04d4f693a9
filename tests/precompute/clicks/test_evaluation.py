"""Laws of the judge: levels rise with the waveform, times are when it happens; of the nominal plant in time."""

from collections.abc import Sequence

import numpy as np
import pytest

from base.arrays import Array
from engine.table.clicks import ClickFigures, played_at
from engine.touch import Placement
from precompute.clicks.click_basis import EVALUATION_RATE_HZ, lines_for, make_tones
from precompute.clicks.click_plants import SampledPlants, weighting
from precompute.clicks.click_responses import Responses
from precompute.clicks.evaluation import ManyPlants, NominalFingers, decibels, evaluate_waveform
from precompute.sampling.plants import sample_scenarios
from tests.precompute.clicks.click_cases import placed, solver_of
from tests.precompute.devices import shipped

POSITION_M = (30e-3, 80e-3, 190e-3)


@pytest.fixture(scope="module")
def responses() -> Responses:
    scenarios = sample_scenarios(shipped("reference-a"), 40, seed=8)
    plants = SampledPlants(scenarios, lines_for(scenarios.device, 0.02))
    return Responses(plants.transfer(scenarios.place(POSITION_M)), plants.lines)


@pytest.fixture(scope="module")
def waveform() -> Array:
    tones = make_tones(shipped("reference-a"), 0.02)
    return tones.waveform(0.2 * np.random.default_rng(0).normal(size=len(tones.wave)))


def evaluate(
    waveform: Array, responses: Responses, is_felt: tuple[bool, ...], levels_db: Sequence[float]
) -> ClickFigures:
    """Of fewer fingers the first ones; percentiles are the plain ones."""
    under, device = responses.under(range(len(is_felt))), shipped("reference-a")
    none = np.zeros((len(under.transfer) - 1, len(under.transfer)))  # so many parameters that nothing is fitted
    placement = Placement(POSITION_M[: len(is_felt)], is_felt)
    factor = weighting(under.lines, device.threshold)
    return evaluate_waveform(waveform, under, placement, factor, levels_db, 0.05, ManyPlants(none, none))


def test_levels_are_of_each_finger_the_weakest_felt_and_the_strongest_quiet_one(
    responses: Responses, waveform: Array
) -> None:
    evaluation = evaluate(waveform, responses, (True, False, True), ())
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
    assert [finger.level_db for finger in evaluation.fingers] == pytest.approx(peak_db[0].tolist(), abs=1e-3)


def test_times_are_those_of_the_nominal_course_at_each_level(responses: Responses, waveform: Array) -> None:
    course = abs(responses.play(waveform)[0, :2])
    strongest = evaluate(waveform, responses, (True, True), (np.inf,))
    assert strongest.quiet is None
    for below_db in (0.0, 3.0, 6.0):
        level_db = strongest.felt.low_db - below_db
        found = evaluate(waveform, responses, (True, True), (level_db, np.inf))
        played = course * 10 ** (-below_db / 20)
        expected = (played > 1).argmax(axis=1).max() / EVALUATION_RATE_HZ if (played > 1).any(axis=1).all() else None
        assert found.exceeds_s[level_db] == expected and found.exceeds_s[np.inf] == strongest.exceeds_s[np.inf]
    assert strongest.exceeds_s[np.inf] is not None
    assert strongest.peak_s == course.argmax(axis=1).max() / EVALUATION_RATE_HZ
    late = course[:, round(0.05 * EVALUATION_RATE_HZ) :].max()
    assert strongest.residual_db == pytest.approx(float(decibels(late)), abs=1e-3)


CASES = [("reference-a", "F--q-"), ("reference-a", "F----"), ("reference-t", "FqFqF"), ("reference-p", "F----q")]


@pytest.mark.parametrize(("name", "letters"), CASES)
def test_they_feel_what_the_evaluation_has_of_the_nominal_plant_and_as_much_less_of_a_weaker_click(
    name: str, letters: str
) -> None:
    """The evaluation leaves out what lies above its lines, which the accelerations of quiet fingers show."""
    solver = solver_of(name)
    click, nominal = solver.solve(placed(solver.device, letters)), NominalFingers(solver.device)
    whole, softer = (
        nominal.under(each, click.placement.position_m) for each in (click, played_at(click, click.level_db - 5.0))
    )
    for one, other, evaluated in zip(whole, softer, click.fingers, strict=True):
        assert one.level_db == pytest.approx(evaluated.level_db, abs=0.1)
        assert one.acceleration_at_finger_m_per_s2 == pytest.approx(evaluated.acceleration_at_finger_m_per_s2, rel=0.12)
        assert one.level_db - other.level_db == pytest.approx(5.0)
