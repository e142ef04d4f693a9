"""Laws of what readings say of a promise, and of what is played."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.table import Table
from engine.touch import Placement
from tactable.measure.faults import SPOILING, Fault
from tactable.measure.verification import (
    LEAST_M_PER_S2,
    MOST_BLUR,
    Judgement,
    Outcome,
    Played,
    Point,
    Verdict,
    plan_played,
)
from tests.engine.made_table import click_of, in_zones, write_table
from tests.precompute.devices import shipped

PLAYED = Played(Placement((0.05,), (True,)), None, None)
sizes = st.floats(0, 100)


def point_of(read: float, low: float = 0.9, high: float = 1.1, error: float = 0.0, fault: Fault | None = None) -> Point:
    return Point(PLAYED, 0.1, read, (low + high) / 2, low, high, error, () if fault is None else (fault,))


@given(sizes, sizes, sizes, sizes, st.floats(-1, 1))
def test_a_kept_promise_excludes_bars_that_move_much_more_or_less_than_promised(
    one: float, other: float, read: float, error: float, off: float
) -> None:
    """The true motion is anywhere within the error of the reading."""
    low, high = sorted((one, other))
    true = read + off * error
    found = point_of(read, low, high, error).outcome
    if found is Outcome.KEPT:
        blur = 2 * MOST_BLUR * high + LEAST_M_PER_S2
        assert low - blur <= true + 1e-9 and true <= high + blur + 1e-9
    if low <= true <= high:
        assert found is not Outcome.BROKEN


@pytest.mark.parametrize("read", [0.0, 1.0, 2.0, float("nan")])
@pytest.mark.parametrize("error", [1.0, 200.0, float("inf"), float("nan")])
def test_a_reading_without_certainty_keeps_nothing(read: float, error: float) -> None:
    assert point_of(read, error=error).outcome is Outcome.NOT_SHOWN
    assert point_of(float("nan")).outcome is not Outcome.KEPT


@pytest.mark.parametrize("fault", Fault)
def test_a_spoiled_reading_is_neither_kept_nor_broken(fault: Fault) -> None:
    assert (point_of(9.0, fault=fault).outcome is Outcome.SPOILED) == (fault in SPOILING)


@pytest.mark.parametrize(
    ("untested", "broken", "verdict"),
    [
        (0, 0, Verdict.KEPT),
        (1, 0, Verdict.KEPT),
        (0, 1, Verdict.KEPT),
        (2, 0, Verdict.IN_PART),
        (0, 2, Verdict.BROKEN),
        (5, 1, Verdict.BROKEN),
        (10, 0, Verdict.NOT_SHOWN),
    ],
)
@pytest.mark.parametrize("how", [{"fault": Fault.CLIPPING}, {"error": 2.0}])
def test_a_promise_that_was_tested_in_part_only_is_not_called_kept(
    untested: int, broken: int, verdict: Verdict, how: dict[str, object]
) -> None:
    points = [point_of(1.0, **how)] * untested + [point_of(2.0)] * broken  # type: ignore[arg-type]  # its words
    assert Judgement.of(points + [point_of(1.0)] * (10 - len(points))).verdict is verdict


def test_where_a_table_has_no_click_of_two_fingers_that_of_the_felt_one_is_played(tmp_path: Path) -> None:
    device = shipped("reference-a")
    one, other, both = in_zones(device, [0]), in_zones(device, [3]), in_zones(device, [0], [3])
    played = {}
    for name, made in (("alone", [one, other]), ("both", [one, other, both]), ("none", [other])):
        path = write_table(tmp_path / f"{name}.nc", device, [click_of(device, each) for each in made])
        with Table.open(path, verify=False) as table:
            found = plan_played(table, [both], 20.0)
        assert [each.kind for each in found][:1] == ["drive"]
        played[name] = [each.placement for each in found[1:]]
    assert played == {"alone": [one], "both": [both], "none": []}
