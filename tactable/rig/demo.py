"""The demo: recorded touches through the engine, the wire and the emulated firmware to the simulated bar.

The report says for every rendered state whether the simulated bar does what the table promised. JSON keys that begin
with `measured_` hold simulated values; their names are kept, since programs read them.
"""

from collections.abc import Collection
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from engine.device import Device
from engine.effects import DEFAULT_EFFECTS, Effects
from engine.loop import Stage
from engine.plain import to_plain
from engine.table import Table, TableError
from engine.touch import ZoneState
from engine.touch.sources.recording import Recording
from precompute.builder.build import Progress, build_table
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.parallel.pool import available_cores
from tactable.rig.bar import ENVELOPE_S, Felt, SimulatedBar
from tactable.rig.demo_reports import AGREEMENT, ClickReport, StateReport
from tactable.rig.rig import LiveRun, Wanted, first_applied, play, wanted_of

DEMO_FINGERS = 2
"""A table made for the demo has clicks for up to this many fingers; more would take minutes."""
LONGEST_REPLAY_S = 12.0
"""A longer recording is replayed faster, so that the demo ends within a minute."""


@dataclass(frozen=True)
class DemoReport:
    """What the demo found. SIMULATED: digitizer (where it is the shipped recording), firmware and bar."""

    device: Device
    table: Path
    recording: Recording
    speed: float
    run: LiveRun
    states: tuple[StateReport, ...]
    """What was rendered by a steady drive."""
    clicks: tuple[ClickReport, ...]
    """What was rendered by a click."""
    missed: tuple[Wanted, ...]
    """States that were sent in time and never applied by the firmware."""
    not_rendered: tuple[Wanted, ...]
    """States that ended before a stalled machine brought them to the firmware."""
    felt: Felt | None
    """None where no state changed."""

    @property
    def agrees(self) -> bool:
        """Whether every state that was rendered keeps its promise, and none was missed."""
        found = [each.disagreement for each in self.states] + [each.disagreement for each in self.clicks]
        return not self.missed and all(disagreement <= AGREEMENT for disagreement in found)


def table_for(device: Device, path: Path, progress: Progress) -> Table:
    """The table of `device` at `path`, built if it is missing, stale or broken."""
    try:
        return Table.open(path, device=device, code_fingerprint=code_fingerprint())
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
        return Table.open(path, device=device, verify=False)


def run_demo(table: Table, recording: Recording, effects: Effects = DEFAULT_EFFECTS) -> DemoReport:
    """Replay, render and simulate. Raises what `tactable.rig.rig.play` raises."""
    with threadpool_limits(1, "blas"):
        return _run_demo(table, recording, effects)


def _run_demo(table: Table, recording: Recording, effects: Effects) -> DemoReport:
    times_s = [report.time_s for report in recording.reports]
    duration_s = times_s[-1] - times_s[0] if times_s else 0.0
    speed = max(1.0, duration_s / LONGEST_REPLAY_S)
    run = play(table, recording, speed, effects)
    bar = SimulatedBar(table.device)
    applied = first_applied(run)
    felt = bar.feel(run, LONGEST_REPLAY_S + 1.0) if run.trace else None
    greatest = _greatest(run, felt) if felt else {}
    states = tuple(
        StateReport(entry, bar.simulate_held(event, entry), *greatest.get(wanted, (0.0, 0.0)))
        for wanted, event in applied.items()
        if event.waveform is None and (entry := table.entry_at(wanted.state, wanted.level_db)) is not None
    )
    clicks = tuple(
        ClickReport(click, bar.simulate_click(event, click.states), *greatest.get(wanted, (0.0, 0.0)))
        for wanted, event in applied.items()
        if event.waveform is not None and (click := table.click_at(wanted.state, wanted.level_db)) is not None
    )
    missed, not_rendered = find_missed(table, run, applied)
    return DemoReport(table.device, table.path, recording, speed, run, states, clicks, missed, not_rendered, felt)


def find_missed(
    table: Table, run: LiveRun, applied: Collection[Wanted]
) -> tuple[tuple[Wanted, ...], tuple[Wanted, ...]]:
    """Of what has an entry and was not applied: what should have been, and the rest.

    The rest was replaced before it was sent, or refused because it came too late.
    """
    due = dict[Wanted, bool]()
    for change in run.trace:
        wanted = wanted_of(change)
        if wanted is None or wanted in applied:
            continue
        due[wanted] = due.get(wanted, False) or (change.drive_sequence is not None and not run.came_late(change))
    known = sorted(wanted for wanted in due if table.entry_at(wanted.state, wanted.level_db) is not None)
    return tuple(wanted for wanted in known if due[wanted]), tuple(wanted for wanted in known if not due[wanted])


def _greatest(run: LiveRun, felt: Felt) -> dict[Wanted, tuple[float, float]]:
    """Greatest acceleration under fingers that were to feel, and under others, m/s^2, until something else is felt."""
    out: dict[Wanted, tuple[float, float]] = {}
    changes = [(change.time_ns, wanted) for change in run.trace if (wanted := wanted_of(change)) is not None]
    starts_s = [(time_ns - run.trace[0].time_ns) / 1e9 for time_ns, _ in changes]
    for (_, wanted), start_s, stop_s in zip(changes, starts_s, [*starts_s[1:], np.inf], strict=True):
        during = (felt.time_s >= start_s - ENVELOPE_S) & (felt.time_s + ENVELOPE_S <= stop_s)
        found = (float(values[during].max(initial=0.0)) for values in (felt.felt, felt.quiet))
        before = out.get(wanted, (0.0, 0.0))
        out[wanted] = (max(before[0], next(found)), max(before[1], next(found)))
    return out


def demo_json(report: DemoReport) -> dict[str, Any]:
    """The report as plain JSON values."""
    run, latency = report.run, report.run.latency.summarise(Stage.AVAILABLE, Stage.WRITTEN)
    return to_plain(
        {
            "simulated": True,
            "device": report.device.name,
            "fingerprint": report.device.fingerprint,
            "table": report.table,
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
            "report_to_command": latency,
            "states": [_state_json(report.device, state) for state in report.states],
            "clicks": [_click_json(report.device, click) for click in report.clicks],
            "missed_states": [_key_json(key) for key in report.missed],
            "states_not_rendered": [_key_json(key) for key in report.not_rendered],
            "agreement": AGREEMENT,
            "agrees": report.agrees,
        }
    )


def _key_json(wanted: Wanted) -> dict[str, Any]:
    return {"state": wanted.state, "level_db": wanted.level_db, "click": wanted.is_click}


def _state_json(device: Device, state: StateReport) -> dict[str, Any]:
    entry = state.entry
    return {
        "state": entry.index,
        "felt": [entry.zones[i].name for i in state.felt_zones],
        "quiet": [entry.zones[i].name for i in state.zones_in(ZoneState.QUIET)],
        "wanted_level_db": entry.wanted_level_db,
        "level_db": entry.level_db,
        "achieved": entry.achieved,
        "contrast_db": entry.contrast_db,
        "family": entry.family,
        "frequencies_hz": entry.frequencies_hz,
        "amplitudes": entry.amplitudes,
        "phases_rad": entry.phases_rad,
        "t90_s": entry.t90_s,
        "promised_localized_factor": entry.localized_factor,
        "measured_localized_factor": state.simulated_factor,
        "zones": [
            {
                "name": zone.name,
                "state": promise.state.name.lower(),
                "promised_share": promise.share,
                "measured_share": state.simulated.share[i],
                "promised_peak_acceleration_m_per_s2": promise.peak_acceleration_m_per_s2,
                "measured_peak_acceleration_m_per_s2": state.simulated.peak[i],
                "promised_acceleration_at_finger_m_per_s2": promise.acceleration_at_finger_m_per_s2,
                "measured_acceleration_at_finger_m_per_s2": state.simulated.at_finger[i],
            }
            for i, (zone, promise) in enumerate(zip(device.zones, entry.zones, strict=True))
        ],
        "greatest_acceleration_under_a_finger_m_per_s2": max(state.felt_m_per_s2, state.quiet_m_per_s2),
        "felt_level_in_run_db": state.level_db(state.felt_m_per_s2),
        "quiet_level_in_run_db": state.level_db(state.quiet_m_per_s2),
        "disagreement": state.disagreement,
    }


def _click_json(device: Device, report: ClickReport) -> dict[str, Any]:
    click = report.click
    return {
        "state": click.index,
        "felt": [device.zones[i].name for i in report.felt_zones],
        "quiet": [device.zones[i].name for i in report.zones_in(ZoneState.QUIET)],
        "wanted_level_db": click.wanted_level_db,
        "level_db": click.level_db,
        "achieved": click.achieved,
        "amplitude": click.amplitude,
        "length_s": click.length_s,
        "exceeds_s": click.exceeds_at_s(),
        "felt_level_db": click.felt,
        "quiet_level_db": click.quiet,
        "zones": [
            {
                "name": zone.name,
                "state": state.name.lower(),
                "promised_level_db": None if promise is None else promise.level_db,
                "promised_acceleration_at_finger_m_per_s2": promise and promise.acceleration_at_finger_m_per_s2,
                "measured_acceleration_at_finger_m_per_s2": report.at_finger[i],
            }
            for i, (zone, state, promise) in enumerate(zip(device.zones, click.states, click.zones, strict=True))
        ],
        "greatest_acceleration_under_a_finger_m_per_s2": max(report.felt_m_per_s2, report.quiet_m_per_s2),
        "disagreement": report.disagreement,
    }
