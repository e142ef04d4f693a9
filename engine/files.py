"""Replace a file atomically: its path holds the old content or the new one at every instant, also after a crash.

The new content is written beside the target and flushed to the disk, renamed over the target, and then the folder is
flushed: without the last step a power failure may undo a rename that a later write already relies on.
"""

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path


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
