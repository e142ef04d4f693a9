"""The benchmark of effects: all steps are timed over the same reports."""

from tactable.bench.effects import ROUNDS, run_effects_bench
from tactable.rig.virtual_digitizer import Stroke, make_recording


def test_every_step_is_compared_with_the_one_without_effects() -> None:
    result = run_effects_bench(make_recording((Stroke(0.0, 0.4, 0.1, 0.9), Stroke(0.1, 0.3, 0.5, 0.5))))
    plain, default, every = result["steps"]
    assert (result["reports"], result["machine"]["rounds"]) == (51, ROUNDS)
    assert "ratio" not in plain
    for row in (default, every):
        assert row["ratio"] == row["median_us"] / plain["median_us"] > 0


def test_a_recording_without_reports_has_no_figures() -> None:
    result = run_effects_bench(make_recording((Stroke(-2.0, -1.0, 0.1, 0.1),)))
    assert [row.keys() for row in result["steps"]] == [{"step"}] * 3
