"""Laws of the control channel's Unix socket: only its user reaches it, and a live one is never taken."""

import fcntl
import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from base.child import ChildError
from tactable.control.control_process import listening_socket

pytestmark = pytest.mark.usefixtures("both_ends")


@pytest.fixture(autouse=True)
def _open_umask() -> Iterator[None]:
    """Whatever the user's own umask lets others do."""
    before = os.umask(0)
    yield
    assert os.umask(before) == 0  # it is as it was


def connects(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as program:
        try:
            program.connect(str(path))
        except OSError:
            return False
        return True


def test_only_its_user_reaches_it(tmp_path: Path) -> None:
    path = tmp_path / "run" / "c.sock"
    with listening_socket(path):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600 and stat.S_IMODE(path.parent.stat().st_mode) == 0o700
        assert connects(path)


def test_a_folder_of_another_user_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ChildError, match="belongs to another user"):
        listening_socket(tmp_path / "c.sock", lambda _: os.getuid() + 1)
    assert not [*tmp_path.iterdir()]
    for owner_id in (0, os.getuid()):
        with listening_socket(tmp_path / "c.sock", lambda _, owner_id=owner_id: owner_id):  # type: ignore[misc]
            pass


def test_a_live_socket_is_refused_and_goes_on_and_one_that_an_ended_run_left_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "c.sock"
    with listening_socket(path) as first:
        with pytest.raises(ChildError, match="another run listens there"):
            listening_socket(path)
        with socket.socket(socket.AF_UNIX) as program:
            program.connect(str(path))
            first.accept()[0].close()  # the first run hears it
    assert path.exists() and not connects(path)
    with listening_socket(path):
        assert connects(path)


def test_what_is_no_socket_stays_and_a_place_where_none_can_be_is_named(tmp_path: Path) -> None:
    path = tmp_path / "c.sock"
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(ChildError, match="no socket"):
        listening_socket(path)
    assert path.read_text(encoding="utf-8") == "mine"
    with pytest.raises(ChildError, match="no control socket can be made"):
        listening_socket(tmp_path / ("x" * 200))


def test_of_two_runs_that_begin_at_once_one_waits_until_the_other_has_its_socket(tmp_path: Path) -> None:
    """Else the second takes a left-over for the path that the first has just made, and removes it."""

    def owner_id_of(folder: Path) -> int:
        second = os.open(folder, os.O_RDONLY)
        with pytest.raises(BlockingIOError):
            fcntl.flock(second, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.close(second)
        return os.getuid()

    with listening_socket(tmp_path / "c.sock", owner_id_of):
        folder = os.open(tmp_path, os.O_RDONLY)
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.close(folder)
