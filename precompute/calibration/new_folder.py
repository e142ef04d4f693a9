"""Files to a folder that appears whole or not at all, and never in the place of another."""

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from engine.files import sync
from precompute.measurements.error import CalibrationError


class FolderError(CalibrationError):
    """A folder that cannot be made; the message names it and what would do."""


def check_new_folder(folder: Path) -> None:
    """Raise FolderError where `folder` is there already or its parent is not."""
    if folder.exists() or folder.is_symlink():
        raise FolderError(f"{folder}: is there already and is not overwritten; choose another output")
    if not folder.absolute().parent.is_dir():
        raise FolderError(f"{folder.parent}: no such folder; create it or choose another output")


def write_new_folder(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write the files beside `folder`, to the disk, and rename them there in one step.

    Killed at any instant it leaves the whole folder or none; a left-over .NAME.*.partial beside it means nothing.
    Raises FolderError.
    """
    check_new_folder(folder)
    parent = folder.absolute().parent
    partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".partial", dir=parent))
    try:
        for name, content in files.items():
            (partial / name).write_bytes(content)
            sync(partial / name)
        partial.chmod(0o755)  # mkdtemp's is for the owner alone
        sync(partial)
        try:
            partial.rename(folder)
        except OSError as error:
            raise FolderError(f"{folder}: is there already and is not overwritten; choose another output") from error
        sync(parent)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
