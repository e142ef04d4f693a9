"""Laws of an open table and its clicks: what was written is found, and what cannot be is refused by name."""

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from math import inf
from pathlib import Path

import h5netcdf
import h5py
import numpy as np
import pytest

from engine.device import Device
from engine.table import ClickEntry, Table, TableError
from engine.table.best_rows import write_best_rows
from engine.table.clicks import NO_ROW, played_at
from engine.table.columns import write_modes
from engine.table.netcdf_file import TableWriter, Variable
from engine.touch import Placement, PlacementError
from firmware_link.protocol.basis import Basis, BasisSet
from tests.engine.made_table import click_of, in_zones, modes_of, places_of, rows_of, write_table
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
TEXT = DEVICE.text
CODE = "c0de"
SWEEP = ("pair", "frequency_1", "amplitude_1", "amplitude_2", "zone", "frequency_2")
SHAPE = (2, 4, 3, 3, 5, 4)
ROWS = rows_of(DEVICE, (10.0, 20.0, math.inf))


def figure(name: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.random.default_rng(len(name)).random(SHAPE, dtype=np.float32)


def fill(writer: TableWriter) -> None:
    description = {"device_description": TEXT, "device_fingerprint": DEVICE.fingerprint}
    writer.describe({"device_name": DEVICE.name, "code_fingerprint": CODE, "click_pitch_m": 3e-3, **description})
    for name in ("localized_factor", "peak_acceleration", "dead_spot"):
        writer.write("sweep", Variable(name, SWEEP, "1", name), figure(name))
    write_modes(writer, modes_of(DEVICE), DEVICE)
    write_best_rows(writer, ROWS, DEVICE)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("table") / "whole.nc"
    with TableWriter(path) as writer:
        fill(writer)
    return path


@pytest.fixture
def table(whole: Path) -> Iterator[Table]:
    with Table.open(whole, device=DEVICE, code_fingerprint=CODE) as table:
        yield table


def copied(path: Path, target: Path) -> Path:
    target.write_bytes(path.read_bytes())
    return target


def refusal(path: Path, device: Device | None = None, code: str | None = None) -> str:
    with pytest.raises(TableError) as error:
        Table.open(path, device=device, code_fingerprint=code).close()
    assert str(error.value).startswith(f"{path}: ")
    return str(error.value)


@pytest.mark.parametrize("pair", [0, 1])
def test_a_zone_combination_adds_shares_and_takes_the_extreme_levels(table: Table, pair: int) -> None:
    for name, combine in (("localized_factor", np.sum), ("peak_acceleration", np.max), ("dead_spot", np.min)):
        stored = figure(name)[pair].transpose(0, 4, 1, 2, 3)[..., [1, 4]]
        assert getattr(table, name)(["V", "II", "II"], pair) == pytest.approx(combine(stored, axis=-1))


def test_no_zone_and_no_such_pair_are_refused(table: Table) -> None:
    with pytest.raises(TableError, match="at least one zone"):
        table.localized_factor([])
    for pair in (-1, 2):
        with pytest.raises(TableError, match=f"no actuator pair {pair}; there are 2"):
            table.dead_spot(["I"], pair)


def test_a_byte_flipped_anywhere_is_refused(whole: Path, tmp_path: Path) -> None:
    """The seal is of all bytes, and is looked at before HDF5, which a damaged file can keep busy for ever."""
    path, content, random = tmp_path / "flipped.nc", whole.read_bytes(), np.random.default_rng(1)

    def flipped(place: int) -> Path:
        changed = bytearray(content)
        changed[place] ^= 1 << random.integers(8)
        path.write_bytes(changed)
        return path

    for place in random.integers(60, len(content) - 16, size=80).tolist():
        assert "is corrupted: it fails its checksum" in refusal(flipped(place)), place
    for place in (*range(60), *range(-16, 0)):  # what HDF5 knows its files by, and the seal
        assert re.search("fails its checksum|truncated|not a NetCDF-4 file", refusal(flipped(place))), place


CHANGED: dict[str, tuple[Callable[[h5py.File], object], str]] = {
    "a newer format": (lambda file: file.attrs.update(format_revision=9), "revision 9.*reads 8; update"),
    "an older format": (lambda file: file.attrs.update(format_revision=7), "revision 7.*reads 8; build it again"),
    "another attribute": (lambda file: file.attrs.update(device_name="other"), "corrupted"),
    "an array is missing": (lambda file: file["best_rows"].pop("share"), "corrupted"),
}


@pytest.mark.parametrize("change", CHANGED)
def test_a_table_that_was_changed_is_refused(whole: Path, tmp_path: Path, change: str) -> None:
    path, (apply, says) = copied(whole, tmp_path / "changed.nc"), CHANGED[change]
    with h5py.File(path, "a") as file:
        apply(file)
    assert re.search(says, refusal(path))


@pytest.mark.parametrize("fraction", [0.0005, 0.1, 0.5, 0.999, 1.0])
def test_a_truncated_table_is_refused(whole: Path, tmp_path: Path, fraction: float) -> None:
    content = whole.read_bytes()
    (tmp_path / "cut.nc").write_bytes(content[: int(fraction * (len(content) - 1))])
    assert re.search("truncated|corrupted|not a NetCDF-4 file", refusal(tmp_path / "cut.nc"))


def test_what_is_no_table_is_refused(tmp_path: Path) -> None:
    assert "no such table" in refusal(tmp_path / "missing.nc") and "no such table" in refusal(tmp_path)
    for content in (b"", b"frequency;level\n60;1.5\n", b"\0" * 4096):
        (tmp_path / "other.nc").write_bytes(content)
        assert "not a NetCDF-4 file" in refusal(tmp_path / "other.nc")
    with h5netcdf.File(tmp_path / "foreign.nc", "w") as file:
        file.dimensions["time"] = 3
    assert "not a table of tactable" in refusal(tmp_path / "foreign.nc")
    with pytest.raises(TableError, match="no such folder"), TableWriter(tmp_path / "absent" / "t.nc"):
        pass


def test_the_table_of_another_device_state_or_code_is_refused_and_names_it(whole: Path) -> None:
    other = Device.parse(TEXT.replace('name = "reference-a"', 'name = "mine"'), "mine.toml")
    stiffer = Device.parse(TEXT.replace('stiffness = "18.9 kN/m"', 'stiffness = "19 kN/m"'), "other.toml")
    assert re.search("'reference-a'.*'mine'", refusal(whole, other))
    assert re.search("stale.*state of 'reference-a'", refusal(whole, stiffer))
    assert re.search("stale.*version of the code", refusal(whole, DEVICE, "0dd"))


def test_a_table_is_read_back_for_a_device_of_other_wording_and_is_usable_after_closing(whole: Path) -> None:
    with Table.open(whole, device=replace(DEVICE, description="something else", text="")) as table:
        assert table.best_rows == ROWS
    assert table.best_row(["I"], level_db=10.0) == ROWS[1][0]
    assert table.device == DEVICE


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_an_exception_while_writing_leaves_nothing_and_keeps_an_older_table(
    whole: Path, tmp_path: Path, error: type[BaseException]
) -> None:
    older = copied(whole, tmp_path / "older.nc")
    for path in (older, tmp_path / "new.nc"):
        with pytest.raises(error), TableWriter(path) as writer:
            fill(writer)
            raise error
    assert [path.name for path in tmp_path.iterdir()] == ["older.nc"]
    assert older.read_bytes() == whole.read_bytes()


def test_an_array_with_missing_elements_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="sweep/x: 3 elements"), TableWriter(tmp_path / "short.nc") as writer:
        stream = writer.open_stream("sweep", Variable("x", ("a", "b"), "1", ""), (4, 3), np.float64)
        stream.append(np.ones(3))
        stream.close()
    assert not list(tmp_path.iterdir())


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
