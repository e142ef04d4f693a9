"""Laws of a click over time: its peaks are the figures of the table, and softer is the same, smaller."""

from dataclasses import astuple
from math import inf

import pytest

from engine.table import ClickEntry
from precompute.clicks.click_basis import EVALUATIONS_PER_SAMPLE
from tactable.explain.click_course import Course, compute_course
from tactable.explain.click_source import ClickSource
from tests.tactable.click_table import click_of, placed


def course_of(source: ClickSource, felt: str, quiet: str, level_db: float = inf) -> tuple[ClickEntry, Course]:
    click = click_of(source, felt, quiet, level_db)
    return click, compute_course(source, click, placed(source, felt, quiet))


@pytest.mark.parametrize("level_db", [inf, 3.0])
@pytest.mark.parametrize(("felt", "quiet"), [("I", "III"), ("III", "II"), ("II", "")])
def test_peaks_are_the_levels_of_the_table(source: ClickSource, felt: str, quiet: str, level_db: float) -> None:
    click, course = course_of(source, felt, quiet, level_db)
    (finger,) = course.placement.felt
    assert course.peaks_db(finger) == pytest.approx(astuple(click.felt)[:4], abs=0.05)  # peaks between instants
    for finger in course.placement.quiet:
        assert click.quiet is not None
        assert course.peaks_db(finger) == pytest.approx(astuple(click.quiet)[:4], abs=0.05)


def test_the_displacement_passes_through_the_samples_and_ends_in_silence(source: ClickSource) -> None:
    click, course = course_of(source, "I", "III", 2.0)
    drawn = course.displacement[:, : EVALUATIONS_PER_SAMPLE * len(click.samples) : EVALUATIONS_PER_SAMPLE]
    assert pytest.approx(click.samples / 32767 * click.amplitude) == drawn.T
    assert not course.displacement[:, EVALUATIONS_PER_SAMPLE * (len(click.samples) - 1) :].any()
    assert course.time_s[EVALUATIONS_PER_SAMPLE * (len(click.samples) - 1)] == pytest.approx(click.length_s)
    assert course.displacement.shape[1] == course.weighted.shape[2] == len(course.time_s)
