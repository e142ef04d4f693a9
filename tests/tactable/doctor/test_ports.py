"""Serial ports of machines made up in a folder: who may open them, who speaks to them, how long they collect bytes."""

import grp
import os
from pathlib import Path

import pytest

from firmware_link.host.serial_port import PortDescription, permission_remedy
from tactable.doctor.ports import SystemFiles, check_ports

USB = PortDescription("ttyUSB0", "bar-1", "bar driver", 0x0403, 0x6001)


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One FTDI port, on a USB device of two interfaces, and ModemManager."""
    usb = tmp_path / "sys/devices/usb1/1-2"
    port = usb / "1-2:1.0" / "ttyUSB0"
    tty = port / "tty" / "ttyUSB0"
    tty.mkdir(parents=True)
    (tty / "device").symlink_to(port)
    (tty / "dev").write_text("188:0\n")
    (usb / "dev").write_text("189:5\n")
    (port / "latency_timer").write_text("16\n")
    folder = tmp_path / "sys/class/tty"
    folder.mkdir(parents=True)
    (folder / "ttyUSB0").symlink_to(tty)
    for number, name in ((1, "init"), (42, "ModemManager")):
        (tmp_path / "proc" / str(number)).mkdir(parents=True)
        (tmp_path / "proc" / str(number) / "comm").write_text(f"{name}\n")
    (tmp_path / "run/udev/data").mkdir(parents=True)
    (tmp_path / "ttyUSB0").touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_modem_manager_is_told_of_with_the_command_that_keeps_it_off(root: Path) -> None:
    port, manager = check_ports([USB], SystemFiles(root))
    assert port.passed
    assert port.finding == "bar driver, latency timer 16 ms (a run sets 1 ms)"
    assert not manager.passed
    assert "tactable doctor --emit-udev bar-1" in manager.remedy


@pytest.mark.parametrize("record", ["c188:0", "c189:5"])
def test_a_rule_on_the_port_or_on_its_device_keeps_modem_manager_off(root: Path, record: str) -> None:
    (root / "run/udev/data" / record).write_text("I:123\nE:ID_MM_DEVICE_IGNORE=1\n")
    assert [check.passed for check in check_ports([USB], SystemFiles(root))] == [True, True]


def test_the_remedy_names_the_group_that_the_port_has(tmp_path: Path) -> None:
    port = tmp_path / "ttyACM0"
    port.touch()
    group = next(group for group in grp.getgrall() if group.gr_name not in ("root", "dialout"))
    os.chown(port, -1, group.gr_gid)
    port.chmod(0o660)
    assert f"usermod -aG {group.gr_name} " in permission_remedy(str(port))
    port.chmod(0o600)
    assert "usermod" not in permission_remedy(str(port))
    assert 'KERNEL=="ttyACM0"' in permission_remedy(str(port))
