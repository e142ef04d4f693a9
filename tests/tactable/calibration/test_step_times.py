"""Steps are told on, and what they took adds up to all of it."""

from tactable.calibration.job import StepTimes, times_text


def test_every_moment_belongs_to_a_step() -> None:
    told, instants_s = list[tuple[str, float]](), iter([10.0, 11.0, 13.0, 16.0, 20.0, 20.0])
    times = StepTimes(lambda *step: told.append(step), "start", lambda: next(instants_s))
    for step in ("fit", "fit", "entries", "fit"):
        times.tell_step(step, 0.5)
    assert told == [(step, 0.5) for step in ("fit", "fit", "entries", "fit")]
    assert list(times.read().items()) == [("start", 1.0), ("fit", 2.0 + 4.0), ("entries", 3.0)]
    assert times.total_s == 10.0
    assert times_text({"fit": 0.71, "put in place": 0.0001, "entries": 5.94}) == "fit 0.71 s, entries 5.9 s"
