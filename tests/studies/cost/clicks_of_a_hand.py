"""How soon touches of a hand get their own click: the run's solver, an emulated board, real time. SIMULATED.

    python -m tests.studies.cost.clicks_of_a_hand reference-a.nc --fingers 5
    python -m tests.studies.cost.clicks_of_a_hand reference-a.nc --recording hand.hid

Without a recording all fingers but one rest, and that one taps at random places, five times a second. Every finger
that comes begins a click which it feels and the others do not. A touch counts from when its report was
read until its click was written to the line; one that another touch, or its own lift, overtakes counts apart.
"""

import json
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from engine.device import Device
from engine.effects.rules import DEFAULT_EFFECTS
from engine.loop.command_latency import Stage
from engine.loop.loop import SystemClock
from engine.loop.observer import CommandRecord, LoopCounters
from engine.table import Table
from engine.touch import Placement
from engine.touch.placement import MOST_FINGERS
from engine.touch.sources.playback import Playback
from engine.touch.sources.recording import Recording, Report, read_recording
from firmware_link.emulator.emulator_process import run_emulator
from firmware_link.host.serial_port import SerialPort
from tactable.rig.emulate import configuration_of
from tactable.rig.rig import PTY_BIT_RATE_HZ
from tactable.rig.virtual_digitizer import PRODUCT_ID, VENDOR_ID, descriptor_of, report_of
from tactable.run.click_process import ClickProcess
from tactable.run.live_run import Live, LiveOptions
from tests.studies.options import read_options

LATE_S = 15e-3
_RATE_HZ, _STEPS, _DOWN = 125, 25, 12  # reports of a tap; the others come first, and rest when it comes down


def tapping_hand(device: Device, fingers: int, taps: int = 60, seed: int = 1) -> Recording:
    """A hand of which one finger taps, as a recording of a digitizer along the bar, 125 reports a second."""
    random, reports = np.random.default_rng(seed), list[Report]()
    apart = 25e-3 / device.bar.length_m
    for tap in range(taps):
        gaps = apart * np.arange(fingers)
        at = (np.sort(random.uniform(0.02, 0.98 - gaps[-1], fingers)) + gaps).tolist()
        moving = int(random.integers(fingers))
        for step in range(_STEPS):
            is_down, is_last = step >= _DOWN, step == _STEPS - 1
            shown = [(number, not is_last, place) for number, place in enumerate(at) if number != moving or is_down]
            time_s = (tap * _STEPS + step) / _RATE_HZ
            reports.append(Report(len(reports), time_s, report_of(shown, time_s, MOST_FINGERS)))
    return Recording("a tapping hand", 3, VENDOR_ID, PRODUCT_ID, descriptor_of(MOST_FINGERS), tuple(reports))


class _Records(list[CommandRecord]):
    def observe(self, record: CommandRecord, counters: LoopCounters) -> None:  # noqa: ARG002  # an Observer
        self.append(record)


def records_of(table: Table, recording: Recording) -> list[CommandRecord]:
    """Every record of a run that plays a recording at its own pace to an emulated board."""
    records = _Records()
    options = LiveOptions(DEFAULT_EFFECTS, bit_rate_hz=PTY_BIT_RATE_HZ)
    with (
        run_emulator(configuration_of(table.device)) as emulator,
        ClickProcess(table.path) as solving,
        closing(SerialPort(emulator.port)) as port,
    ):
        Live(table, Playback(recording, 1.0), port, SystemClock(), options, records, solving=solving).run()
    return records


def measure(records: list[CommandRecord]) -> list[tuple[int, float | None]]:
    """Number of fingers of every click that was wanted, and seconds until it was written; None: it was overtaken."""
    begun_ns, taken_s = dict[Placement, int](), dict[Placement, float | None]()
    for record in records:
        if not record.is_click or record.placement is None:
            continue
        begin_ns = begun_ns.setdefault(record.placement, record.stamps_ns[Stage.READ])
        taken_s.setdefault(record.placement, None)
        written_ns = record.stamps_ns[Stage.WRITTEN]
        if record.play and written_ns and taken_s[record.placement] is None:
            taken_s[record.placement] = (written_ns - begin_ns) / 1e9
    return [(len(placement.position_m), each_s) for placement, each_s in taken_s.items()]


def main() -> None:
    """Print the shares and times by number of fingers, as JSON."""
    asked = read_options(__doc__, table=Path, fingers=5, recording=Path())
    with Table.open(asked.table) as table:
        is_made = asked.recording == Path()
        hand = tapping_hand(table.device, asked.fingers) if is_made else read_recording(asked.recording)
        found = measure(records_of(table, hand))
        print(json.dumps(summary(found), indent=1))


def summary(found: list[tuple[int, float | None]]) -> dict[str, Any]:
    """Of each number of fingers: clicks, how many were overtaken, share within LATE_S, and times in ms."""
    out = dict[str, Any]()
    for fingers in sorted({count for count, _ in found}):
        times_s = [taken_s for count, taken_s in found if count == fingers]
        got = np.array([each for each in times_s if each is not None])
        out[str(fingers)] = {
            "clicks": len(times_s),
            "overtaken": len(times_s) - len(got),
            "within_15_ms": float(np.mean(got <= LATE_S)) if len(got) else None,
            "ms_5_50_95": (1e3 * np.percentile(got, (5, 50, 95))).round(2).tolist() if len(got) else None,
        }
    return out


if __name__ == "__main__":
    main()
