"""Laws of bursts as a table holds them."""

from math import inf
from pathlib import Path

import pytest

from engine.device import Device
from engine.table import Table, TableError
from engine.table.burst import NUMBER_OF_SHAPES, played_at
from tests.engine.made_bursts import SHAPES, burst_of
from tests.engine.made_entries import entry_of, felt_states, states_of
from tests.engine.made_table import write_table

REFERENCE = Device.read(Path(__file__).parents[3] / "tables" / "devices" / "reference-a.toml")
STATES = felt_states(REFERENCE)
ENTRIES = [entry_of(REFERENCE, states) for states in STATES]


def test_a_table_gives_its_bursts_and_shapes_back(tmp_path: Path) -> None:
    bursts = [
        burst_of(REFERENCE, states, frequency_hz=100 + i / 7, shape=i % 2, stop_s=0.01 + i / 1e5)
        for i, states in enumerate(STATES)
    ]
    path = write_table(tmp_path / "bar.nc", REFERENCE, ENTRIES, bursts=bursts, shapes=SHAPES)
    with Table.open(path) as table:
        assert (list(table.bursts), table.shapes) == (bursts, SHAPES)
        assert table.burst_at(bursts[3].index, inf) == bursts[3]
        assert table.bursts_at(20.0) == tuple(played_at(burst, 20.0) for burst in bursts)
        assert table.burst_at(1, 20.0) is None


def test_a_table_without_bursts_has_no_shapes(tmp_path: Path) -> None:
    with Table.open(write_table(tmp_path / "bar.nc", REFERENCE, ENTRIES)) as table:
        assert (table.bursts, table.shapes) == ((), ())


def test_more_shapes_than_a_device_keeps_are_refused(tmp_path: Path) -> None:
    bursts, shapes = [burst_of(REFERENCE, STATES[0])], SHAPES[:1] * (NUMBER_OF_SHAPES + 1)
    with pytest.raises(TableError, match="share"):
        write_table(tmp_path / "bar.nc", REFERENCE, ENTRIES, bursts=bursts, shapes=shapes)
    assert list(tmp_path.iterdir()) == []


def test_a_softer_burst_is_softer_for_quiet_fingers_too_and_none_is_louder() -> None:
    burst = burst_of(REFERENCE, states_of(REFERENCE, [0], [3]), level_db=26.0)
    softer, louder = played_at(burst, 20.0), played_at(burst, 30.0)
    assert softer.amplitudes == pytest.approx([0.4 * 10 ** (-6 / 20)] * 2)
    assert softer.quiet is not None and burst.quiet is not None
    assert softer.quiet.high_db == pytest.approx(burst.quiet.high_db - 6)
    assert softer.level_db == pytest.approx(20)
    assert softer.achieved
    assert (louder.amplitudes, louder.level_db, louder.achieved) == (burst.amplitudes, 26.0, False)
    assert played_at(burst, inf) == burst
