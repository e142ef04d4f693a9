"""Laws of the study of a finger that slides: a click made for where it will be gives back what sliding costs."""

import numpy as np

from precompute.sampling.placements import Anywhere
from tests.precompute.clicks.click_cases import CHEAP
from tests.precompute.devices import shipped
from tests.studies.physics.moving_finger import compare_moving, describe


def test_a_quiet_finger_that_slides_feels_less_of_a_click_that_is_made_for_where_it_will_be() -> None:
    found = compare_moving(shipped("reference-a"), Anywhere(placements=6), [0.0, 0.1], CHEAP)
    assert found[0.0]["made, where it is"] == found[0.0]["made, where it will be"]
    quiet_db = {way: np.array(levels)[:, 1] for way, levels in found[0.1].items()}
    assert np.median(quiet_db["made, where it is"] - quiet_db["made, where it will be"]) > 2
    assert len(describe(found)) == 6
