"""Write files and folders atomically: a path holds the old content or the new one at every instant, also after a crash.

The new content is written beside the target and flushed to the disk, renamed over the target, and then the folder is
flushed: without the last step a power failure may undo a rename that a later write already relies on.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from firmware_link.protocol.errors import TactableError


class FolderError(TactableError):
    """A folder cannot be made; the message names it and the remedy."""


@contextlib.contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Yield a path beside `path` to write the new content to; it replaces `path` when the block ends without error.

    An exception leaves the old file and nothing else. A killed process leaves the old file and its partial one, which
    `remove_partials` deletes. The permissions of a file that is replaced are kept. Raises OSError.
    """
    partial = partial_path(path)
    try:
        yield partial
        if path.exists():
            shutil.copymode(path, partial)
        rename_durably(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def rename_durably(partial: Path, path: Path) -> None:
    """Flush `partial`, rename it over `path` in the same folder and flush the folder; both are on the disk then."""
    sync(partial)
    partial.replace(path)
    sync(path.parent)


def check_new_folder(folder: Path) -> None:
    """Raise FolderError where `folder` exists already or its parent does not."""
    if folder.exists() or folder.is_symlink():
        raise FolderError(f"{folder}: exists already and is not overwritten; choose another output")
    if not folder.absolute().parent.is_dir():
        raise FolderError(f"{folder.parent}: no such folder; create it or choose another output")


def write_new_folder(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write the files beside `folder`, flush them, and rename their folder in one step.

    A killed process leaves the whole folder or none; a folder .NAME.*.partial that it leaves beside it has no meaning.
    Raises FolderError.
    """
    check_new_folder(folder)
    parent = folder.absolute().parent
    partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".partial", dir=parent))
    try:
        for name, content in files.items():
            (partial / name).write_bytes(content)
            sync(partial / name)
        partial.chmod(0o755)  # mkdtemp makes it readable for its owner only
        sync(partial)
        try:
            partial.rename(folder)
        except OSError as error:
            raise FolderError(f"{folder}: exists already and is not overwritten; choose another output") from error
        sync(parent)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def sync(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def partial_path(path: Path, kind: str = "partial") -> Path:
    """A hidden name beside `path` that no other process uses."""
    return path.with_name(f".{path.name}.{os.getpid()}.{kind}")


def remove_partials(path: Path, kinds: tuple[str, ...] = ("partial",)) -> None:
    """Delete the partial files that processes left beside `path` when they were killed."""
    for partial in path.parent.glob(f".{path.name}.*.*"):
        process, _, kind = partial.name.removeprefix(f".{path.name}.").partition(".")
        if kind in kinds and process.isdigit() and not _is_alive(int(process)):
            partial.unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # it belongs to another user
        return True
    return True
