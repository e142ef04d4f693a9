"""What the guest hands back to the tests."""

from dataclasses import dataclass

from engine.touch.sources.hidraw import HidrawCounters
from firmware_link.emulator.process import EmulatorLog
from tests.system.chain import ChainRun


@dataclass(frozen=True)
class Happened:
    """One scenario: each run of the engine, the last source's counts, the firmware's log, what the hardware did when.

    Times are monotonic ns.
    """

    runs: tuple[ChainRun, ...]
    source: HidrawCounters
    log: EmulatorLog
    notes: dict[str, int]


@dataclass(frozen=True)
class KernelDevice:
    """The digitizer as the kernel shows it."""

    kernel_name: str
    driver: str
    product_name: str
    descriptor: bytes


@dataclass(frozen=True)
class Refusals:
    """What a user without rights is told, "" for nothing."""

    digitizer: str
    port: str


@dataclass(frozen=True)
class Broken:
    """A scenario that did not come to its end."""

    trace: str
