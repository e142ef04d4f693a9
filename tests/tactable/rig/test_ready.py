"""Laws of shipped tables: of this device, small, and what a build here comes to."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from engine.device import Device
from engine.table import Table, TableError
from precompute.builder.table_build import build_table
from tactable.rig import ready
from tactable.rig.ready import (
    cached_table,
    compare_with_shipped,
    early_options,
    early_path,
    is_outdated,
    open_cached,
    open_shipped,
    take_built,
)
from tactable.shipped import find_device, find_table, shipped_names
from tests.precompute.builder.test_table_build import SMALL
from tests.tools.ready_tables import REMAKE, pack

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def built(click_table: Path) -> Iterator[Table]:
    with Table.open(click_table) as table:
        yield table


@pytest.fixture
def shipped(built: Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache, in front of a program that ships the small table."""
    (tmp_path / "ready").mkdir()
    monkeypatch.setattr(ready, "packed_path", lambda name: tmp_path / "ready" / f"{name}.nc.xz")
    pack(built, tmp_path / "ready" / f"{built.device.name}.nc.xz")
    return tmp_path / "cache" / "bar.nc"


def test_a_shipped_table_plays_what_it_was_made_of_until_one_was_built_here(built: Table, shipped: Path) -> None:
    with open_cached(built.device, shipped) or pytest.fail("is shipped") as table:
        assert table.is_shipped and table.path != shipped
        found = compare_with_shipped(table, built)
        drives = [each.drive_for(["35 mm"], ["120 mm"]) for each in (table, built)]
    assert (found.clicks, found.changed) == (len(built.clicks), 0)
    assert "as shipped" in found.text
    assert drives[0].expected_contrast_db == pytest.approx(drives[1].expected_contrast_db, abs=0.5)  # from few modes
    early_path(shipped).write_bytes(built.path.read_bytes())
    with open_cached(built.device, shipped) or pytest.fail("was built") as table:
        assert not table.is_shipped


def test_a_table_that_was_built_of_a_device_file_is_taken_until_the_file_changes(
    built: Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    file = tmp_path / "bar.toml"
    file.write_text(built.device.text, encoding="utf-8")
    device = Device.read(file)
    assert take_built(device, file, tmp_path / "cache") is None
    with pytest.raises(TableError, match="tactable build"):
        find_table(file)
    lies_beside = tmp_path / f"{device.name}.nc"
    lies_beside.write_bytes(built.path.read_bytes())
    lies_beside.chmod(0o600)
    cached_table(device, tmp_path / "cache").parent.mkdir()
    cached_table(device, tmp_path / "cache").write_bytes(b"an earlier one")
    for _ in range(2):
        assert take_built(device, file, tmp_path / "cache") == find_table(file) == lies_beside
    assert lies_beside.stat().st_mode & 0o777 == 0o600
    without_clicks = Path(f"{device.name}.nc")
    build_table(device, without_clicks, clicks_up_to=0)
    assert (take_built(device, file, tmp_path / "cache"), find_table(file)) == (lies_beside, without_clicks)
    without_clicks.write_bytes(b"no table")  # here; that beside the file is one
    assert take_built(device, file, tmp_path / "cache") == find_table(file) == lies_beside
    with open_cached(device, cached_table(device, tmp_path / "cache")) or pytest.fail("was built") as table:
        assert len(table.clicks) == len(built.clicks)
    file.write_text(SMALL.replace("count = 3", "count = 4"), encoding="utf-8")
    assert take_built(Device.read(file), file, tmp_path / "cache") is None
    with pytest.raises(TableError, match="stale"):
        find_table(file)


def test_of_another_device_it_is_not_played_and_of_older_code_it_is_called_outdated(
    built: Table, shipped: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = Device.parse(SMALL.replace("count = 3", "count = 4"), built.device.name)
    assert open_cached(other, shipped) is None
    assert not list(shipped.parent.glob("*-shipped*"))
    with open_shipped(built.device, shipped) or pytest.fail("is shipped") as table:
        assert not is_outdated(table)
        monkeypatch.setattr(ready, "code_fingerprint", lambda: "0" * 64)
        assert is_outdated(table)


def test_two_processes_that_look_for_the_table_of_another_device_at_once_find_none(
    built: Table, shipped: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = Device.parse(built.device.text.replace("phase_steps = 12", "phase_steps = 24"), "bar.toml")
    opened, open_table = list[Path](), Table.open

    def open_late(path: Path, **options: object) -> Table:
        """The other process takes away what was unpacked just before this one does."""
        opened.append(path)
        try:
            return open_table(path, **options)  # type: ignore[arg-type]  # those of Table.open
        finally:
            path.unlink(missing_ok=True)

    monkeypatch.setattr(Table, "open", open_late)
    assert other.fingerprint != built.device.fingerprint and open_shipped(other, shipped) is None
    assert len(opened) == 2 and not list(shipped.parent.iterdir())


def built_in_the_check(name: str) -> object:
    """One table is built anew in each check; the others are of the same code, and on demand."""
    is_asked = name == shipped_names()[0] or "TACTABLE_SHIPPED" in os.environ
    return pytest.param(name, marks=pytest.mark.skipif(not is_asked, reason="long run: set TACTABLE_SHIPPED"))


@pytest.mark.parametrize("name", shipped_names())
def test_a_shipped_table_is_of_this_code(name: str, tmp_path: Path) -> None:
    with open_shipped(find_device(name), tmp_path / "t.nc") or pytest.fail() as table:
        assert not is_outdated(table), f"older code made it, as the page would say: {REMAKE} {name}"


@pytest.mark.parametrize("name", list(map(built_in_the_check, shipped_names())))
def test_a_shipped_table_is_what_a_build_makes(name: str, tmp_path: Path) -> None:
    """Other processors round otherwise, which changes what is as good in one of a hundred clicks."""
    device = find_device(name)
    build_table(device, tmp_path / "built.nc", click_options=early_options())
    with Table.open(tmp_path / "built.nc") as here, open_shipped(device, tmp_path / "t.nc") or pytest.fail() as table:
        found = compare_with_shipped(table, here)
    assert found.most_db is not None
    assert found.changed <= 0.03 * found.clicks and found.most_db < 1.0
