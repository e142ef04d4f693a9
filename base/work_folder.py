"""Temporary folders of a process: removed with it, and by the next one where it was killed.

A process holds a lock (flock) on its folder. The system lets go of that lock however the process ends, so a folder that
somebody else can lock is abandoned. Process numbers would not tell: they are given again, and containers may share
/dev/shm without sharing numbers.
"""

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

MEMORY = Path("/dev/shm")  # where Linux keeps files in memory
_PREFIX = "tactable-work-"


@contextlib.contextmanager
def work_folder(purpose: str, *, in_memory: bool = False) -> Iterator[Path]:
    """A new folder for the length of a `with` block, whose name tells its purpose; it is only its user's.

    With `in_memory` it lies in /dev/shm where there is one. Abandoned folders of this user are removed before.
    """
    disk = Path(tempfile.gettempdir())
    for parent in {disk, MEMORY}:
        remove_abandoned(parent)
    parent = MEMORY if in_memory and MEMORY.is_dir() else disk
    folder, lock = _locked(parent, f"{_PREFIX}{purpose}-")
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def remove_abandoned(parent: Path) -> None:
    """Remove the work folders in `parent` whose processes are gone."""
    for folder in parent.glob(f"{_PREFIX}*"):
        # An OSError: its process lives, it is another user's, another process removes it, or nothing can be locked.
        with contextlib.suppress(OSError):
            lock = _opened(folder)
            try:
                if os.fstat(lock).st_uid == os.getuid():
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(lock)


def _locked(parent: Path, prefix: str) -> tuple[Path, int]:
    """A new folder and the descriptor that locks it."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        # An OSError where it was taken for abandoned before it was locked; then another one is made.
        with contextlib.suppress(FileNotFoundError):
            lock = _opened(folder)
            with contextlib.suppress(OSError):  # some network file systems lock no folders; none is abandoned there
                fcntl.flock(lock, fcntl.LOCK_EX)
            if folder.is_dir():
                return folder, lock
            os.close(lock)


def _opened(folder: Path) -> int:
    """A descriptor that no other program inherits."""
    return os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
