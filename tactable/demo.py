"""The whole chain in one run: table, touches, wire, bar; and whether the bar does what the table promised."""

from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from engine.device import Device
from engine.entry import Entry
from engine.latency import Stage
from engine.sources.recording import Recording
from engine.table import Table, TableError, open_table
from engine.zones import ZoneState
from precompute.build import Progress, build_table, code_fingerprint
from tactable.rig import ENVELOPE_S, Felt, LiveRun, Measured, SimulatedBar, first_applied, play

AGREEMENT = 0.02
"""Promised and measured may differ by this fraction."""
LONGEST_REPLAY_S = 12.0
"""A longer recording is replayed faster, so that the demo ends within a minute."""


@dataclass(frozen=True)
class StateReport:
    """One state that was rendered: the table's promise, what the held drive did, what the fingers felt in the run."""

    entry: Entry
    measured: Measured
    felt_m_per_s2: float

    @property
    def felt_zones(self) -> list[int]:
        """Indices of the zones that are to be felt."""
        return [i for i, zone in enumerate(self.entry.zones) if zone.state is ZoneState.FELT]

    @property
    def measured_factor(self) -> float:
        """Localized factor of the felt zones, measured."""
        return float(self.measured.share[self.felt_zones].sum())

    @property
    def disagreement(self) -> float:
        """Greatest relative difference of localized factor and of the peaks of the felt zones."""
        promised = np.array([zone.peak_acceleration_m_per_s2 for zone in self.entry.zones])[self.felt_zones]
        peaks = abs(self.measured.peak[self.felt_zones] / promised - 1)
        return float(max(peaks.max(), abs(self.measured_factor / self.entry.localized_factor - 1)))


@dataclass(frozen=True)
class DemoReport:
    """All that the demo found. SIMULATED: digitizer (where it is the shipped recording), firmware and bar."""

    device: Device
    table: Path
    recording: Recording
    speed: float
    run: LiveRun
    states: tuple[StateReport, ...]
    missed: tuple[int, ...]
    """States that were to be rendered for at least one command and never reached the firmware."""
    felt: Felt | None
    """None where no state changed."""

    @property
    def agrees(self) -> bool:
        """Whether every state that was rendered keeps its promise, and none was missed."""
        return not self.missed and all(state.disagreement <= AGREEMENT for state in self.states)


def table_for(device: Device, path: Path, progress: Progress) -> Table:
    """The table of `device` at `path`, built if it is missing, stale or broken."""
    try:
        return open_table(path, device=device, code_fingerprint=code_fingerprint())
    except TableError:
        path.parent.mkdir(parents=True, exist_ok=True)
        build_table(device, path, created=datetime.now(UTC).isoformat(timespec="seconds"), progress=progress)
        return open_table(path, device=device, verify=False)


def run_demo(table: Table, recording: Recording) -> DemoReport:
    """Replay, render, measure. Raises what `tactable.rig.play` raises."""
    with threadpool_limits(1, "blas"):
        return _run_demo(table, recording)


def _run_demo(table: Table, recording: Recording) -> DemoReport:
    times_s = [report.time_s for report in recording.reports]
    duration_s = times_s[-1] - times_s[0] if times_s else 0.0
    speed = max(1.0, duration_s / LONGEST_REPLAY_S)
    run = play(table, recording, speed)
    bar = SimulatedBar(table.device)
    entries = {entry.index: entry for entry in table.entries}
    applied = first_applied(run, list(entries))
    felt = bar.feel(run, LONGEST_REPLAY_S + 1.0) if run.trace else None
    felt_by_state = _felt_by_state(run, felt) if felt else {}
    states = tuple(
        StateReport(entries[index], bar.measure_held(event, entries[index]), felt_by_state.get(index, 0.0))
        for index, event in applied.items()
    )
    sent = {change.state for change in run.trace if change.drive_sequence is not None} & set(entries)
    missed = tuple(sorted(sent - set(applied)))
    return DemoReport(table.device, table.path, recording, speed, run, states, missed, felt)


def _felt_by_state(run: LiveRun, felt: Felt) -> dict[int, float]:
    """Greatest acceleration under a finger while each state lasted, m/s^2."""
    out: dict[int, float] = {}
    starts_s = [(change.time_ns - run.trace[0].time_ns) / 1e9 for change in run.trace]
    for change, start_s, stop_s in zip(run.trace, starts_s, [*starts_s[1:], np.inf], strict=True):
        during = felt.acceleration[(felt.time_s >= start_s) & (felt.time_s + ENVELOPE_S <= stop_s)]
        out[change.state] = max(out.get(change.state, 0.0), float(during.max(initial=0.0)))
    return out


def demo_json(report: DemoReport) -> dict[str, Any]:
    """Everything as plain values."""
    run, latency = report.run, report.run.latency.summarise(Stage.AVAILABLE, Stage.WRITTEN)
    return {
        "simulated": True,
        "device": report.device.name,
        "fingerprint": report.device.fingerprint,
        "table": str(report.table),
        "recording": report.recording.name,
        "speed": report.speed,
        "reports": run.counters.reports,
        "touch_frames": run.counters.frames,
        "state_changes": run.counters.state_changes,
        "commands_sent": run.counters.commands,
        "commands_applied": sum(run.applied(change) is not None for change in run.trace),
        "set_frames_on_the_wire": run.frames_sent,
        "reconnects": run.counters.reconnects,
        "report_to_command": None if latency is None else asdict(latency),
        "states": [_state_json(report.device, state) for state in report.states],
        "missed_states": list(report.missed),
        "agreement": AGREEMENT,
        "agrees": report.agrees,
    }


def _state_json(device: Device, state: StateReport) -> dict[str, Any]:
    entry = state.entry
    return {
        "state": entry.index,
        "felt": [entry.zones[i].name for i in state.felt_zones],
        "family": entry.family,
        "frequencies_hz": list(entry.frequencies_hz),
        "amplitudes": list(entry.amplitudes),
        "phases_rad": list(entry.phases_rad),
        "t90_s": entry.t90_s,
        "promised_localized_factor": entry.localized_factor,
        "measured_localized_factor": state.measured_factor,
        "zones": [
            {
                "name": zone.name,
                "state": promise.state.name.lower(),
                "promised_share": promise.share,
                "measured_share": float(state.measured.share[i]),
                "promised_peak_acceleration_m_per_s2": promise.peak_acceleration_m_per_s2,
                "measured_peak_acceleration_m_per_s2": float(state.measured.peak[i]),
            }
            for i, (zone, promise) in enumerate(zip(device.zones, entry.zones, strict=True))
        ],
        "greatest_acceleration_under_a_finger_m_per_s2": state.felt_m_per_s2,
        "disagreement": state.disagreement,
    }
