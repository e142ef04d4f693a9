"""Laws of the study of a click, and of its picture: each point is the click of these options."""

from dataclasses import replace

import pytest

from engine.touch import Placement
from precompute.clicks import ClickSolver
from tactable.explain.click_source import ClickSource
from tactable.explain.click_study import Study, run_study
from tactable.figures.click_study import plot_click_study


@pytest.fixture(scope="module")
def told() -> list[float]:
    return []


@pytest.fixture(scope="module")
def study(source: ClickSource, told: list[float]) -> Study:
    device = source.table.device
    return run_study(
        device,
        Placement.named(device, ["I"], ["III"]),
        lengths_s=(0.01, 0.02),
        scenarios=(2, 4),
        options=source.options,
        on_progress=told.append,
    )


def test_each_point_is_the_click_of_its_options(study: Study, told: list[float]) -> None:
    assert [(varied, length_s, count) for varied, length_s, count, _ in study.clicks] == [
        ("length", 0.01, 4),
        ("length", 0.02, 4),
        ("scenarios", 0.02, 2),
        ("scenarios", 0.02, 4),
    ]
    assert told == pytest.approx([1 / 3, 2 / 3, 1])  # one point is on both curves
    assert study.by_length[0.02] is study.by_scenarios[4]
    alone = ClickSolver(study.device, replace(study.options, scenarios=2)).solve(study.placement)
    assert (alone.waveform == study.by_scenarios[2].waveform).all()


def test_the_point_of_the_table_s_options_is_the_table_s_click(source: ClickSource, study: Study) -> None:
    click = source.table.click_for(["I"], ["III"], float("inf"))
    assert study.by_length[0.02].evaluation.felt.low_db == pytest.approx(click.felt.low_db)


def test_the_picture_has_every_point_and_both_sides(study: Study) -> None:
    picture = plot_click_study(study)
    columns, clicks = picture.columns, [click for *_, click in study.clicks]
    felt = [click.evaluation.felt.low_db for click in clicks]
    quiet = [click.evaluation.quiet and click.evaluation.quiet.high_db for click in clicks]
    assert columns["felt level, 5 % (dB above threshold oh-choi-2019)"] == felt
    assert columns["quiet level, 95 % (dB above threshold oh-choi-2019)"] == quiet
    assert [point["level_db"] for point in picture.summary["clicks"]] == felt
    assert len(picture.figure.axes) == 2
    for axes in picture.figure.axes:
        assert [line for line in axes.lines if line.get_label() == "quiet, 95 %"]
