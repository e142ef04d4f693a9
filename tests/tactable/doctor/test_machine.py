"""What a machine made up in a folder allows, and what the doctor says to that."""

import os
import resource
from pathlib import Path

import pytest

from engine.loop.realtime import PRIORITY
from tactable.doctor.check import Check
from tactable.doctor.machine import check_machine
from tactable.doctor.ports import SystemFiles


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A machine with two processors that save power, and cpu_dma_latency for its group only."""
    for number in (0, 1):
        folder = tmp_path / f"sys/devices/system/cpu/cpu{number}/cpufreq"
        folder.mkdir(parents=True)
        (folder / "scaling_governor").write_text("powersave\n")
    (tmp_path / "dev").mkdir()
    (tmp_path / "dev/cpu_dma_latency").touch()
    return tmp_path


def examine(root: Path) -> dict[str, Check]:
    return {check.name: check for check in check_machine(SystemFiles(root))}


def test_a_governor_that_saves_power_is_told_with_the_command_that_ends_it(root: Path) -> None:
    check = examine(root)["governor"]
    assert not check.passed
    assert "cpupower frequency-set -g performance" in check.remedy
    for path in (root / "sys/devices/system/cpu").glob("*/cpufreq/scaling_governor"):
        path.write_text("performance\n")
    assert examine(root)["governor"].passed


def test_an_unprivileged_user_is_told_of_rule_and_limits_if_needed(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (0, 0))
    assert examine(root / "no")["processor sleep"].passed, "a kernel without the file has nothing to allow"
    checks = examine(root)
    assert 'KERNEL=="cpu_dma_latency", GROUP="realtime"' in checks["processor sleep"].remedy
    for name in ("priority", "locked memory"):
        assert "@realtime - rtprio 80" in checks[name].remedy
        assert "limits.d/tactable.conf" in checks[name].remedy
    limits = {resource.RLIMIT_RTPRIO: PRIORITY, resource.RLIMIT_MEMLOCK: resource.RLIM_INFINITY}
    for lacks, passes in ((0, True), (1, False)):
        monkeypatch.setattr(resource, "getrlimit", lambda limit, lacks=lacks: (0, limits[limit] - lacks))
        assert [examine(root)[name].passed for name in ("priority", "locked memory")] == [passes, passes]
