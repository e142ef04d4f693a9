"""Real processes: the system lets go of the port of a host that is killed, and a stopped one keeps it and is silent."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from firmware_link.emulator import Cause
from firmware_link.emulator.process import EmulatorLog, RunningEmulator, run_emulator
from tests.firmware_link.driving_host import DRIVING, LEASE_MS

ROOT = Path(__file__).parents[3]


@contextmanager
def driving_host(emulator: RunningEmulator) -> Iterator["subprocess.Popen[str]"]:
    """A process that drives."""
    command = [sys.executable, "-m", "tests.firmware_link.driving_host", emulator.port, "killed"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, text=True) as process:
        try:
            assert process.stdout is not None and process.stdout.readline().strip() == DRIVING
            yield process
        finally:
            process.kill()


def log_when_over(emulator: RunningEmulator) -> EmulatorLog:
    while (log := emulator.log()).events[-1].cause is Cause.SET:
        time.sleep(0.005)
    return log


@pytest.mark.machine
@pytest.mark.parametrize(
    ("blow", "cause"),
    [(signal.SIGKILL, Cause.HUNG_UP), (signal.SIGSTOP, Cause.LEASE_EXPIRED)],
    ids=["killed", "stopped"],
)
def test_a_host_that_fails_leaves_no_drive(blow: signal.Signals, cause: Cause) -> None:
    with run_emulator() as emulator, driving_host(emulator) as host:
        os.kill(host.pid, blow)
        log = log_when_over(emulator)
        last_us = max(frame.device_time_us for frame in log.received if frame.message == "SET")
        assert log.events[-1].cause is cause
        assert log.events[-1].device_time_us <= last_us + 1_000 * LEASE_MS
