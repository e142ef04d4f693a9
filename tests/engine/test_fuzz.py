"""Hostile descriptors and reports: nothing but our own errors, no contact outside the surface, bounded memory.

The long run mutates more devices and says where it failed:

    TACTABLE_FUZZ_DESCRIPTORS=1000000 pytest tests/engine/test_fuzz.py -k long

10**6 descriptors and the 10**8 report bytes that they get take about 20 minutes of one core.
"""

import os
import random
import resource
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from engine.touch import DescriptorError, Digitizer, DigitizerError, TouchFrame, open_digitizer
from engine.touch.sources.recording import read_recording
from tests.engine.shared_recordings import RECORDINGS
from tests.engine.touch import descriptors
from tests.engine.touch.descriptors import COUNT_MAXIMUM_5, TOUCH_PAD, application, finger

LONG_RUN = int(os.environ.get("TACTABLE_FUZZ_DESCRIPTORS", "0"))
SEED = int(os.environ.get("TACTABLE_FUZZ_SEED", "1"))
MEMORY_KIB = 50 * 1024
PARSE_S = 0.05
REPORTS_PER_DEVICE = 10
MS = 1_000_000

MADE_UP = (
    *(descriptors.HYBRID, descriptors.CERTIFIED),
    application(finger(), COUNT_MAXIMUM_5, usage=TOUCH_PAD),
    application(finger(), finger(), finger(), report_id=None),
    application(finger(), COUNT_MAXIMUM_5) + application(descriptors.CONTACT_COUNT, report_id=3),
)
NUMBERS = ((0, 0), (0x1FF7, 0x13), (0x0486, 0x185), (0x093A, 0x8002), (0x0EEF, 0x72FA), (0x0596, 0x500))
"""Of devices of different classes."""
# Values that break arithmetic: signs, carries, sizes and counts beyond every bound.
TELLING = (0, 1, 7, 8, 31, 32, 33, 64, 127, 128, 255, 256, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)


@dataclass
class Played:
    """What a run has seen."""

    descriptors: int = 0
    opened: int = 0
    reports: int = 0
    report_bytes: int = 0
    frames: int = 0
    contacts: int = 0
    slowest_s: float = 0.0


def check_device(descriptor: bytes, vendor_id: int, product_id: int) -> Digitizer | None:
    """The device's digitizer, or None where it is refused as it should be."""
    try:
        return open_digitizer(descriptor, vendor_id, product_id)
    except (DescriptorError, DigitizerError) as refusal:
        assert str(refusal)
        return None


def check_frame(digitizer: Digitizer, frame: TouchFrame | None) -> int:
    """Contacts of the frame, each with a name of its own, on the surface and within the device's maximum."""
    if frame is None:
        return 0
    x, y = digitizer.surface.x, digitizer.surface.y
    assert (
        len({contact.contact_id for contact in frame.contacts})
        == len(frame.contacts)
        <= digitizer.plan.maximum_contacts
    )
    for contact in frame.contacts:
        assert x.logical_minimum <= contact.x <= x.logical_maximum
        assert y.logical_minimum <= contact.y <= y.logical_maximum
    return len(frame.contacts)


@dataclass(frozen=True)
class Seed:
    """A device to mutate and reports of its own."""

    descriptor: bytes
    vendor_id: int
    product_id: int
    reports: tuple[bytes, ...]


def read_seeds() -> list[Seed]:
    """Devices made up here; with the shared recordings also 45 more, most of them real."""
    paths = [path for folder in ("touch", "synthetic") for path in sorted((RECORDINGS / folder).glob("*.hid"))]
    made_up = (Seed(descriptor, *number, ()) for descriptor in MADE_UP for number in NUMBERS)
    return [*made_up, *map(read_seed, paths)]


def read_seed(path: Path) -> Seed:
    recording = read_recording(path)
    reports = tuple(report.data for report in recording.reports[:200])
    return Seed(recording.descriptor, recording.vendor_id, recording.product_id, reports)


def mutate_descriptor(rng: random.Random, seeds: Sequence[Seed], original: bytes) -> bytes:
    """One to six edits: of bits, of whole items, of an item's value, of size, or a part of another device."""
    data = bytearray(original)
    for _ in range(rng.randint(1, 6)):
        place = rng.randrange(len(data)) if data else 0
        edit = rng.randrange(7)
        if edit == 0 and data:
            data[place] ^= 1 << rng.randrange(8)
        elif edit == 1 and data:
            data[place] = rng.choice(TELLING) & 0xFF
        elif edit == 2:
            tag = rng.randrange(64) << 2
            size = rng.randrange(4)
            value = rng.choice(TELLING) & (1 << 8 * (0, 1, 2, 4)[size]) - 1
            data[place:place] = bytes([tag | size]) + value.to_bytes((0, 1, 2, 4)[size], "little")
        elif edit == 3:
            del data[place : place + rng.randint(1, 5)]
        elif edit == 4:
            part = data[place : place + rng.randint(1, 80)]
            data[place:place] = part * rng.randint(1, 3)
        elif edit == 5:
            other = rng.choice(seeds).descriptor
            start = rng.randrange(len(other))
            data[place:place] = other[start : start + rng.randint(1, 80)]
        elif edit == 6 and rng.random() < 0.2:
            del data[place:]
    return bytes(data)


def mutate_report(rng: random.Random, seed: Seed, digitizer: Digitizer) -> bytes:
    """A report of the device with some bytes changed, or noise of a size and ID that fits, or one that does not."""
    layout = rng.choice(digitizer.surface.reports)
    kind = rng.randrange(4)
    if kind == 0 and seed.reports:
        data = bytearray(rng.choice(seed.reports))
        for _ in range(rng.randrange(4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        return bytes(data)
    size = min(digitizer.plan.reports[layout.report_id].needed_bytes, 512) if kind < 3 else rng.randrange(65)
    data = bytearray(rng.randbytes(size))
    if data and digitizer.surface.uses_report_ids and kind < 3:
        data[0] = layout.report_id
    return bytes(data)


def play_mutants(count: int, seed: int) -> Played:
    """`count` mutated devices, each with reports of its own if it opens; a failure names seed and number."""
    rng, seeds, played = random.Random(seed), read_seeds(), Played()
    for number in range(count):
        device = rng.choice(seeds)
        descriptor = mutate_descriptor(rng, seeds, device.descriptor)
        try:
            digitizer, taken_s = time_device(descriptor, device)
            if taken_s > played.slowest_s:  # a collected heap or a stall is no cost of the descriptor: none repeats
                taken_s = min(taken_s, *(time_device(descriptor, device)[1] for _ in range(3)))
            played.slowest_s = max(played.slowest_s, taken_s)
            played.descriptors += 1
            if digitizer is not None:
                play_reports(rng, device, digitizer, played)
        except Exception as error:
            error.add_note(f"seed {seed}, descriptor {number}: {descriptor.hex(' ')}")
            raise
    return played


def time_device(descriptor: bytes, device: Seed) -> tuple[Digitizer | None, float]:
    start_s = time.thread_time()
    digitizer = check_device(descriptor, device.vendor_id, device.product_id)
    return digitizer, time.thread_time() - start_s


def play_reports(rng: random.Random, device: Seed, digitizer: Digitizer, played: Played) -> None:
    now_ns = 0
    played.opened += 1
    for _ in range(REPORTS_PER_DEVICE):
        now_ns += rng.choice((0, MS, 8 * MS, 31 * MS, 121 * MS, -MS))
        report = mutate_report(rng, device, digitizer)
        for frame in (digitizer.expire(now_ns), digitizer.decode_report(report, now_ns)):
            played.frames += frame is not None
            played.contacts += check_frame(digitizer, frame)
        played.reports += 1
        played.report_bytes += len(report)


def check_run(count: int) -> Played:
    play_mutants(200, SEED)  # what is loaded once is not growth
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    played = play_mutants(count, SEED)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib < MEMORY_KIB
    assert played.slowest_s < PARSE_S
    assert 0.1 * count < played.opened < count
    assert played.frames > 0 and played.contacts > 0
    return played


def test_mutated_devices_are_read_or_refused() -> None:
    check_run(1000)


@pytest.mark.skipif(not LONG_RUN, reason="long run: set TACTABLE_FUZZ_DESCRIPTORS, such as 1000000 (20 minutes)")
def test_long_run_of_mutated_devices(capsys: pytest.CaptureFixture[str]) -> None:
    start_s = time.monotonic()
    played = check_run(LONG_RUN)
    with capsys.disabled():
        print(f"\n{played}, {time.monotonic() - start_s:.0f} s, seed {SEED}")  # noqa: T201  # the run's result
