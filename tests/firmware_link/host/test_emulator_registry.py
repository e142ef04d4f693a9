"""Laws of the announcements: a running emulator is found, one that is gone is not, and its link goes."""

import subprocess
import sys
from pathlib import Path

import pytest

from firmware_link.host.emulator_registry import Announced, Announcement, find_announced, own_link, runtime_folder
from firmware_link.host.serial_port import find_ports, path_of


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def running_process() -> "subprocess.Popen[bytes]":
    return subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)


def test_a_running_emulator_is_a_port_marked_simulated_by_a_name_that_stays() -> None:
    with running_process() as process:
        announcement = Announcement(own_link(process.pid))
        for port in ("/dev/null", "/dev/zero"):
            announcement.point_to(port)
            assert find_announced() == (Announced(announcement.link, port, process.pid),)
            (found,) = (port for port in find_ports() if port.stable_id == str(announcement.link))
            assert "SIMULATED" in found.description
            assert found.path == path_of(str(announcement.link)) == port
        announcement.close()
        assert find_announced() == ()
        process.communicate(b"\n")


def test_what_a_killed_emulator_left_is_removed() -> None:
    with running_process() as process:
        announcement = Announcement(own_link(process.pid))
        announcement.point_to("/dev/null")
        process.kill()
    assert find_announced() == ()
    assert not announcement.link.is_symlink()


def test_what_is_no_announcement_is_left_alone() -> None:
    folder = runtime_folder()
    folder.mkdir()
    (folder / "emulator-x").symlink_to("/dev/null")
    (folder / "emulator-1234567").write_text("a file")
    assert find_announced() == ()
    assert len(list(folder.iterdir())) == 2


def test_without_a_runtime_folder_the_temporary_one_serves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert runtime_folder().name.startswith("tactable-")
