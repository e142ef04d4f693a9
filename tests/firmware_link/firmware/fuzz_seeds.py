"""Sessions as files for c/fuzz.c to begin with.

`python -m tests.firmware_link.firmware.fuzz_seeds FOLDER` writes them.
"""

import struct
import sys
from pathlib import Path

from firmware_link.protocol.basis import transfer_messages
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.layout import Message
from firmware_link.protocol.messages import (
    MAGIC,
    VERSION_MAJOR,
    VERSION_MINOR,
    Ack,
    Arm,
    ChannelDrive,
    Fault,
    HelloRequest,
    KeepAlive,
    Result,
    Sense,
    Set,
    SetFlag,
    Stop,
    TimeRequest,
    encode_body,
    encode_drive,
)
from tests.firmware_link.clicks import Clicks
from tests.firmware_link.conformance import hump
from tests.firmware_link.strategies import RESOLUTION_HZ
from tests.firmware_link.virtual_rig import reference

# As fuzz.c has them.
ACTUATORS, BOOT_ID, TIME_STEP_US = 3, 7, 37
RAW, FRAMED, SAMPLES, HANG_UP, EMERGENCY_STOP, SENSE = range(6)
CLICKS = Clicks(1_000, [hump(1.0, -1.0, 0.3, duration_us=20_000)] * 2)
HEAD = struct.Struct("<BHB")


class Session:
    """Records one after the other, and the time that they take."""

    def __init__(self) -> None:
        self.records = b""
        self.now_us = 0
        self.sequence = 0

    def add(self, operation: int, data: bytes = b"", wait_us: int = 1_000) -> None:
        steps = wait_us // TIME_STEP_US
        self.now_us += steps * TIME_STEP_US
        self.records += HEAD.pack(operation, steps, len(data)) + data

    def send(self, message: Message, wait_us: int = 1_000) -> None:
        self.sequence = (self.sequence + 1) % 256
        self.add(FRAMED, encode_body(message, self.sequence), wait_us)

    def set(self, *amplitudes: float) -> None:
        drive = encode_drive([ChannelDrive(90, amplitude) for amplitude in amplitudes], RESOLUTION_HZ)
        at_us = self.now_us + 1_000 // TIME_STEP_US * TIME_STEP_US
        self.send(Set(reference(at_us), SetFlag.WRITE_PHASE, 40, drive))

    def play(self, index: int) -> None:
        at_us = self.now_us + 1_000 // TIME_STEP_US * TIME_STEP_US
        self.send(CLICKS.play(index, reference(at_us), 50_000))


def greeted() -> Session:
    session = Session()
    session.send(HelloRequest(MAGIC, VERSION_MAJOR, VERSION_MINOR, 1))
    session.send(TimeRequest(1))
    return session


def armed(session: Session) -> Session:
    session.send(Arm(BOOT_ID, 200, 40, 1, (65_535,) * ACTUATORS))
    return session


def sessions() -> list[Session]:
    """One of each kind."""
    driven, played, latched, raw = armed(greeted()), greeted(), armed(greeted()), greeted()
    for amplitudes in ((1.0, 0.5, 0.0), (0.0, 1.0, 0.2), (0.0, 0.0, 0.0)):
        driven.set(*amplitudes)
        driven.send(KeepAlive(reference(driven.now_us), driven.sequence))
    for message in transfer_messages(CLICKS.basis.data):
        played.send(message)
    armed(played)
    for index in (0, 1, 0):
        played.play(index)
    played.set(0.3, 0.3, 0.3)
    latched.set(1.0, 1.0, 1.0)
    latched.add(SAMPLES, wait_us=300_000)
    latched.send(Ack(Fault.type_byte, 0, Result.OK))
    latched.add(EMERGENCY_STOP)
    latched.add(HANG_UP)
    raw.add(RAW, encode_message(Stop(), 9) + bytes(8))
    sensed = armed(greeted())
    sensed.send(Sense(0))
    sensed.send(Sense(100))
    for _ in range(4):
        sensed.set(0.5, 0.5, 0.5)
        sensed.add(SENSE, bytes(range(121)), wait_us=30_000)
    return [driven, played, latched, raw, sensed]


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for number, session in enumerate(sessions()):
        (folder / f"seed-{number}").write_bytes(session.records)
