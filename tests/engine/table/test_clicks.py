"""Laws of the clicks of a table: found by places and roles, given back as they were written, and played softer."""

from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest

from engine.table import ClickEntry, Table, TableError
from engine.table.clicks import NO_ROW, played_at
from engine.touch import Placement, PlacementError
from firmware_link.protocol.basis import Basis, BasisSet
from tests.engine.made_clicks import click_of, in_zones, places_of
from tests.engine.made_table import write_table
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
PLACES = places_of(DEVICE)
PLACEMENTS = [in_zones(DEVICE, *each) for each in (([2],), ([0], [3]), ([3], [0]), ([0, 4],), ([1], [0, 4]))]


def same(one: ClickEntry, other: ClickEntry) -> bool:
    """Equal in everything, basis and samples too."""
    arrays = ("basis", "weights", "samples")
    fields = [{key: value for key, value in click.__dict__.items() if key not in arrays} for click in (one, other)]
    assert one.weights.dtype == other.weights.dtype and one.samples.dtype == other.samples.dtype
    is_alike = np.array_equal(one.weights, other.weights) and np.array_equal(one.samples, other.samples)
    return fields[0] == fields[1] and is_alike and one.basis.hash == other.basis.hash


def varied_clicks() -> list[ClickEntry]:
    """Clicks of two sets of a basis, with chance weights; the third passes no threshold at two levels."""
    chance = np.random.default_rng(1)
    sets = []
    for functions, samples in ((7, 61), (12, 121)):
        values = chance.integers(-32_767, 32_767, (functions, samples)).astype(np.int16)
        values[:, [0, -1]] = 0
        sets.append(BasisSet(values, (np.arange(functions) % 2).astype(np.uint8)))
    basis, clicks = Basis(4000, tuple(sets)), []
    for i, placement in enumerate(PLACEMENTS):
        weights = chance.integers(-2_000, 2_000, len(sets[i % 2].actuators)).astype(np.int16)
        made = replace(click_of(DEVICE, placement), basis=basis, basis_set=i % 2, weights=weights, fraction_bits=14)
        clicks.append(made)
    clicks[3] = replace(clicks[3], exceeds_s={10.0: None, 20.0: None, inf: 0.01})
    return clicks


def test_a_table_gives_its_clicks_back(tmp_path: Path) -> None:
    clicks = varied_clicks()
    with Table.open(write_table(tmp_path / "bar.nc", DEVICE, clicks)) as table:
        assert all(same(one, other) for one, other in zip(table.clicks, clicks, strict=True))
        assert table.places == PLACES and table.clicks.tolerance_m == clicks[0].tolerance_m
    found = table.click_for(["I"], ["IV"], 20.0)
    assert (found.placement, found.level_db) == (PLACEMENTS[1], 20.0)
    assert table.click_for(["30 mm"], [0.19]).placement == PLACEMENTS[1]
    with pytest.raises(TableError, match=r"no click for fingers at 27\.94 mm, 251\.46 mm"):
        table.click_for(["I"], ["V"])
    with pytest.raises(PlacementError, match="one finger to the surface"):
        table.click_for(["I"], ["I"])
    assert table.click_at(Placement.on(DEVICE, [0.01]), 20.0) is None


def test_a_table_without_clicks_has_places_and_solves_drives_all_the_same(tmp_path: Path) -> None:
    with Table.open(write_table(tmp_path / "bar.nc", DEVICE)) as table:
        assert not table.clicks and list(table.clicks) == [] and table.clicks.basis is None
        assert table.places == PLACES and table.click_at(PLACEMENTS[0], 20.0) is None
        assert (table.clicks.pair == NO_ROW).all()
        drive = table.drive_for(["35 mm"], ["IV"], 14.0)
    assert drive.felt == (True, False) and drive.wanted_level_db == 14.0
    assert drive.level_db[0] > drive.level_db[1]


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
