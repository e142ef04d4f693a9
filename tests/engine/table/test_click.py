"""Laws of clicks as a table holds them."""

from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest

from engine.device import Device
from engine.table import ClickEntry, Table, TableError
from engine.table.click import played_at
from engine.table.columns import write_clicks, write_entries
from engine.table.file import TableWriter
from firmware_link.protocol.basis import Basis, BasisSet
from tests.engine.made_clicks import click_of
from tests.engine.made_entries import entry_of, felt_states, states_of

REFERENCE = Device.read(Path(__file__).parents[3] / "tables" / "devices" / "reference-a.toml")
STATES = felt_states(REFERENCE)


def same(one: ClickEntry, other: ClickEntry) -> bool:
    """Equal in everything, basis and samples too."""
    arrays = ("basis", "weights", "samples")
    fields = [{key: value for key, value in click.__dict__.items() if key not in arrays} for click in (one, other)]
    assert one.weights.dtype == other.weights.dtype and one.samples.dtype == other.samples.dtype
    is_alike = np.array_equal(one.weights, other.weights) and np.array_equal(one.samples, other.samples)
    return fields[0] == fields[1] and is_alike and one.basis.hash == other.basis.hash


def test_a_table_gives_its_clicks_back(tmp_path: Path) -> None:
    chance = np.random.default_rng(1)
    sets = []
    for functions, samples in ((7, 61), (12, 121)):
        values = chance.integers(-32_767, 32_767, (functions, samples)).astype(np.int16)
        values[:, [0, -1]] = 0
        sets.append(BasisSet(values, (np.arange(functions) % 2).astype(np.uint8)))
    basis, clicks = Basis(4000, tuple(sets)), []
    for i, states in enumerate(STATES):
        weights = chance.integers(-2_000, 2_000, len(sets[i % 2].actuators)).astype(np.int16)
        made = replace(click_of(REFERENCE, states), basis=basis, basis_set=i % 2, weights=weights, fraction_bits=14)
        clicks.append(made)
    clicks[3] = replace(clicks[3], exceeds_s={10.0: None, 20.0: None, inf: 0.01}, achieved=False)
    path = tmp_path / "bar.nc"
    with TableWriter(path) as writer:
        writer.describe(
            {"device_description": REFERENCE.text, "device_fingerprint": REFERENCE.fingerprint, "code_fingerprint": ""}
        )
        write_entries(writer, [entry_of(REFERENCE, states) for states in STATES], REFERENCE)
        write_clicks(writer, clicks, REFERENCE)
    with Table.open(path) as table:
        assert all(same(one, other) for one, other in zip(table.clicks, clicks, strict=True))
        found = table.click_for(["I"], ["IV"], 20.0)
        index = states_of(REFERENCE, [0], [3])
        assert (found.states, found.level_db) == (index, 20.0)
        with pytest.raises(TableError, match="felt and quiet"):
            table.click_for(["I"], ["I"])
        assert table.click_at(1, 20.0) is None


def test_a_softer_click_is_softer_for_quiet_fingers_too() -> None:
    click = click_of(REFERENCE, states_of(REFERENCE, [0], [3]), level_db=26.0)
    softer = played_at(click, 20.0)
    assert softer.amplitude == pytest.approx(10 ** (-6 / 20))
    assert softer.achieved
    assert softer.quiet is not None
    assert click.quiet is not None
    assert softer.quiet.high_db == pytest.approx(click.quiet.high_db - 6)
    assert softer.level_db == pytest.approx(20)
    first, before = softer.zones[0], click.zones[0]
    assert first is not None
    assert before is not None
    assert first.acceleration_at_finger_m_per_s2 == pytest.approx(before.acceleration_at_finger_m_per_s2 / 10**0.3)


def test_a_click_is_never_louder_than_tabulated() -> None:
    click = click_of(REFERENCE, STATES[0], level_db=14.0)
    louder = played_at(click, 20.0)
    assert (louder.amplitude, louder.level_db, louder.achieved) == (1.0, 14.0, False)
    assert played_at(click, inf).achieved


@pytest.mark.parametrize(("level_db", "expected_s"), [(5.0, None), (10.0, 0.008), (17.0, 0.008), (24.0, 0.005)])
def test_a_softer_click_is_felt_later(level_db: float, expected_s: float | None) -> None:
    assert played_at(click_of(REFERENCE, STATES[0]), level_db).exceeds_at_s() == expected_s
