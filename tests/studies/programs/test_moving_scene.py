"""The study of a scene that changes under taps: its count is right, and a short one has no wrong effect."""

from typing import Any

import pytest

from tests.studies.programs.moving_scene import ELSEWHERE_DB, Scene, judge, run

SCENES = [Scene(0, 0, -1.0, -1.0, 0.0), Scene(100, 200, 0.1, 0.2, 25.0), Scene(1000, 1100, 0.15, 0.25, 10.0)]


def test_a_tap_may_get_the_old_or_the_new_level_only_during_a_change() -> None:
    taps = [
        (50, 0.12, ELSEWHERE_DB),
        (150, 0.12, ELSEWHERE_DB),
        (150, 0.12, 25.0),
        (500, 0.12, 25.0),
        (1050, 0.18, 10.0),
    ]
    assert judge(SCENES, taps) == {"right": 2, "right, during a change": 3, "wrong": 0}
    wrong = [(50, 0.12, 25.0), (500, 0.12, ELSEWHERE_DB), (1200, 0.12, 25.0), (150, 0.18, 10.0)]
    assert judge(SCENES, wrong) == {"right": 0, "right, during a change": 0, "wrong": 4}


@pytest.mark.machine
def test_a_short_run_loses_no_report_and_has_no_wrong_effect() -> None:
    found: dict[str, Any] = run(50, 2)
    assert found["wrong"] == found["lost_frames"] == found["mispredicted"] == found["events_lost"] == 0
    assert found["reports"] == found["reports_of_the_recording"] and found["control_steps"] == 50
    assert found["taps_heard"] > 50
