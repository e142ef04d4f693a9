"""Laws of writing a table to a disk that fails: one error that names the file, nothing left, the older table kept."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from engine.table.error import TableError
from engine.table.file import TableWriter, Variable
from engine.table.spool import SpoolFile
from tests.engine.table.test_table import DEVICE, ROWS

# In a process of its own: HDF5 ended it by a segmentation fault, and the limit on file sizes holds for all of it.
WRITE = """
import resource, sys
from pathlib import Path
import tests.engine.table.test_spool as here
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
here.write(Path(sys.argv[1]))
"""


def write(path: Path) -> None:
    import numpy as np

    from engine.table.best_rows import write_best_rows

    try:
        with TableWriter(path) as writer:
            writer.describe({"device_description": DEVICE.text})
            axes = ("frequency", "actuator", "zone", "point", "part")
            writer.write("responses", Variable("acceleration", axes, "1", "large"), np.ones((100, 2, 5, 32, 2)))
            write_best_rows(writer, ROWS, DEVICE)
    except TableError as error:
        print(error)  # noqa: T201
        sys.exit(1)


@pytest.mark.machine
@pytest.mark.parametrize("room", [0, 4096, 514_000, 530_000])
def test_a_full_disk_is_one_error_and_leaves_nothing(tmp_path: Path, room: int) -> None:
    path = tmp_path / "table.nc"
    done = subprocess.run(
        [sys.executable, "-c", WRITE, str(path), str(room)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, (done.returncode, done.stderr[-2000:])
    assert done.stderr == ""
    assert done.stdout.startswith(f"{path}: cannot be written there: File too large")
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
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    file = SpoolFile(tmp_path / "spooled")
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))
    try:
        for place, content in ((0, b"0123456"), (5, b"abcdefghij"), (12, b"XY"), (2, b"--")):
            file.seek(place)
            assert file.write(content) == len(content)
        with pytest.raises(OSError, match="File too large"):
            file.check()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    file.seek(0)
    found = bytearray(20)
    assert file.readinto(found) == 15
    assert found[:15] == b"01--4abcdefgXYj"
    assert (tmp_path / "spooled").stat().st_size == 10
    file.close()
