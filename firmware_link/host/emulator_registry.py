"""Registry of running emulators: each is a symbolic link to its port, under a name that stays the same.

A link is only ever made where nothing is, or where an emulator that was killed left one. Such a link leads to a
pseudo-terminal that is gone, or that its successor was given: the system gives a free number again. Any other file or
link belongs to somebody, and is refused by name.
"""

import contextlib
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

from firmware_link.protocol.link_errors import LinkError

_PREFIX = "emulator-"
_TERMINALS = "/dev/pts/"


@dataclass(frozen=True)
class Announced:
    """An emulator that runs: the link that stays the same, the port that it leads to now, and its process."""

    link: Path
    port: str
    process_id: int


class Announcement:
    """One emulator's link, from `point_to` until `close`; it may point again."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self._port: str | None = None
        if link.parent == runtime_folder():
            link.parent.mkdir(mode=0o700, parents=True, exist_ok=True)

    def point_to(self, port: str) -> None:
        """Lead to this port from now on. Raises LinkError where something else has the name or no link can be made."""
        if not self._is_ours():
            self._refuse_others(port)
        temporary = self.link.with_name(f".{self.link.name}.{os.getpid()}.link")
        try:
            temporary.symlink_to(port)
            temporary.replace(self.link)
        except OSError as error:
            raise LinkError(f"{self.link}: no link can be made: {error.strerror}; choose another place") from error
        self._port = port

    def close(self) -> None:
        """Remove the link, if it still is this emulator's."""
        if self._is_ours():
            self.link.unlink(missing_ok=True)

    def _is_ours(self) -> bool:
        return self._port is not None and self.link.is_symlink() and str(self.link.readlink()) == self._port

    def _refuse_others(self, port: str) -> None:
        target = str(self.link.readlink()) if self.link.is_symlink() else None
        # A killed emulator's terminal is gone, or its number is that of the terminal that this one was given.
        if target is not None and target.startswith(_TERMINALS) and (target == port or not self.link.exists()):
            return
        if target is not None or self.link.exists():
            what = "is no link to a port" if target is None else f"leads to {target}"
            raise LinkError(f"{self.link}: exists already and {what}; end the emulator that has it, or choose another")


def runtime_folder() -> Path:
    """Folder in which this user's emulators announce themselves."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        return Path(runtime) / "tactable"
    try:
        shared = tempfile.gettempdir()
    except FileNotFoundError:  # there is none that can be written: nothing is announced, and looking is no fault
        shared = "/tmp"
    return Path(shared) / f"tactable-{os.getuid()}"


def own_link(process_id: int) -> Path:
    """The link of an emulator by its process."""
    return runtime_folder() / f"{_PREFIX}{process_id}"


def find_announced() -> tuple[Announced, ...]:
    """Every emulator that runs, in the order of their links; links of processes that are gone are removed."""
    folder = runtime_folder()
    if not folder.is_dir() or folder.stat().st_uid != os.getuid():
        return ()
    found = []
    for link in sorted(folder.glob(f"{_PREFIX}*")):
        number = link.name.removeprefix(_PREFIX)
        if not (link.is_symlink() and number.isdecimal()):
            continue
        if _process_exists(int(number)):
            found.append(Announced(link, str(link.readlink()), int(number)))
        else:
            with contextlib.suppress(OSError):
                link.unlink()
    return tuple(found)


def _process_exists(process_id: int) -> bool:
    try:
        os.kill(process_id, 0)
    except (ProcessLookupError, PermissionError):  # no permission: a process of another user has the number now
        return False
    return True
