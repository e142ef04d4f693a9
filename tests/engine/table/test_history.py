"""Laws of the table before this one, and of writing to a disk that fails."""

import os
from pathlib import Path

import numpy as np
import pytest

from engine.table import TableError
from engine.table.best_rows import write_best_rows
from engine.table.history import previous_of, remove_leftovers, replace_table, roll_back
from engine.table.netcdf_file import SpoolFile, TableWriter, Variable
from tests.base.test_files import full_disk
from tests.engine.table.test_table import DEVICE, ROWS
from tests.tools.processes import NO_PROCESS


def put(path: Path, *texts: str, keep: bool = True) -> None:
    """One new table after the other takes its place."""
    for text in texts:
        path.with_name("new").write_text(text)
        replace_table(path.with_name("new"), path, keep=keep)


@pytest.fixture(params=[True, False], ids=["links", "no links"])
def path(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    if not request.param:

        def refuse(*_: object) -> None:
            raise OSError("no links here")

        monkeypatch.setattr(os, "link", refuse)
    return tmp_path / "bar.nc"


def texts(path: Path) -> dict[str, str]:
    return {kept.name: kept.read_text() for kept in path.parent.iterdir()}


def test_the_table_before_is_kept_and_no_older_one_nor_one_that_is_only_completed(path: Path) -> None:
    put(path, "1")
    assert texts(path) == {"bar.nc": "1"}
    put(path, "2", "3")
    assert texts(path) == {"bar.nc": "3", "bar.nc.previous": "2"}
    put(path, "3 and more", keep=False)
    assert texts(path) == {"bar.nc": "3 and more", "bar.nc.previous": "2"}


def test_behind_a_link_the_table_before_lies_beside_the_table(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    real, link = tmp_path / "there" / "bar.nc", tmp_path / "link.nc"
    link.symlink_to(real)
    put(real, "1", "2")
    assert previous_of(link) == previous_of(real)
    roll_back(link)
    assert link.is_symlink() and texts(real) == {"bar.nc": "1", "bar.nc.previous": "2"}


def test_a_table_that_is_its_own_previous_one_leaves_nothing_behind(tmp_path: Path) -> None:
    """As after a kill between keeping a table and putting another in its place."""
    path = tmp_path / "bar.nc"
    put(path, "1")
    previous_of(path).hardlink_to(path)
    roll_back(path)
    assert texts(path) == {"bar.nc": "1", "bar.nc.previous": "1"}
    put(path, "2")
    assert texts(path) == {"bar.nc": "2", "bar.nc.previous": "1"}


def test_rolled_back_twice_is_as_before_and_what_a_killed_one_left_is_removed(path: Path) -> None:
    put(path, "1", "2")
    for kind in ("older", "newer"):
        path.with_name(f".bar.nc.{NO_PROCESS}.{kind}").write_text("half")
    roll_back(path)
    assert texts(path) == {"bar.nc": "1", "bar.nc.previous": "2"}
    roll_back(path)
    assert texts(path) == {"bar.nc": "2", "bar.nc.previous": "1"}
    path.unlink()  # one that was lost is put back, too
    roll_back(path)
    assert texts(path)["bar.nc"] == "1"


def test_without_a_previous_table_there_is_nothing_to_put_back_and_a_folder_is_no_table(path: Path) -> None:
    """An empty name is the present folder."""
    put(path, "1")
    for wrong, says in ((path, "there is no previous table"), (path.parent, "is a folder"), (Path(), "is a folder")):
        with pytest.raises(TableError, match=says):
            roll_back(wrong)
    assert texts(path) == {"bar.nc": "1"}


def test_only_what_dead_processes_left_is_removed(tmp_path: Path) -> None:
    kept = {f".bar.nc.{os.getpid()}.partial", ".bar.nc.clicks", ".other.nc.1.partial"}
    for name in (f".bar.nc.{NO_PROCESS}.partial", f".bar.nc.{NO_PROCESS}.newer", *kept):
        (tmp_path / name).touch()
    remove_leftovers(tmp_path / "bar.nc")
    assert {path.name for path in tmp_path.iterdir()} == kept


def write(path: Path) -> None:
    with TableWriter(path) as writer:
        writer.describe({"device_description": DEVICE.text})
        axes = ("frequency", "actuator", "zone", "point", "part")
        writer.write("responses", Variable("acceleration", axes, "1", "large"), np.ones((100, 2, 5, 32, 2)))
        write_best_rows(writer, ROWS, DEVICE)


@pytest.mark.parametrize("room", [0, 4096, 514_000, 530_000])
def test_a_full_disk_is_one_error_and_leaves_nothing(tmp_path: Path, room: int) -> None:
    """HDF5 ends the process by a segmentation fault where it closes a file that the disk did not take."""
    path = tmp_path / "table.nc"
    with full_disk(room), pytest.raises(TableError, match=rf"{path}: cannot be written there: File too large"):
        write(path)
    assert list(tmp_path.iterdir()) == []


def test_a_table_is_written_through_a_link_and_never_in_place_of_a_pipe(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    link, pipe = tmp_path / "link.nc", tmp_path / "pipe.nc"
    link.symlink_to(tmp_path / "there" / "table.nc")
    write(link)
    assert link.is_symlink() and [path.name for path in (tmp_path / "there").iterdir()] == ["table.nc"]
    os.mkfifo(pipe)
    with pytest.raises(TableError, match=r"pipe\.nc: is not a plain file, and is not replaced"), TableWriter(pipe):
        pass
    assert pipe.is_fifo()


def test_what_the_disk_does_not_take_is_read_back_all_the_same(tmp_path: Path) -> None:
    file = SpoolFile(tmp_path / "spooled")
    with full_disk(10):
        for place, content in ((0, b"0123456"), (5, b"abcdefghij"), (12, b"XY"), (2, b"--")):
            file.seek(place)
            assert file.write(content) == len(content)
        with pytest.raises(OSError, match="File too large"):
            file.check()
    file.seek(0)
    found = bytearray(20)
    assert file.readinto(found) == 15
    assert found[:15] == b"01--4abcdefgXYj"
    assert (tmp_path / "spooled").stat().st_size == 10
    file.close()
