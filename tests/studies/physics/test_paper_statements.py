"""What docs/theory.md says of the statements of the paper and of reference-a."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tactable.shipped import find_device
from tests.studies.physics.paper_statements import (
    DAMPING_OF,
    Reading,
    Solved,
    check,
    figures_of,
    solve,
    with_damping_of,
)

THEORY = Path(__file__).parents[3] / "docs" / "theory.md"


@cache
def solved() -> Solved:
    return solve(find_device("reference-a"), np.linspace(60, 300, 961))


def documented_margins() -> list[list[float]]:
    """Margins (end, statement) of the table under "Paper against model"."""
    rows = re.findall(r"^\|[^|]*\|[^|]*\|[^|]*\| ([+-]?[\d.]+) \|[^|]*\| ([+-]?[\d.]+) \|$", THEORY.read_text(), re.M)
    return [[float(row[end]) for row in rows] for end in (0, 1)]


@pytest.mark.parametrize("from_right", [False, True])
def test_the_table_of_the_document_is_what_the_model_says(from_right: bool) -> None:
    found = [margin for _, margin in check(figures_of(solved(), Reading(1, False, from_right)))]
    assert documented_margins()[from_right] == pytest.approx(found, abs=0.06)
    assert sum(margin >= 0 for margin in found) == (15 if from_right else 10)


def test_an_assembly_that_damps_lowers_the_reach_below_the_published_one() -> None:
    device, frequency_hz = find_device("reference-a"), np.linspace(60, 300, 961)
    both = [solve(with_damping_of(device, read), frequency_hz) for read in DAMPING_OF]
    reach_m_per_s2 = [figures_of(each, Reading(0, False, False)).reach.min() for each in both]
    assert reach_m_per_s2[1] < 1.5 * 9.80665 < reach_m_per_s2[0]
