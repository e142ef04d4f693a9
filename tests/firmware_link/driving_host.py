"""A host process that drives, and then fails as it is told: `python -m tests.firmware_link.driving_host PORT HOW`."""

import contextlib
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkConfiguration, LinkState
from firmware_link.host.serial_port import SerialPort
from firmware_link.host.session import Session
from firmware_link.protocol.drive_words import ChannelDrive, encode_drive
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import DeviceState

LEASE_MS = 40
SLEW_PER_S = 200
PATIENCE_S = 60.0
RENEWALS = 8
DRIVING = "driving"
ENDED = "ended"
RESOLUTION_HZ = 0.01
Process = subprocess.Popen[str]


@contextlib.contextmanager
def host_process(port: str, how: str, *before: str) -> Iterator[tuple[Process, bool]]:
    """Such a process, and whether it drives; otherwise it has ended."""
    command = [*before, sys.executable, "-m", "tests.firmware_link.driving_host", port, how]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=Path(__file__).parents[2], stdin=pipe, stdout=pipe, text=True) as process:
        try:
            assert process.stdout is not None
            yield process, process.stdout.readline().strip() == DRIVING
        finally:
            process.kill()


def strike(process: Process, how: str) -> None:
    """Make it fail."""
    if how == "killed":
        process.kill()
    elif how == "stopped":
        process.send_signal(signal.SIGSTOP)
    else:
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it stalled and has ended by itself, which is a failure too
            process.stdin.write("\n")
            process.stdin.flush()


def main() -> None:
    """Say DRIVING once the device drives; fail at the first word on standard input; say ENDED with the session."""
    path, how = sys.argv[1:]
    configuration = LinkConfiguration(
        2, slew_limit_per_s=SLEW_PER_S, lease_ms=LEASE_MS, bit_rate_hz=2_000_000, handshake_timeout_s=PATIENCE_S
    )
    with SerialPort(path) as port:
        session = Session(Link(configuration), port, time.monotonic_ns)
        session.connect()
        try:
            serve(session, how)
        except LinkError as error:
            print(f"{ENDED}: {error}", flush=True)  # noqa: T201  # the parent reads it


def serve(session: Session, how: str) -> None:
    """Drive until the link has ended or the failure is due."""
    link, drive, is_told = session.link, encode_drive([ChannelDrive(200, 1.0)] * 2, RESOLUTION_HZ), False
    while link.state not in (LinkState.STOPPED, LinkState.DISCONNECTED):
        session.exchange()
        if link.state is LinkState.READY and link.drive_sequence is None:
            link.set_drive(drive)
        status = link.status
        # Renewed some times: the amplitude has risen long ago.
        if not is_told and status and status.state is DeviceState.DRIVING and status.applied > RENEWALS:
            is_told = True
            print(DRIVING, flush=True)  # noqa: T201  # the parent reads it
        ready, _, _ = select.select([session.port, sys.stdin], [], [], 0.002)
        if sys.stdin in ready:
            fail(how)
    print(f"{ENDED}: {link.state.value}", flush=True)  # noqa: T201  # the parent reads it


def fail(how: str) -> None:
    """Stop working, the process alive."""
    if how == "loop":
        while True:
            pass
    time.sleep(PATIENCE_S)


if __name__ == "__main__":
    main()
