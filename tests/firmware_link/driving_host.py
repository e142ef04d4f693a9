"""A host process that drives until it is killed or stopped: `python -m tests.firmware_link.driving_host PORT`."""

import select
import sys
import time

from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkConfiguration, LinkState
from firmware_link.host.serial_port import SerialPort
from firmware_link.host.session import Session
from firmware_link.protocol.messages import ChannelDrive, DeviceState, encode_drive

LEASE_MS = 40
DRIVING = "driving"


def main() -> None:
    """Say DRIVING once the device drives."""
    configuration = LinkConfiguration(2, lease_ms=LEASE_MS, bit_rate_hz=2_000_000, handshake_timeout_s=60.0)
    drive, is_told = encode_drive([ChannelDrive(200, 1.0)] * 2, 0.01), False
    with SerialPort(sys.argv[1]) as port:
        session = Session(Link(configuration), port, time.monotonic_ns)
        session.connect()
        link = session.link
        while True:
            session.exchange()
            if link.state is LinkState.READY and link.drive_sequence is None:
                link.set_drive(drive)
            # Once the amplitude has risen.
            if not is_told and link.status and link.status.state is DeviceState.DRIVING and link.status.applied > 8:
                is_told = True
                print(DRIVING, flush=True)  # noqa: T201  # the parent reads it
            select.select([port], [], [], 0.002)


if __name__ == "__main__":
    main()
