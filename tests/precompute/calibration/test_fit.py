"""Laws of the fit: other starts leave a wrong basin, what is not told stays, bounds hold, what is held stays."""

import numpy as np
import pytest

from precompute.calibration.fit import fit, refit_held
from precompute.calibration.misfit import Loss
from precompute.measurements.simulate import Flaws
from tests.precompute.calibration.calibrations import problem_of
from tests.precompute.measured import TRUTH


def test_other_starts_leave_a_basin_that_is_not_the_least() -> None:
    far = {**TRUTH, "actuator[1].stiffness": 11e3, "actuator[2].stiffness": 37e3}
    problem = problem_of(far, Flaws())
    alone, several = (fit(problem, Loss.ROBUST, starts, seed=0) for starts in (1, 6))
    assert alone.noise > 0.01
    assert several.noise < 1e-6
    assert np.exp(several.coordinate[:2]) == pytest.approx([11e3, 37e3], rel=1e-6)


def test_a_doubtful_basin_earns_more_starts_than_were_asked() -> None:
    """Neither of the first two starts leads to this bar."""
    stiffness = {"actuator[1].stiffness": 44.01e3, "actuator[2].stiffness": 9.41e3}
    found = fit(problem_of({**TRUTH, **stiffness}, Flaws()), Loss.ROBUST, 2, seed=0)
    assert np.exp(found.coordinate[:2]) == pytest.approx(list(stiffness.values()), rel=1e-6)


@pytest.mark.parametrize("loss", Loss)
def test_holding_a_parameter_costs_and_costs_nothing_where_it_was(loss: Loss) -> None:
    found = fit(problem_of(TRUTH, Flaws(noise=0.02)), loss, 1, seed=0)
    same, cost = refit_held(found, 2, found.coordinate)
    assert cost == pytest.approx(found.cost, rel=1e-4)
    assert same[2] == found.coordinate[2]
    moved = found.coordinate + np.array([0, 0, 1.0, 0, 0, 0])
    there, dearer = refit_held(found, 2, moved)
    assert there[2] == moved[2]
    assert dearer > found.cost + 1
