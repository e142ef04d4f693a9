"""Laws of a new folder: whole or not there, never in the place of another, whenever the writer is killed."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from base import files
from base.files import FolderError, write_new_folder

FILES = {name: name.encode() * 10_000 for name in ("one.txt", "two.txt", "three.txt")}


@pytest.mark.parametrize("kind", ["folder", "empty folder", "file", "dangling link"])
def test_what_is_there_is_never_overwritten_and_no_parent_is_made(kind: str, tmp_path: Path) -> None:
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
    with pytest.raises(FolderError, match="nowhere: no such folder"):
        write_new_folder(tmp_path / "nowhere" / "new", FILES)
    assert [path.name for path in tmp_path.iterdir()] == ["old"]


def test_at_every_instant_the_folder_is_whole_or_not_there(tmp_path: Path) -> None:
    """What a killed writer leaves is what there is between two of its lines."""
    folder, seen = tmp_path / "new", list[dict[str, bytes] | None]()

    def look(*_: object) -> Callable[..., Any]:
        is_there = os.path.lexists(folder)
        seen.append({path.name: path.read_bytes() for path in folder.iterdir()} if is_there else None)
        return look

    def trace(frame: FrameType, *_: object) -> Callable[..., Any] | None:
        return look if frame.f_code.co_filename == files.__file__ else None

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        write_new_folder(folder, FILES)
    finally:
        sys.settrace(before)
    assert seen == sorted(seen, key=bool) and seen.count(FILES) > 3 and seen.count(None) > 20
    assert all(each in (None, FILES) for each in seen)
