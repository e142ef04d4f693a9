"""The Unix socket of the control channel: only its user reaches it, and that of a run that lives is never taken."""

import fcntl
import os
import socket
import stat
from collections.abc import Callable
from pathlib import Path

from base.child import ChildError

_OPTION = "choose another place with --control-socket"


def listening_socket(path: Path, owner_id_of: Callable[[Path], int] = lambda path: path.stat().st_uid) -> socket.socket:
    """A Unix socket that only its user reaches, in place of one that an ended run left. Raises ChildError."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        # Of two runs that begin at once neither takes a socket that the other one has just made.
        fcntl.flock(folder, fcntl.LOCK_EX)
        if owner_id_of(path.parent) not in (0, os.getuid()):
            raise ChildError(f"{path.parent}: belongs to another user: {_OPTION}")
        _remove_left_over(path)
        return _bound(path)
    finally:
        os.close(folder)


def _remove_left_over(path: Path) -> None:
    """Remove the socket of an ended run. Raises ChildError where a run still listens, or the file is no socket."""
    if not path.exists():
        return
    if not stat.S_ISSOCK(path.stat().st_mode):
        raise ChildError(f"{path}: is no socket: {_OPTION}")
    with socket.socket(socket.AF_UNIX) as other:
        try:
            other.connect(str(path))
        except OSError:
            path.unlink()
        else:
            raise ChildError(f"{path}: another run listens there: {_OPTION}")


def _bound(path: Path) -> socket.socket:
    listening = socket.socket(socket.AF_UNIX)
    before = os.umask(0o177)
    try:
        listening.bind(str(path))
    except OSError as error:
        listening.close()
        raise ChildError(f"{path}: no control socket can be made there ({error}): {_OPTION}") from error
    finally:
        os.umask(before)
    listening.listen()
    return listening
