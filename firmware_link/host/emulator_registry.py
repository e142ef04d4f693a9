"""Registry of running emulators: each is a symbolic link to its port, under a name that stays the same."""

import contextlib
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

_PREFIX = "emulator-"


@dataclass(frozen=True)
class Announced:
    """An emulator that runs: the link that stays the same, the port that it leads to now, and its process."""

    link: Path
    port: str
    process_id: int


class Announcement:
    """One emulator's link, until `close`."""

    def __init__(self, link: Path) -> None:
        self.link = link
        link.parent.mkdir(mode=0o700, parents=True, exist_ok=True)

    def point_to(self, port: str) -> None:
        """Lead to this port from now on; the link is replaced, so that it always leads somewhere."""
        temporary = self.link.with_name(f".{self.link.name}")
        temporary.unlink(missing_ok=True)
        temporary.symlink_to(port)
        temporary.replace(self.link)

    def close(self) -> None:
        """Remove the link."""
        self.link.unlink(missing_ok=True)


def runtime_folder() -> Path:
    """Where this user's emulators announce themselves."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return Path(runtime) / "tactable" if runtime else Path(tempfile.gettempdir()) / f"tactable-{os.getuid()}"


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
