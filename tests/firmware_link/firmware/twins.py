"""Random sessions over both cores at once: every byte they send, every state, every sample within rounding is the same.

A session is drawn by its seed and number alone. Most frames are such as a host sends, so that transfers, drives and
clicks come about; between them come those that must be refused: a BASIS_BEGIN without room or a chunk out of order
within a transfer, stale commands, copies, damage, and bodies of random bytes whose checksum is right.

    python -m tests.firmware_link.firmware.twins --seed 1 --frames 1000000

runs the C core under AddressSanitizer and UBSan, with room for its actuators only, and prints what the frames came to.
"""

import argparse
import itertools
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random
from typing import Self

import numpy as np
from numpy.typing import NDArray

from firmware_link.emulator.c_core import CompiledFirmware
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.emulator.synthesis import synthesise
from firmware_link.protocol.basis import Basis, BasisSet, hash_of_basis, transfer_messages
from firmware_link.protocol.drive_words import ChannelDrive, encode_drive
from firmware_link.protocol.framing import EMERGENCY_STOP, encode_frame, encode_message
from firmware_link.protocol.layout import Layout, Message
from firmware_link.protocol.messages import (
    BASIS_CHUNK_SIZE,
    FULL_SCALE_WORD,
    MAGIC,
    MESSAGES,
    Ack,
    Arm,
    BasisBegin,
    BasisChunk,
    BasisCommit,
    DeviceState,
    Fault,
    KeepAlive,
    Play,
    Result,
    Sense,
    Set,
    SetFlag,
    Stop,
    TimeRequest,
)
from tests.firmware_link.firmware.compiled_core import (
    FULL_OUTPUT,
    US_PER_S,
    core_library,
    make,
    sense_now,
    with_sanitizers,
)
from tests.firmware_link.law_host import greeting, hump
from tests.firmware_link.strategies import RESOLUTION_HZ
from tests.firmware_link.virtual_rig import BOOT_ID, reference

ROOT = Path(__file__).parents[3]
ACTUATORS = 2
RATE_HZ = 40_000
SAMPLE_US = 25
SLEW_PER_S = 200
RAMP_US = US_PER_S // SLEW_PER_S
CAPACITY_BYTES = 1_500
CONFIGURATION = DeviceConfiguration(
    BOOT_ID,
    ACTUATORS,
    synthesis_rate_hz=RATE_HZ,
    basis_capacity_bytes=CAPACITY_BYTES,
    longest_drive_s=1,
    sensor_rate_mhz=3_200_000,
    sensor_scale_nm_per_s2=38_303_000,
    sensor_greatest=4_095,
)
# C rounds its output and each of up to three clicks by half of an output step, and frequencies to RATE_HZ / 2^33: in
# five seconds, longer than a session, a phase parts by 0.15 mrad, five steps. A fall of less than one step of the slew
# takes a whole sample, so an onset that waits for its end may come up to a sample late: one step of the slew, and no
# more, since written phases run all the time and what comes after an onset does not wait for it.
TOLERANCE = SLEW_PER_S / RATE_HZ + 8 / FULL_OUTPUT
STEPS_A_SESSION = 120


def basis_of(*sets: tuple[int, tuple[int, ...]]) -> Basis:
    """A basis of sets, each with the duration of its clicks in milliseconds and the actuator of each function."""
    humps = [
        BasisSet(
            (FULL_OUTPUT * hump(*[1.0] * len(moved), duration_us=1_000 * ms).T).astype(np.int16),
            np.array(moved, np.uint8),
        )
        for ms, moved in sets
    ]
    return Basis(2_000, tuple(humps))


# From a tenth to most of the memory: some fit before or behind another, some only alone.
BASES = (
    basis_of((20, (0,))),
    basis_of((20, (0, 1)), (10, (1,))),
    basis_of((30, (0, 1, 0)), (15, (1, 1))),
    basis_of((40, (0, 1, 1, 0)), (7, (0, 1))),
    basis_of((60, (1, 0, 1, 0)), (40, (1, 0))),
)
DATA = tuple(basis.data for basis in BASES)


def _next_sample_us(time_us: int) -> int:
    """When C begins to do what came at a time; Python begins at once, up to 0.1 rad of 655 Hz earlier."""
    return -(-time_us // SAMPLE_US) * SAMPLE_US


@dataclass
class Twins:
    """Both cores, given the same and compared after each step."""

    configuration: DeviceConfiguration = CONFIGURATION
    now_us: int = 0
    sequence: int = 0
    applied: int = 0
    frames: int = 0
    events_at_commit: int = 0
    last: bytes = b""
    samples: NDArray[np.int16] = field(default_factory=lambda: np.empty((0, ACTUATORS), np.int16))

    def __post_init__(self) -> None:
        self.python = EmulatedFirmware(self.configuration)
        self.compiled = CompiledFirmware(core_library(), self.configuration)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.compiled.close()

    def send(self, message: Message, step: int = 1) -> None:
        if isinstance(message, BasisBegin):
            self._wait_for_memory()
        if isinstance(message, BasisCommit):
            self.events_at_commit = len(self.python.drive_log)
        self.sequence = (self.sequence + step) % 256
        self.receive(encode_message(message, self.sequence))

    def _wait_for_memory(self) -> None:
        """What still sounds of a basis held before would stand still in C, whose memory the next one takes."""
        end_us, events = self.python._drive.player.end_us, len(self.python.drive_log)
        is_of_another = end_us is not None and events <= self.events_at_commit
        self.wait(max(RAMP_US, end_us - self.now_us if end_us is not None and is_of_another else 0))

    def drive(self, message: Set | Play, step: int = 1) -> None:
        self.send(message, step)
        self.applied = self.sequence

    def receive(self, data: bytes) -> None:
        self.frames += 1
        self.last = data
        assert self.compiled.receive(data, self.now_us) == self.python.receive(data, self.now_us)
        self.compare()

    def wait(self, duration_us: int) -> None:
        self.now_us += duration_us
        assert self.compiled.run_until(self.now_us) == self.python.run_until(self.now_us)
        self.compare()

    def hang_up(self) -> None:
        assert self.compiled.hang_up(self.now_us) == self.python.hang_up(self.now_us)
        self.compare()

    def compare(self) -> None:
        assert self.compiled.state is self.python.state
        assert self.compiled.counters == self.python.counters
        assert self.compiled.framing_counters == self.python.framing_counters
        assert self.compiled.next_deadline_us() == self.python.next_deadline_us()
        aimed = [aimed for _, aimed in self.compiled.amplitudes()]
        assert not any(aimed) or self.python.state is DeviceState.DRIVING
        if self.python.drive_log:
            channels = self.python.drive_log[-1].channels
            assert aimed == [round(channel.amplitude * FULL_SCALE_WORD) for channel in channels]

    def sense(self, accelerations: list[int]) -> None:
        """The C core knows the displacements of an instant by itself; Python is told those of C."""
        self.samples = np.concatenate([self.samples, self.compiled.take_samples()])
        last = len(self.samples) - 1
        for acceleration in accelerations:
            sense_now(self.compiled, acceleration)
            self.python.sense(acceleration, self.samples[last].tolist() if last >= 0 else [0] * ACTUATORS, last)
        assert self.compiled.senses == self.python.senses
        # The library lets time pass from sample to sample, and sends what is whole before anything that is due later.
        self.wait(0)

    def compare_samples(self, tolerance: float = TOLERANCE) -> None:
        self.samples = np.concatenate([self.samples, self.compiled.take_samples()])
        got = self.samples / FULL_OUTPUT
        log = [replace(event, device_time_us=_next_sample_us(event.device_time_us)) for event in self.python.drive_log]
        wanted = synthesise(log, 0, self.now_us, RATE_HZ)
        np.testing.assert_allclose(got, wanted if wanted.size else np.zeros_like(got), rtol=0, atol=tolerance)

    def make_ready(self, data: bytes = DATA[1]) -> None:
        """Greeted, with a basis, armed."""
        for message in (greeting(), *transfer_messages(data)):
            self.send(message)
        self.send(Arm(BOOT_ID, SLEW_PER_S, 40, 0, (FULL_SCALE_WORD,) * ACTUATORS))
        assert self.python.state is DeviceState.ARMED

    def fall_silent(self) -> None:
        self.drive(Set(reference(self.now_us), SetFlag(0), 40, bytes(6 * ACTUATORS)))

    def click(self, index: int, age_us: int = 0) -> Play:
        """A click of full scale of the second of BASES."""
        weights = (1 << 14,) * (2 - index)
        return Play(reference(self.now_us - age_us), index, 14, FULL_SCALE_WORD, len(weights), weights)


class Session(Twins):
    """A host that draws what it does; `rest` is what the transfer under way still needs."""

    def __init__(self, chance: Random) -> None:
        super().__init__()
        self.chance = chance
        self.data = DATA[0]
        self.rest: list[BasisBegin | BasisChunk | BasisCommit] = []

    def run(self, steps: "dict[Callable[[Session], None], int]", number: int) -> None:
        """Do some steps, each as often as its weight says, and compare what was heard and felt."""
        for step in self.chance.choices(list(steps), list(steps.values()), k=number):
            step(self)
        self.wait(100_000)
        self.compare_samples()

    # ---- what a host does --------------------------------------------------------------------------------------

    def pause(self) -> None:
        self.wait(self.chance.randrange(self.chance.choice((10_000, 10_000, 10_000, 75_000))))

    def pause_for_long(self) -> None:
        self.wait(self.chance.randrange(300_000))

    def set(self) -> None:
        lease_ms, flags = self.chance.choice((40, 40, 10, 255, 0)), SetFlag(self.chance.randrange(2))
        self.drive(Set(reference(self.now_us - self._age_us()), flags, lease_ms, self._drive()), self._step())

    def set_at_once(self) -> None:
        self.drive(Set(reference(self.now_us), SetFlag.WRITE_PHASE, 40, self._drive()))

    def play(self) -> None:
        """A click that fits the basis that is held, or another."""
        basis, chance = self.python._memory.basis or BASES[0], self.chance
        index = chance.choice((*range(len(basis.sets)), len(basis.sets), 255) if self._is_odd() else (0, -1))
        index %= len(basis.sets) if index < 0 else 256
        fits = basis.sets[index].actuators if index < len(basis.sets) else (0,)
        weights = tuple(chance.randint(-(2**15), 2**15 - 1) for _ in range(len(fits) + self._is_odd()))
        bits = chance.randrange(33) if self._is_odd() else chance.randrange(13, 18)
        amplitude = chance.choice((0, 30_000, FULL_SCALE_WORD))
        play = Play(reference(self.now_us - self._age_us()), index, bits, amplitude, len(weights), weights)
        self.drive(play, self._step())

    def keep_alive(self) -> None:
        named = (self.applied + self.chance.choice((0, 0, 1))) % 256
        self.send(KeepAlive(reference(self.now_us - self._age_us()), named), self._step())

    def arm(self) -> None:
        choice = self.chance.choice
        limits = tuple(choice((0, 20_000, FULL_SCALE_WORD, FULL_SCALE_WORD)) for _ in range(ACTUATORS))
        boot_id, slew_per_s = BOOT_ID + self._is_odd(), 0 if self._is_odd() else SLEW_PER_S
        self.send(Arm(boot_id, slew_per_s, choice((40, 40, 100, 7, 0, 101)), choice((0, 0, 1, 2)), limits))

    def greet(self) -> None:
        self.send(greeting(9, MAGIC + self._is_odd()))

    def stop(self) -> None:
        self.chance.choice((lambda: self.send(Stop()), lambda: self.receive(EMERGENCY_STOP), self.hang_up))()

    def recover(self) -> None:
        """What a host does that is not armed, or no longer."""
        if self.python.state in (DeviceState.ARMED, DeviceState.DRIVING):
            return
        self.settle()
        self.send(greeting())
        self.send(Arm(BOOT_ID, SLEW_PER_S, 40, 0, (FULL_SCALE_WORD,) * ACTUATORS))

    def settle(self) -> None:
        self.send(Ack(Fault.type_byte, (self.python._reports._fault_sequence + self._is_odd()) % 256, Result.OK))

    def ask(self) -> None:
        self.send(self.chance.choice((TimeRequest(2**63), *map(Sense, (0, 1, 20, 2_500)))))

    def shake(self) -> None:
        self.sense([self.chance.randint(-(2**15), 2**15 - 1) for _ in range(self.chance.randrange(100))])

    def begin(self) -> None:
        """A transfer of a basis, or of what none is, named as it should be."""
        self.data = self.chance.choice(DATA)
        if self.chance.random() < 0.2:
            # Heads and actuators stand in the first bytes.
            at = self.chance.randrange(self.chance.choice((16, len(self.data))))
            self.data = self.data[:at] + self.chance.randbytes(1) + self.data[at + 1 :]
        begin, *self.rest = transfer_messages(self.data)
        self.send(begin)

    def go_on(self) -> None:
        count = self.chance.choice((1, 2, 30))
        for message in self.rest[:count]:
            self.send(message)
        del self.rest[:count]

    def transfer(self) -> None:
        self.begin()
        while self.rest:
            if self._is_odd():
                self.intrude()
            self.send(self.rest.pop(0))

    # ---- what comes in between ---------------------------------------------------------------------------------

    def intrude(self) -> None:
        """A step of another transfer, mostly one that is refused; the one under way goes on afterwards."""
        size, ours, choice = len(self.data), hash_of_basis(self.data), self.chance.choice
        most, any_size = CAPACITY_BYTES, self.chance.randrange(CAPACITY_BYTES)
        sizes = (0, 1, size, size + 1, most, most + 1, 2**32 - 1, any_size)
        offsets = (0, BASIS_CHUNK_SIZE, size, size - size % BASIS_CHUNK_SIZE, self.chance.randrange(size), 2**32 - 1)
        named = choice((0, 1, ours, ours, self.python._memory.held_hash))
        message: Message = choice((BasisBegin(named, choice(sizes)), BasisBegin(5, choice(sizes)), BasisCommit(named)))
        if self.chance.random() < 0.5:
            message = BasisChunk(choice(offsets), self.chance.randbytes(BASIS_CHUNK_SIZE))
        self.send(message)

    def send_any_body(self) -> None:
        """Random bytes with the length of a message and its checksum."""
        layout = Layout(self.chance.choice(MESSAGES))
        repetitions = self.chance.randrange(layout.most) if layout.most else ACTUATORS
        body = bytearray(self.chance.randbytes(layout.length(repetitions)))
        body[:2] = layout.message.type_byte, self.sequence
        self.receive(encode_frame(bytes(body)))

    def repeat(self) -> None:
        self.receive(self.last)

    def damage(self) -> None:
        at = self.chance.randrange(max(1, len(self.last)))
        self.receive(self.last[:at] + self.chance.randbytes(1) + self.last[at + self.chance.randrange(2) :])

    def babble(self) -> None:
        self.receive(self.chance.randbytes(self.chance.randrange(400)))

    # ---- how it is drawn ---------------------------------------------------------------------------------------

    def _is_odd(self) -> bool:
        return self.chance.random() < 0.1

    def _age_us(self) -> int:
        return self.chance.randint(-60_000, 60_000) if self._is_odd() else 0

    def _step(self) -> int:
        return self.chance.choice((0, 127, 128, 255)) if self._is_odd() else 1

    def _drive(self) -> bytes:
        choice = self.chance.choice
        channels = [
            ChannelDrive(
                choice((0.0, 60.0, 60.0, 90.0, 333.33, 655.35)),
                choice((0.0, 0.0, 1 / FULL_SCALE_WORD, 0.25, 0.7, 1.0)),
                choice((0.0, 1.0, 3.0)),
            )
            for _ in range(ACTUATORS)
        ]
        return encode_drive(channels, RESOLUTION_HZ)


STEPS: dict[Callable[[Session], None], int] = {
    Session.pause: 12,
    Session.pause_for_long: 1,
    Session.set: 8,
    Session.set_at_once: 4,
    Session.play: 10,
    Session.keep_alive: 5,
    Session.arm: 3,
    Session.greet: 1,
    Session.stop: 1,
    Session.recover: 6,
    Session.settle: 1,
    Session.ask: 2,
    Session.shake: 2,
    Session.begin: 2,
    Session.go_on: 8,
    Session.transfer: 4,
    Session.intrude: 8,
    Session.send_any_body: 2,
    Session.repeat: 2,
    Session.damage: 1,
    Session.babble: 1,
}
# Most of these come during a crossfade, which takes up to 400 samples.
HURRIED_STEPS: dict[Callable[[Session], None], int] = {
    Session.pause: 1,
    Session.set: 1,
    Session.set_at_once: 2,
    Session.fall_silent: 1,
}


def run_sessions(seed: int, first: int, frames: int) -> Counter[str]:
    """Run sessions from number `first` on until there were so many frames; the frames by what they came to."""
    counts = Counter[str]()
    for number in itertools.count(first):
        if counts["frames"] >= frames:
            return counts
        print(f"session {number}, frame {counts['frames']}", end="\r", file=sys.stderr, flush=True)  # noqa: T201  # where it ends, if it does
        with Session(Random(f"{seed} {number}")) as session:
            if session.chance.random() < 0.7:
                session.make_ready(session.chance.choice(DATA[:3]))
            session.run(STEPS, STEPS_A_SESSION)
        received, framing = session.python.received, session.python.framing_counters
        counts.update(sessions=1, frames=session.frames, milliseconds=session.now_us // 1_000)
        counts.update(f"{each.message} {each.outcome}" for each in received)
        counts.update({"fields out of range": framing.ok - len(received), "checksum refused": framing.crc})
        counts.update({"no frame": framing.framing + framing.overrun, "length refused": framing.length})
    raise AssertionError


def make_sanitized(folder: Path) -> None:
    """Build the C core with sanitizers and room for its actuators only."""
    make(folder, "host", "SANITIZE=address,undefined", f"ACTUATORS={ACTUATORS}")


def run_apart(folder: Path, arguments: list[str], *, captures: bool = True) -> "subprocess.CompletedProcess[str]":
    """Run sessions in another process, over the sanitized core in a folder."""
    command = [sys.executable, "-m", "tests.firmware_link.firmware.twins", *arguments]
    environment = with_sanitizers(folder)
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=captures, text=True, check=False)


def main() -> None:
    """Print the counts; with sanitizers, unless the library is given."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first session")
    parser.add_argument("--frames", type=int, default=1_000_000)
    options = parser.parse_args()
    if "TACTABLE_CORE_LIBRARY" not in os.environ:
        with tempfile.TemporaryDirectory() as folder:
            make_sanitized(Path(folder))
            raise SystemExit(run_apart(Path(folder), sys.argv[1:], captures=False).returncode)
    counts = run_sessions(options.seed, options.first, options.frames)
    for kind, count in sorted(counts.items()):
        print(f"{kind:24}{count:10}")  # noqa: T201  # the report


if __name__ == "__main__":
    main()
