"""Keeps the previous table when a new one takes its place, and puts it back on request."""

import os
import shutil
from pathlib import Path

from base.files import partial_path, remove_partials, rename_durably, written_path
from engine.table.schema import TableError


def previous_of(path: Path) -> Path:
    """Path of the table that the one at `path` replaced, beside the file itself. Raises TableError for a folder."""
    target = written_path(path)
    if target.is_dir():
        raise TableError(f"{path}: is a folder; name a table")
    return target.with_name(f"{target.name}.previous")


def replace_table(new: Path, path: Path, *, keep: bool = True) -> None:
    """Put a finished file in the place of a table; at every instant there is a whole table at `path`.

    That table is kept as the previous one; not without `keep`, for a table that only completes it.
    """
    if keep and path.exists():
        newer = partial_path(path, "newer")
        _copy(path, newer)
        _rename(newer, previous_of(path))
    _rename(new, path)


def roll_back(path: Path) -> None:
    """Put the previous table back; the one that was there becomes the previous one, so twice is as before.

    Raises TableError where there is no previous table. The caller verifies it first.
    """
    path, previous = written_path(path), previous_of(path)
    if not previous.is_file():
        raise TableError(f"{previous}: there is no previous table; `tactable build` keeps one when it replaces another")
    remove_leftovers(path)
    older = partial_path(path, "older")
    _copy(previous, older)
    if path.exists():
        newer = partial_path(path, "newer")
        _copy(path, newer)
        _rename(older, path)
        _rename(newer, previous)
    else:
        _rename(older, path)


def remove_leftovers(path: Path) -> None:
    """Remove what killed processes left beside a table."""
    remove_partials(path, ("partial", "older", "newer"))


def _rename(name: Path, path: Path) -> None:
    """Also where both are names of one file already: then the system would leave them both."""
    rename_durably(name, path)
    name.unlink(missing_ok=True)


def _copy(path: Path, copy: Path) -> None:
    """A second name for the same bytes; where the file system has none, a copy."""
    copy.unlink(missing_ok=True)
    try:
        os.link(path, copy)
    except OSError:
        shutil.copyfile(path, copy)
