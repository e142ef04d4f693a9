"""What the benches of the engine play: a table, and reports of fingers that tap or of a recording."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle, islice
from pathlib import Path

from engine.device import Device
from engine.effects import Effect, EffectPlayer, Effects, Rule, Segment, Trigger
from engine.table import Table
from engine.table.entry import DEFAULT_LEVEL_DB
from engine.touch import FingerTracker, open_digitizer
from engine.touch.sources.recording import Recording
from tactable.rig.virtual_digitizer import PRODUCT_ID, VENDOR_ID, descriptor_of, report_of
from tactable.shipped import cache_folder, find_device

MOST_FINGERS = 10
MOST_COMMANDS_HZ = 1000
"""Commands a second at most: a lease of 40 ms allows 3175, and a faster digitizer does not make fingers faster."""
HELD = Effects((Rule(Trigger.TOUCH, Effect("held", (Segment(None, DEFAULT_LEVEL_DB),))),))
"""A finger feels as long as it touches: time alone changes nothing, so each command has its report."""


@contextmanager
def open_table(path: Path | None) -> Iterator[Table]:
    """The given table, or the demo's, which is built if need be."""
    if path is not None:
        with Table.open(path) as table:
            yield table
        return
    from tactable.rig.demo import table_for

    device = find_device("reference-a")
    cached = cache_folder() / f"{device.name}-{device.fingerprint[:12]}.nc"
    with table_for(device, cached, lambda *_: None) as table:
        yield table


@dataclass(frozen=True)
class Stream:
    """A digitizer and its reports, which repeat without end."""

    name: str
    descriptor: bytes
    vendor_id: int
    product_id: int
    reports: tuple[bytes, ...]
    reports_per_command: int | None
    """One report in this many changes the state; None where only the engine knows."""
    simulated: bool

    def packets(self) -> Iterator[bytes]:
        """Repeat the reports without end."""
        return cycle(self.reports)


def tapping(fingers: int, rate_hz: int, device: Device) -> Stream:
    """Fingers that rest on the first half of the zones, and one that taps the others: each tap and lift is a change.

    Raises ValueError for a number of fingers outside 1 to 10.
    """
    if not 1 <= fingers <= MOST_FINGERS:
        raise ValueError(f"{fingers} fingers: expected 1 to {MOST_FINGERS}")
    length_m, zones = device.bar.length_m, device.zones
    half = len(zones) // 2 if fingers > 1 else 0
    tapped = [(zone.start_m + zone.stop_m) / 2 / length_m for zone in zones[half:]]
    rest_m = zones[half].start_m if half else 0.0
    at_rest = [rest_m * (number + 0.5) / (fingers - 1) / length_m for number in range(fingers - 1)] if half else []
    every = max(1, rate_hz // MOST_COMMANDS_HZ)
    frames = [
        _frame(at_rest, place if tap_is_down else None, place if not tap_is_down and first else None)
        for place in tapped
        for tap_is_down in (True, False)
        for first in [True] + [False] * (every - 1)
    ]
    reports = tuple(report_of(frame, i / rate_hz, MOST_FINGERS) for i, frame in enumerate(frames))
    plural = "s" if fingers > 1 else ""
    name = f"{fingers} finger{plural}, one tapping"
    return Stream(name, descriptor_of(MOST_FINGERS), VENDOR_ID, PRODUCT_ID, reports, every, simulated=True)


def _frame(at_rest: list[float], down: float | None, lifted: float | None) -> list[tuple[int, bool, float]]:
    fingers = [(number, True, place) for number, place in enumerate(at_rest)]
    if down is not None:
        fingers.append((len(at_rest), True, down))
    if lifted is not None:
        fingers.append((len(at_rest), False, lifted))
    return fingers


def replayed(recording: Recording) -> Stream:
    """The reports of a recording. Raises ValueError for one without reports."""
    if not recording.reports:
        raise ValueError(f"{recording.name or 'the recording'} has no reports: take another")
    reports = tuple(report.data for report in recording.reports)
    numbers = (recording.vendor_id, recording.product_id)
    return Stream(
        recording.name, recording.descriptor, *numbers, reports, None, simulated="SIMULATED" in recording.name
    )


def expected_states(stream: Stream, count: int, device: Device) -> list[tuple[int, int]]:
    """Each change of what is wanted that `count` reports bring when none is lost or late: (report, state of the zones).

    A zone is felt if one of its fingers feels (engine.touch.state_index).
    """
    digitizer = open_digitizer(stream.descriptor, stream.vendor_id, stream.product_id)
    tracker, player, changes = FingerTracker(device, digitizer.surface), EffectPlayer(HELD), list[tuple[int, int]]()
    placement = player.placement
    for index, report in enumerate(islice(stream.packets(), count)):
        frame = digitizer.decode_report(report, 0)
        if frame is None or not player.take(tracker.track(frame), 0) or player.placement == placement:
            continue
        placement = player.placement
        changes.append((index, 0 if placement is None else placement.state_on(device)))
    return changes
