"""Laws of replacing a file."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from engine.files import partial_path, remove_partials, replace_file


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_the_new_content_is_in_place_and_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    for text in ("old", "new"):
        with replace_file(path) as partial:
            partial.write_text(text)
        assert path.read_text() == text
    assert names(tmp_path) == {"report.json"}


def test_an_exception_leaves_the_old_file_and_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError), replace_file(path) as partial:
        partial.write_text("half")
        raise ZeroDivisionError
    assert (path.read_text(), names(tmp_path)) == ("old", {"report.json"})


def test_a_crash_before_the_rename_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    path.write_text("old")
    crash = (
        "import os, sys; from pathlib import Path; from engine.files import replace_file\n"
        "with replace_file(Path(sys.argv[1])) as partial: partial.write_text('half'); os._exit(9)"
    )
    assert subprocess.run([sys.executable, "-c", crash, str(path)], check=False).returncode == 9
    assert path.read_text() == "old"
    assert len(names(tmp_path)) == 2
    remove_partials(path)
    assert names(tmp_path) == {"report.json"}


def test_partial_files_of_living_processes_stay(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    partial_path(path).write_text("being written")
    remove_partials(path)
    assert names(tmp_path) == {partial_path(path).name}


def test_the_file_is_flushed_before_the_rename_and_the_folder_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, flushed = tmp_path / "report.json", list[tuple[str, bool]]()
    flush = os.fsync

    def record(descriptor: int) -> None:
        kind = "folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file"
        flushed.append((kind, path.exists()))
        flush(descriptor)

    monkeypatch.setattr(os, "fsync", record)
    with replace_file(path) as partial:
        partial.write_text("new")
    assert flushed == [("file", False), ("folder", True)]


@pytest.mark.parametrize("mode", [0o600, 0o664, 0o755])
def test_permissions_are_kept(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "report.json"
    path.write_text("old")
    path.chmod(mode)
    with replace_file(path) as partial:
        partial.write_text("new")
    assert stat.S_IMODE(path.stat().st_mode) == mode
