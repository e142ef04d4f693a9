"""The whole chain in one run: table, touches, wire, bar; and whether the bar does what the table promised."""

import math
from collections.abc import Collection
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
from precompute.cores import available_cores
from tactable.rig import ENVELOPE_S, Felt, LiveRun, Measured, SimulatedBar, StateAndLevel, first_applied, play

AGREEMENT = 0.02
"""Promised and measured may differ by this fraction."""
DEMO_FINGERS = 2
"""A table made for the demo has clicks for so many: all of them take minutes."""
LONGEST_REPLAY_S = 12.0
"""A longer recording is replayed faster, so that the demo ends within a minute."""


@dataclass(frozen=True)
class StateReport:
    """One state that was rendered at one level: the table's promise, what the held drive did, and the run itself."""

    entry: Entry
    measured: Measured
    felt_m_per_s2: float
    """Greatest under the fingers that were to feel, while the state lasted."""
    quiet_m_per_s2: float
    """Greatest under the others; 0 where there were none."""

    def zones_in(self, state: ZoneState) -> list[int]:
        """Indices of the zones in a state."""
        return [i for i, zone in enumerate(self.entry.zones) if zone.state is state]

    @property
    def felt_zones(self) -> list[int]:
        """Indices of the zones that are to be felt."""
        return self.zones_in(ZoneState.FELT)

    @property
    def measured_factor(self) -> float:
        """Localized factor of the felt zones, measured."""
        return float(self.measured.share[self.felt_zones].sum())

    @property
    def disagreement(self) -> float:
        """Greatest relative difference of localized factor, peaks of felt zones and acceleration at each finger."""
        entry, measured = self.entry, self.measured
        pairs = [(entry.localized_factor, self.measured_factor)]
        pairs += [(entry.zones[i].peak_acceleration_m_per_s2, measured.peak[i]) for i in self.felt_zones]
        fingers = (zone.acceleration_at_finger_m_per_s2 for zone in entry.zones)
        pairs += [
            (promised, found)
            for promised, found in zip(fingers, measured.at_finger, strict=True)
            if promised is not None
        ]
        return float(max(abs(found / promised - 1) for promised, found in pairs))

    def level_db(self, acceleration_m_per_s2: float) -> float | None:
        """Sensation level of an acceleration by this state's drive, its tones as strong as under a felt finger.

        None for no acceleration.
        """
        zone = self.entry.zones[self.felt_zones[0]]
        if not acceleration_m_per_s2 or not zone.acceleration_at_finger_m_per_s2 or zone.sensation_level_db is None:
            return None
        change = acceleration_m_per_s2 / zone.acceleration_at_finger_m_per_s2
        return zone.sensation_level_db + 20 * math.log10(change)


@dataclass(frozen=True)
class DemoReport:
    """All that the demo found. SIMULATED: digitizer (where it is the shipped recording), firmware and bar."""

    device: Device
    table: Path
    recording: Recording
    speed: float
    run: LiveRun
    states: tuple[StateReport, ...]
    missed: tuple[StateAndLevel, ...]
    """What was sent in time and never applied by the firmware."""
    not_rendered: tuple[StateAndLevel, ...]
    """What was to be rendered and was over before the machine, having stalled, brought it to the firmware."""
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
        build_table(
            device,
            path,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            clicks_up_to=DEMO_FINGERS,
            workers=available_cores(),
            progress=progress,
        )
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
    applied = first_applied(run)
    felt = bar.feel(run, LONGEST_REPLAY_S + 1.0) if run.trace else None
    greatest = _greatest(run, felt) if felt else {}
    states = tuple(
        StateReport(entry, bar.measure_held(event, entry), *greatest.get(key, (0.0, 0.0)))
        for key, event in applied.items()
        if (entry := table.entry_at(*key)) is not None
    )
    missed, not_rendered = find_missed(table, run, applied)
    return DemoReport(table.device, table.path, recording, speed, run, states, missed, not_rendered, felt)


def find_missed(
    table: Table, run: LiveRun, applied: Collection[StateAndLevel]
) -> tuple[tuple[StateAndLevel, ...], tuple[StateAndLevel, ...]]:
    """Of the states that have an entry and were not applied: those that should have been, and the others.

    The others were replaced before they were sent, or refused because they came too late.
    """
    wanted = dict[StateAndLevel, bool]()
    for change in run.trace:
        if change.level_db is None or (change.state, change.level_db) in applied:
            continue
        key = (change.state, change.level_db)
        wanted[key] = wanted.get(key, False) or (change.drive_sequence is not None and not run.came_late(change))
    known = sorted(key for key in wanted if table.entry_at(*key) is not None)
    return tuple(key for key in known if wanted[key]), tuple(key for key in known if not wanted[key])


def _greatest(run: LiveRun, felt: Felt) -> dict[StateAndLevel, tuple[float, float]]:
    """Greatest acceleration under fingers that were to feel, and under others, while each state lasted, m/s^2."""
    out: dict[StateAndLevel, tuple[float, float]] = {}
    starts_s = [(change.time_ns - run.trace[0].time_ns) / 1e9 for change in run.trace]
    for change, start_s, stop_s in zip(run.trace, starts_s, [*starts_s[1:], np.inf], strict=True):
        if change.level_db is None:
            continue
        key = (change.state, change.level_db)
        during = (felt.time_s >= start_s) & (felt.time_s + ENVELOPE_S <= stop_s)
        found = (float(values[during].max(initial=0.0)) for values in (felt.felt, felt.quiet))
        before = out.get(key, (0.0, 0.0))
        out[key] = (max(before[0], next(found)), max(before[1], next(found)))
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
        "commands_late": sum(run.came_late(change) for change in run.trace),
        "set_frames_on_the_wire": run.frames_sent,
        "reconnects": run.counters.reconnects,
        "report_to_command": None if latency is None else asdict(latency),
        "states": [_state_json(report.device, state) for state in report.states],
        "missed_states": [_key_json(*key) for key in report.missed],
        "states_not_rendered": [_key_json(*key) for key in report.not_rendered],
        "agreement": AGREEMENT,
        "agrees": report.agrees,
    }


def finite_or_none(level_db: float) -> float | None:
    """JSON has no infinity: None stands for full scale."""
    return level_db if math.isfinite(level_db) else None


def _key_json(state: int, level_db: float) -> dict[str, Any]:
    return {"state": state, "level_db": finite_or_none(level_db)}


def _state_json(device: Device, state: StateReport) -> dict[str, Any]:
    entry = state.entry
    return {
        "state": entry.index,
        "felt": [entry.zones[i].name for i in state.felt_zones],
        "quiet": [entry.zones[i].name for i in state.zones_in(ZoneState.QUIET)],
        "wanted_level_db": finite_or_none(entry.wanted_level_db),
        "level_db": entry.level_db,
        "achieved": entry.achieved,
        "contrast_db": entry.contrast_db,
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
                "promised_acceleration_at_finger_m_per_s2": promise.acceleration_at_finger_m_per_s2,
                "measured_acceleration_at_finger_m_per_s2": _known(state.measured.at_finger[i]),
            }
            for i, (zone, promise) in enumerate(zip(device.zones, entry.zones, strict=True))
        ],
        "greatest_acceleration_under_a_finger_m_per_s2": max(state.felt_m_per_s2, state.quiet_m_per_s2),
        "felt_level_in_run_db": state.level_db(state.felt_m_per_s2),
        "quiet_level_in_run_db": state.level_db(state.quiet_m_per_s2),
        "disagreement": state.disagreement,
    }


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
