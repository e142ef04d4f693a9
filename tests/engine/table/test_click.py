"""Laws of clicks as a table holds them."""

from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest

from engine.device import Device
from engine.table import ClickEntry, Table, TableError
from engine.table.click import choose_bank, played_at
from engine.table.columns import write_clicks, write_entries
from engine.table.file import TableWriter
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.bank import bank_size, encode_bank
from firmware_link.protocol.messages import Features
from tests.engine.made_clicks import click_of
from tests.engine.made_entries import entry_of, felt_states, states_of

REFERENCE = Device.read(Path(__file__).parents[3] / "tables" / "devices" / "reference-a.toml")
STATES = felt_states(REFERENCE)
CAPABILITIES = Capabilities(
    2,
    0.01,
    1.0,
    655.35,
    (0.52e-6, 0.52e-6),
    100,
    48_000,
    1,
    0,
    (0, 1, 0),
    features=Features.WAVEFORMS,
    longest_waveform_ms=100,
    bank_capacity_bytes=1 << 18,
)


def same(one: ClickEntry, other: ClickEntry) -> bool:
    """Equal in everything, samples too."""
    blank = np.zeros(0, dtype=np.int16)
    assert one.samples.dtype == other.samples.dtype
    fields = [replace(click, samples=blank).__dict__ | {"samples": None} for click in (one, other)]
    return fields[0] == fields[1] and np.array_equal(one.samples, other.samples)


def test_a_table_gives_its_clicks_back(tmp_path: Path) -> None:
    clicks = [click_of(REFERENCE, states, count=61 + 4 * i) for i, states in enumerate(STATES)]
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


def test_a_bank_holds_every_click_at_its_place() -> None:
    clicks = [click_of(REFERENCE, states) for states in STATES]
    bank, places = choose_bank(clicks, CAPABILITIES)
    assert bank is not None
    assert sorted(places.values()) == list(range(len(STATES)))
    assert all(bank.waveforms[places[click.index]] is click.samples for click in clicks)
    assert len(encode_bank(bank, 2)) <= CAPABILITIES.bank_capacity_bytes


def test_where_room_is_short_the_clicks_of_few_fingers_have_it() -> None:
    clicks = [click_of(REFERENCE, states) for states in STATES]
    room = bank_size(2, [121] * 40) + 100
    bank, places = choose_bank(clicks, replace(CAPABILITIES, bank_capacity_bytes=room))
    assert bank is not None
    assert len(bank.waveforms) == 40
    assert len(encode_bank(bank, 2)) <= room
    left = [click.fingers for click in clicks if click.index not in places]
    assert max(click.fingers for click in clicks if click.index in places) <= min(left)


@pytest.mark.parametrize(
    "changed", [{"features": Features(0)}, {"bank_capacity_bytes": 100}, {"longest_waveform_ms": 20}]
)
def test_a_device_that_cannot_play_them_gets_no_bank(changed: dict[str, int]) -> None:
    clicks = [click_of(REFERENCE, states) for states in STATES]
    assert choose_bank(clicks, replace(CAPABILITIES, **changed)) == (None, {})  # type: ignore[arg-type]  # made by key
    assert choose_bank([], CAPABILITIES) == (None, {})
