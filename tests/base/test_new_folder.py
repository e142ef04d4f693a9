"""Laws of a new folder: whole or not there, never in the place of another, whenever the writer is killed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from base.files import FolderError, write_new_folder

FILES = {"one.txt": b"1" * 100_000, "two.txt": b"2" * 100_000, "three.txt": b"3" * 100_000}
WRITER = """
import sys
from pathlib import Path
from base.files import write_new_folder
files = {name: digit * 100_000 for name, digit in (("one.txt", b"1"), ("two.txt", b"2"), ("three.txt", b"3"))}
print("ready", flush=True)
for number in range(1_000_000):
    write_new_folder(Path(sys.argv[1]) / f"made-{number}", files)
"""


def test_a_folder_appears_with_all_its_files_and_nothing_beside_it(tmp_path: Path) -> None:
    write_new_folder(tmp_path / "new", FILES)
    assert {path.name: path.read_bytes() for path in (tmp_path / "new").iterdir()} == FILES
    assert [path.name for path in tmp_path.iterdir()] == ["new"]


@pytest.mark.parametrize("kind", ["folder", "empty folder", "file", "dangling link"])
def test_what_is_there_is_never_overwritten(kind: str, tmp_path: Path) -> None:
    target = tmp_path / "old"
    if kind == "file":
        target.write_text("mine")
    elif kind == "dangling link":
        target.symlink_to(tmp_path / "nowhere")
    else:
        target.mkdir()
        if kind == "folder":
            (target / "mine").write_text("mine")
    with pytest.raises(FolderError, match="old: exists already and is not overwritten"):
        write_new_folder(target, FILES)
    assert [path.name for path in tmp_path.iterdir()] == ["old"]


def test_a_parent_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(FolderError, match="no such folder"):
        write_new_folder(tmp_path / "nowhere" / "new", FILES)


@pytest.mark.machine
def test_a_writer_killed_at_any_instant_leaves_whole_folders_only(tmp_path: Path) -> None:
    seen = 0
    for round_number in range(6):
        folder = tmp_path / str(round_number)
        folder.mkdir()
        writer = subprocess.Popen([sys.executable, "-c", WRITER, str(folder)], stdout=subprocess.PIPE)
        assert writer.stdout is not None
        with writer.stdout:
            writer.stdout.readline()
            time.sleep(0.01 + 0.013 * round_number)
            os.kill(writer.pid, signal.SIGKILL)
            writer.wait()
        for made in folder.glob("made-*"):
            assert {path.name: path.read_bytes() for path in made.iterdir()} == FILES
            seen += 1
    assert seen > 0
