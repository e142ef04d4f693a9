"""Laws of a click that is played softer."""

from math import inf

import pytest

from engine.table.clicks import played_at
from tests.engine.made_clicks import click_of, in_zones
from tests.precompute.devices import shipped

REFERENCE = shipped("reference-a")
ALONE = in_zones(REFERENCE, [4])


def test_a_softer_click_is_softer_for_quiet_fingers_too() -> None:
    click = click_of(REFERENCE, in_zones(REFERENCE, [0], [3]), level_db=26.0)
    softer = played_at(click, 20.0)
    assert softer.amplitude == pytest.approx(10 ** (-6 / 20))
    assert softer.achieved
    assert softer.quiet is not None
    assert click.quiet is not None
    assert softer.quiet.high_db == pytest.approx(click.quiet.high_db - 6)
    assert softer.level_db == pytest.approx(20)
    assert softer.quiet.worst_db == pytest.approx(click.quiet.worst_db - 6)
    first, before = softer.fingers[0], click.fingers[0]
    assert first.acceleration_at_finger_m_per_s2 == pytest.approx(before.acceleration_at_finger_m_per_s2 / 10**0.3)


def test_a_click_is_never_louder_than_tabulated() -> None:
    click = click_of(REFERENCE, ALONE, level_db=14.0)
    louder = played_at(click, 20.0)
    assert (louder.amplitude, louder.level_db, louder.achieved) == (1.0, 14.0, False)
    assert played_at(click, inf).achieved


@pytest.mark.parametrize(("level_db", "expected_s"), [(5.0, None), (10.0, 0.008), (17.0, 0.008), (24.0, 0.005)])
def test_a_softer_click_is_felt_later(level_db: float, expected_s: float | None) -> None:
    assert played_at(click_of(REFERENCE, ALONE), level_db).exceeds_at_s() == expected_s
