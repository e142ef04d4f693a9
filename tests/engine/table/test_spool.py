"""Laws of writing a table to a disk that fails: one error that names the file, nothing left, the older table kept."""

import os
from pathlib import Path

import numpy as np
import pytest

from engine.table.best_rows import write_best_rows
from engine.table.error import TableError
from engine.table.netcdf_file import SpoolFile, TableWriter, Variable
from tests.base.test_files import full_disk
from tests.engine.table.test_table import DEVICE, ROWS


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
