"""Steps are told on, and what they took adds up to all of it."""

import time

import pytest

from tactable.calibration.step_times import StepTimes, times_text


@pytest.mark.machine
def test_every_moment_belongs_to_a_step() -> None:
    told = list[tuple[str, float]]()
    times = StepTimes(lambda *step: told.append(step), "start")
    for step in ("fit", "fit", "entries", "fit"):
        times.tell(step, 0.5)
        time.sleep(0.002)
    seconds, total_s = times.read(), times.total_s
    assert [step for step, _ in told] == ["fit", "fit", "entries", "fit"]
    assert list(seconds) == ["start", "fit", "entries"]
    assert sum(seconds.values()) == pytest.approx(total_s, rel=0.1, abs=0.01)


def test_what_took_no_time_is_not_said() -> None:
    assert times_text({"fit": 0.71, "put in place": 0.0001, "entries": 5.94}) == "fit 0.71 s, entries 5.9 s"
