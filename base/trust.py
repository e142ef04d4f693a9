"""Whether other users can change what is read at a path, asked before code is loaded or a secret is believed from it.

Machine code and pickles run as the user that loads them, so whoever can write them, or replace a folder on the way to
them, can run code as that user. A path is trusted if each folder, link and file on the way belongs to this user or to
root and is writable by nobody else. Two folders that others can write are allowed: a sticky one such as /tmp, on the
way only, where nobody replaces what belongs to somebody else; and one of the user's own private group, which Debian's
sshd trusts as well, since some systems give it to every new folder.
"""

import grp
import os
import pwd
import stat
from pathlib import Path

REMEDY = "other users can change {}; make it yours alone (chmod go-w), or name another folder"
_MOST_LINKS = 40  # as many as Linux follows on one way


def open_to_others(path: Path, user_id: int | None = None) -> Path | None:
    """The first part of the way to `path`, links followed, that lets other users change what is read there.

    None where none does. What is missing counts as trusted, since this user makes it. Raises OSError where a part
    cannot be looked at.
    """
    user_id = os.getuid() if user_id is None else user_id
    at, waiting, links = Path("/"), list(reversed(path.absolute().parts[1:])), 0
    while True:
        try:
            status = at.lstat()
        except FileNotFoundError:
            return None
        is_link = stat.S_ISLNK(status.st_mode)
        if links > _MOST_LINKS or not _is_trusted(status, user_id, is_way=bool(waiting)):
            return at
        if is_link:
            target, links = at.readlink(), links + 1
            waiting += reversed(target.parts[1:] if target.is_absolute() else target.parts)
            at = Path("/") if target.is_absolute() else at.parent
        elif not waiting:
            return None
        part = waiting.pop() if waiting else "."
        at = at.parent if part == ".." else at / part


def _is_trusted(status: os.stat_result, user_id: int, *, is_way: bool) -> bool:
    if status.st_uid not in (0, user_id):
        return False
    if stat.S_ISLNK(status.st_mode) or not status.st_mode & 0o022:
        return True
    if is_way and status.st_mode & stat.S_ISVTX:
        return True
    return not status.st_mode & 0o002 and _is_private_group(status.st_gid, user_id)


def _is_private_group(group_id: int, user_id: int) -> bool:
    """Whether the group has its user's name, and no member but this user."""
    try:
        group, user = grp.getgrgid(group_id), pwd.getpwuid(user_id).pw_name
    except KeyError:  # a number without a name
        return False
    return group.gr_name == user and set(group.gr_mem) <= {user}
