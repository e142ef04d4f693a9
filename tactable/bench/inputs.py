"""Inputs of the benches of the engine: a table, and reports of fingers that tap or of a recording.

Each tap brings a click by the default rule, and its lift brings no command: the click ends by itself.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle, islice
from pathlib import Path

from engine.device import Device
from engine.effects.effect_player import EffectPlayer
from engine.effects.rules import DEFAULT_EFFECTS, Effect, Effects, Rule, Segment, Trigger
from engine.table import Table
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.touch import FingerTracker, Placement, open_digitizer
from engine.touch.placement import MOST_FINGERS
from engine.touch.sources.recording import Recording
from tactable.rig.virtual_digitizer import PRODUCT_ID, VENDOR_ID, descriptor_of, report_of
from tactable.shipped import cache_folder, find_device

MOST_COMMANDS_HZ = 100  # a device fades one click while the next one plays, and has no room for a third
HELD = Effects((Rule(Trigger.TOUCH, Effect("held", (Segment(None, DEFAULT_LEVEL_DB),))),))
_NS_PER_S = 1_000_000_000


@contextmanager
def open_table(path: Path | None) -> Iterator[Table]:
    """The given table, or the demo's, which is built if need be."""
    if path is not None:
        with Table.open(path) as table:
            yield table
        return
    from tactable.rig.demo_run import table_for
    from tactable.rig.ready import cached_table

    device = find_device("reference-a")
    with table_for(device, cached_table(device, cache_folder()), lambda *_: None) as table:
        yield table


@dataclass(frozen=True)
class Stream:
    """A digitizer and its reports, which repeat without end."""

    name: str
    descriptor: bytes
    vendor_id: int
    product_id: int
    reports: tuple[bytes, ...]
    reports_per_command: int | None  # one report in this many brings a click; None where only the engine knows
    simulated: bool


def tapping(fingers: int, rate_hz: int, device: Device) -> Stream:
    """Fingers at rest, and one that taps other places in turn. Raises ValueError for other than 1 to 10 fingers."""
    if not 1 <= fingers <= MOST_FINGERS:
        raise ValueError(f"{fingers} fingers: expected 1 to {MOST_FINGERS}")
    spots = max(fingers + 1, len(device.zones))
    places = [(spot + 0.5) / spots for spot in range(spots)]
    at_rest, tapped = places[: fingers - 1], places[fingers - 1 :]
    every = max(2, rate_hz // MOST_COMMANDS_HZ)
    lift = every // 2
    rest = [(number, True, place) for number, place in enumerate(at_rest)]
    frames = [
        [*rest, (len(rest), report < lift, place)] if report <= lift else rest
        for place in tapped
        for report in range(every)
    ]
    reports = tuple(report_of(frame, i / rate_hz, MOST_FINGERS) for i, frame in enumerate(frames))
    name = f"{fingers} finger{'s' * (fingers > 1)}, one tapping"
    return Stream(name, descriptor_of(MOST_FINGERS), VENDOR_ID, PRODUCT_ID, reports, every, simulated=True)


def replayed(recording: Recording) -> Stream:
    """The reports of a recording. Raises ValueError for one without reports."""
    if not recording.reports:
        raise ValueError(f"{recording.name or 'the recording'} has no reports: choose another recording")
    reports = tuple(report.data for report in recording.reports)
    numbers = (recording.vendor_id, recording.product_id)
    return Stream(
        recording.name, recording.descriptor, *numbers, reports, None, simulated="SIMULATED" in recording.name
    )


def expected_clicks(stream: Stream, rate_hz: float, count: int, device: Device) -> list[tuple[int, int]]:
    """(report, place) of each click that `count` reports bring by the default rule when none is lost or late."""
    digitizer = open_digitizer(stream.descriptor, stream.vendor_id, stream.product_id)
    tracker, player = FingerTracker(device, digitizer.surface), EffectPlayer(DEFAULT_EFFECTS)
    found = list[tuple[int, int]]()
    for index, report in enumerate(islice(cycle(stream.reports), count)):
        time_ns = round(index * _NS_PER_S / rate_hz)
        while player.next_change_ns is not None and player.next_change_ns <= time_ns:
            player.advance_effects(player.next_change_ns)
        frame, before_ns = digitizer.decode_report(report, time_ns), player.wanted.click_ns
        if (
            frame is not None
            and player.take_touches(tracker.track(frame), time_ns)
            and player.wanted.click_ns not in (None, before_ns)
        ):
            found.append((index, place_of(player.wanted.placement)))
    return found


def place_of(placement: Placement | None) -> int:
    """Position of the first felt finger in micrometres, -1 without one: what tells the clicks of taps apart."""
    return -1 if placement is None else round(1e6 * placement.position_m[placement.felt[0]].real)
