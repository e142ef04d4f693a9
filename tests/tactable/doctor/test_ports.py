"""Ports and machines made up in a folder: who may open and speak to a port, what a machine allows, and the remedies."""

import grp
import os
import resource
from pathlib import Path

import pytest

from engine.loop.realtime import PRIORITY
from firmware_link.host.serial_port import PortDescription, permission_remedy
from tactable.doctor import Check
from tactable.doctor.ports import SystemFiles, check_machine, check_ports

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


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """A machine with two processors that save power, and cpu_dma_latency for its group only."""
    for number in (0, 1):
        folder = tmp_path / f"sys/devices/system/cpu/cpu{number}/cpufreq"
        folder.mkdir(parents=True)
        (folder / "scaling_governor").write_text("powersave\n")
    (tmp_path / "dev").mkdir()
    (tmp_path / "dev/cpu_dma_latency").touch()
    return tmp_path


def examine(machine: Path) -> dict[str, Check]:
    return {check.name: check for check in check_machine(SystemFiles(machine))}


def test_a_governor_that_saves_power_is_told_with_the_command_that_ends_it(machine: Path) -> None:
    check = examine(machine)["governor"]
    assert not check.passed
    assert "cpupower frequency-set -g performance" in check.remedy
    for path in (machine / "sys/devices/system/cpu").glob("*/cpufreq/scaling_governor"):
        path.write_text("performance\n")
    assert examine(machine)["governor"].passed


def test_an_unprivileged_user_is_told_of_rule_and_limits_if_needed(
    machine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (0, 0))
    assert examine(machine / "no")["processor sleep"].passed, "a kernel without the file has nothing to allow"
    checks = examine(machine)
    assert 'KERNEL=="cpu_dma_latency", GROUP="realtime"' in checks["processor sleep"].remedy
    for name in ("priority", "locked memory"):
        assert "@realtime - rtprio 80" in checks[name].remedy
        assert "limits.d/tactable.conf" in checks[name].remedy
    limits = {resource.RLIMIT_RTPRIO: PRIORITY, resource.RLIMIT_MEMLOCK: resource.RLIM_INFINITY}
    for lacks, passes in ((0, True), (1, False)):
        monkeypatch.setattr(resource, "getrlimit", lambda limit, lacks=lacks: (0, limits[limit] - lacks))
        assert [examine(machine)[name].passed for name in ("priority", "locked memory")] == [passes, passes]
