"""Laws of the studies of a finger that slides and of a channel that is late: both are told, and what they cost goes."""

import numpy as np

from precompute.sampling.placements import Anywhere
from tests.precompute.clicks.click_cases import CHEAP
from tests.precompute.devices import shipped
from tests.studies.physics.late_channel import calibrated, compare_late, late_device
from tests.studies.physics.moving_finger import compare_moving, describe

DEVICE = shipped("reference-a")
FEW = Anywhere(placements=6)


def test_a_quiet_finger_that_slides_feels_less_of_a_click_that_is_made_for_where_it_will_be() -> None:
    found = compare_moving(DEVICE, FEW, [0.0, 0.1], CHEAP)
    assert found[0.0]["made, where it is"] == found[0.0]["made, where it will be"]
    quiet_db = {way: np.array(levels)[:, 1] for way, levels in found[0.1].items()}
    assert np.median(quiet_db["made, where it is"] - quiet_db["made, where it will be"]) > 2
    assert len(describe(found)) == 6


def test_a_fit_with_delays_gives_back_what_a_late_channel_takes() -> None:
    true = late_device(DEVICE, 125e-6)
    fitted, told = calibrated(DEVICE, true, with_delays=True)
    assert abs(fitted.actuators[1].delay_s - 125e-6) < 6e-6 and fitted.actuators[0].delay_s < 6e-6
    assert len(told) == 3
    found = compare_late(true, {"file": DEVICE, "fit": fitted}, FEW, CHEAP)
    before, after = (np.array(levels)[:, 1] for levels in found.values())
    assert np.median(before - after) > 2 and after.max() < 2
