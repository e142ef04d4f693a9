"""Standard fingers under a click: the plant in time agrees with the nominal one of the sampled plants."""

import pytest

from engine.table.clicks import played_at
from precompute.clicks.evaluation import NominalFingers
from tests.precompute.clicks.click_cases import placed, solver_of

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
