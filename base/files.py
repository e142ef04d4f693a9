"""Write files and folders atomically: a path holds the old content or the new one at every instant, also after a crash.

The new content is written beside the target and flushed to the disk, renamed over the target, and then the folder is
flushed: without the last step a power failure may undo a rename that a later write already relies on. A symbolic link
is written through: the file that it leads to is replaced, and the link stays. Devices and pipes are never replaced.

Temporary folders are removed with their process, and by the next one where it was killed. A process holds a lock
(flock) on its folder. The system lets go of that lock however the process ends, so a folder that somebody else can lock
is abandoned. Process numbers would not tell: they are given again, and containers may share /dev/shm without sharing
numbers.
"""

import contextlib
import fcntl
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from base.errors import TactableError

MEMORY = Path("/dev/shm")  # where Linux keeps files in memory
_PREFIX = "tactable-work-"


class FolderError(TactableError):
    """A folder cannot be made; the message names it and the remedy."""


class WriteError(TactableError, OSError):
    """A file cannot be written; the message names it, why, and the remedy."""


@contextlib.contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Yield a path beside `path` to write the new content to; it replaces `path` when the block ends without error.

    An exception leaves the old file and nothing else. A killed process leaves the old file and its partial one, which
    the next writer of the same file deletes. The permissions of a file that is replaced are kept. Raises WriteError,
    also for an OSError of the block.
    """
    target = written_path(path)
    if target.exists() and not target.is_file():
        raise WriteError(f"{path}: is not a plain file, and is not replaced; choose another output")
    partial = partial_path(target)
    remove_partials(target)
    try:
        yield partial
        if target.exists():
            shutil.copymode(target, partial)
        rename_durably(partial, target)
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        with contextlib.suppress(OSError):  # in a folder that cannot be reached there is none
            partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Replace a file by one of this text. Raises as `replace_file`."""
    with replace_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def shipped(package: Path, name: str) -> Path:
    """A file or folder of data: inside an installed package, in tables/ of a checkout."""
    installed = package / name
    return installed if installed.exists() else Path(__file__).parents[1] / "tables" / name


def check_folder_of(path: Path) -> None:
    """Raise FolderError where a file cannot be made for want of its folder, before work is done for it."""
    if not path.parent.is_dir():
        raise FolderError(f"{path.parent}: no such folder; create it or choose another output")


def unwritable(path: Path, error: OSError) -> WriteError:
    """The error of a file that the system does not let us write."""
    return WriteError(
        f"{path}: cannot be written there: {error.strerror or error}; make room, see to the permissions or choose "
        "another output"
    )


def written_path(path: Path) -> Path:
    """The file that is written for `path`: where a symbolic link leads, else `path` itself."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def rename_durably(partial: Path, path: Path) -> None:
    """Flush `partial`, rename it over `path` in the same folder and flush the folder; both are on the disk then."""
    sync(partial)
    partial.replace(path)
    sync(path.parent)


def check_new_folder(folder: Path) -> None:
    """Raise FolderError where `folder` exists already or its parent does not."""
    if folder.exists() or folder.is_symlink():
        raise FolderError(f"{folder}: exists already and is not overwritten; choose another output")
    check_folder_of(folder.absolute())


def write_new_folder(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write the files beside `folder`, flush them, and rename their folder in one step.

    A killed process leaves the whole folder or none, and perhaps a partial one beside it, which the next writer of the
    same folder deletes. Raises FolderError, and WriteError where there is no room or no permission.
    """
    check_new_folder(folder)
    parent, partial = folder.absolute().parent, partial_path(folder.absolute())
    remove_partials(folder.absolute())
    shutil.rmtree(partial, ignore_errors=True)  # of a killed process that had the number of this one
    try:
        partial.mkdir()
    except OSError as error:
        raise unwritable(folder, error) from error
    try:
        for name, content in files.items():
            (partial / name).write_bytes(content)
            sync(partial / name)
        sync(partial)
        try:
            partial.rename(folder)
        except OSError as error:
            raise FolderError(f"{folder}: exists already and is not overwritten; choose another output") from error
        sync(parent)
    except OSError as error:
        raise unwritable(folder, error) from error
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
    if not path.name:
        raise WriteError(f"{path}: is a folder; give the name of a file in it")
    return path.with_name(f".{path.name}.{os.getpid()}.{kind}")


def remove_partials(path: Path, kinds: tuple[str, ...] = ("partial",)) -> None:
    """Delete the partial files and folders that processes left beside `path` when they were killed."""
    _remove_partials(path.parent, re.escape(path.name), kinds)


def remove_all_partials(folder: Path) -> None:
    """Delete what killed processes left half in a folder that only this user's commands write to, such as a cache."""
    _remove_partials(folder, ".+", ("partial", "older", "newer"))


def _remove_partials(folder: Path, name: str, kinds: tuple[str, ...]) -> None:
    pattern = re.compile(rf"\.{name}\.(\d+)\.({'|'.join(kinds)})")
    with contextlib.suppress(OSError):  # a folder that is not there or cannot be read holds nothing of ours
        for partial in list(folder.iterdir()):
            found = pattern.fullmatch(partial.name)
            if found is None or _is_alive(int(found[1])):
                continue
            if partial.is_dir() and not partial.is_symlink():
                shutil.rmtree(partial, ignore_errors=True)
            else:
                partial.unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # it belongs to another user
        return True
    return True


def identity_of(path: Path) -> tuple[int, int, int]:
    """Inode, modification time and size: another file has another identity. Raises OSError."""
    status = path.stat()
    return status.st_ino, status.st_mtime_ns, status.st_size


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
