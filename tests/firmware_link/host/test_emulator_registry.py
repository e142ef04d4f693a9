"""Laws of the announcements: a running emulator is found, one that is gone is not, and its link goes."""

import os
from pathlib import Path

import pytest

from firmware_link.host.emulator_registry import Announced, Announcement, find_announced, own_link, runtime_folder
from firmware_link.host.serial_port import find_ports, path_of
from firmware_link.protocol.link_errors import LinkError
from tests.tools.processes import NO_PROCESS


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def test_a_running_emulator_is_a_port_marked_simulated_by_a_name_that_stays() -> None:
    announcement = Announcement(own_link(os.getpid()))
    for port in ("/dev/null", "/dev/zero"):
        announcement.point_to(port)
        assert find_announced() == (Announced(announcement.link, port, os.getpid()),)
        (found,) = (port for port in find_ports() if port.stable_id == str(announcement.link))
        assert "SIMULATED" in found.description
        assert found.path == path_of(str(announcement.link)) == port
    announcement.close()
    assert find_announced() == ()


def test_what_a_killed_emulator_left_is_removed_and_what_is_no_announcement_is_left_alone() -> None:
    Announcement(own_link(NO_PROCESS)).point_to("/dev/null")
    folder = runtime_folder()
    (folder / "emulator-x").symlink_to("/dev/null")
    (folder / "emulator-1234567").write_text("a file")
    assert find_announced() == ()
    assert {path.name for path in folder.iterdir()} == {"emulator-x", "emulator-1234567"}


@pytest.mark.parametrize("target", ["/dev/null", "elsewhere", "/dev/pts"])
def test_a_link_of_somebody_else_stays_and_is_refused_as_is_an_absent_folder(tmp_path: Path, target: str) -> None:
    """Of a user, or of another emulator whose terminal is there."""
    link = tmp_path / "board"
    link.symlink_to(target)
    with pytest.raises(LinkError, match="board: no link can be made: No such file or directory"):
        Announcement(tmp_path / "no" / "board").point_to("/dev/null")
    announcement = Announcement(link)
    with pytest.raises(LinkError, match=f"board: exists already and leads to {target}; end the emulator"):
        announcement.point_to("/dev/zero")
    announcement.close()
    assert [(path.name, str(path.readlink())) for path in tmp_path.iterdir()] == [("board", target)]


def test_the_link_of_a_killed_emulator_is_taken_over_and_only_once(tmp_path: Path) -> None:
    link = tmp_path / "board"
    (tmp_path / ".board").write_text("mine")
    link.symlink_to("/dev/pts/987654")
    first, second = Announcement(link), Announcement(link)
    first.point_to("/dev/null")
    with pytest.raises(LinkError):
        second.point_to("/dev/zero")
    second.close()
    assert str(link.readlink()) == "/dev/null"
    first.point_to("/dev/zero")  # plugged in again
    first.close()
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(".board", "mine")]
