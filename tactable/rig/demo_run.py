"""The demo: recorded touches through the engine, the wire and the emulated firmware to the simulated surface.

The report says for every rendered command whether the simulated surface does, under the fingers where the recording has
them, what was promised for these positions. JSON keys that begin with `measured_` hold simulated values; their names
are kept, since programs read them.

Promises are for the positions that the fingers really have, with standard fingers on the surface as it is described.
That of a steady drive was solved from modes in frequency, that of a click comes from the waveform of its table row;
the simulation takes the bytes that the firmware got to the surface in time. So they check each other and the whole
chain between them. Neither is a measurement.
"""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from base.arrays import Array
from base.plain import to_plain
from engine.device import Device
from engine.effects.rules import DEFAULT_EFFECTS, Drives, Effects
from engine.loop.observer import Stage
from engine.steady import SteadyDrive
from engine.table import ClickEntry, Table
from engine.table.best_rows import BestRow
from engine.touch import Placement
from engine.touch.finger_tracker import ZoneFinder
from engine.touch.sources.recording import Recording
from firmware_link.emulator.drive_log import DriveEvent
from precompute.builder.table_build import Progress, build_table
from precompute.model.assembly import assemble
from precompute.model.gram import compute_steady_state
from precompute.parallel.pool import available_cores
from tactable.explain.words import placement_json, zone_lists
from tactable.rig.promises import Promise, Promises
from tactable.rig.ready import early_options, early_path, open_cached
from tactable.rig.rig import LiveRun, Wanted, first_applied, play, wanted_of
from tactable.rig.simulated_surface import Felt, SimulatedClick, SimulatedDrive, SimulatedSurface

MOST_DRIVES = 40  # most steady drives of a run whose promise is compared with the simulation
LONGEST_REPLAY_S = 12.0  # a longer recording is replayed faster, so that the demo ends within a minute
AGREEMENT = 0.02  # the fraction by which promise and simulation may differ
STILLEST_DB = -20.0
"""Fingers that are to feel less are compared with this: the wire's steps of 0.01 Hz change such a rest by up to 3 %."""


@dataclass(frozen=True)
class _CommandReport:
    """A command and what was promised of it."""

    promise: Promise

    @property
    def placement(self) -> Placement:
        """The fingers that the command was made for."""
        return self.promise.placement

    def _difference(self, simulated_m_per_s2: Array) -> float:
        """Greatest difference, relative to the promise, or to STILLEST_DB where that is less."""
        promised_m_per_s2 = self.promise.acceleration_m_per_s2
        least_m_per_s2 = promised_m_per_s2 * 10 ** ((STILLEST_DB - self.promise.level_db) / 20)
        return float(
            (abs(simulated_m_per_s2 - promised_m_per_s2) / np.maximum(promised_m_per_s2, least_m_per_s2)).max()
        )


@dataclass(frozen=True)
class DriveReport(_CommandReport):
    """A steady drive, solved or looked up for zones: its promise, and what it did when it was held.

    promised_factor: share of kinetic energy in the zones that hold the felt fingers (felt_zones, indices).
    """

    drive: SteadyDrive | BestRow
    simulated: SimulatedDrive
    felt_zones: tuple[int, ...]
    promised_factor: float

    @property
    def frequency_text(self) -> str:
        """Its frequency, or both, such as "150 & 200 Hz"."""
        sounding = zip(self.drive.frequencies_hz, self.drive.amplitudes, strict=True)
        return f"{' & '.join(f'{hz:g}' for hz in dict.fromkeys(hz for hz, size in sounding if size))} Hz"

    @property
    def simulated_factor(self) -> float:
        """Localized factor of the felt zones, simulated."""
        return float(self.simulated.share[list(self.felt_zones)].sum())

    @property
    def disagreement(self) -> float:
        """Greatest relative difference of the acceleration under each finger, and of the localized factor."""
        factor = abs(self.simulated_factor / self.promised_factor - 1) if self.felt_zones else 0.0
        return max(factor, self._difference(self.simulated.at_finger))


@dataclass(frozen=True)
class ClickReport(_CommandReport):
    """A click: the table's row for the nearest places, and what its waveform did under the fingers."""

    click: ClickEntry
    simulated: SimulatedClick

    @property
    def disagreement(self) -> float:
        """Greatest relative difference of the acceleration under each finger."""
        return self._difference(self.simulated.at_finger)


@dataclass(frozen=True)
class DemoReport:
    """What the demo found. SIMULATED: digitizer (where it is the shipped recording), firmware and surface."""

    device: Device
    table: Path
    recording: Recording
    speed: float
    run: LiveRun
    drives: tuple[DriveReport, ...]  # steady drives that were compared, at most MOST_DRIVES evenly over the run
    clicks: tuple[ClickReport, ...]  # what was rendered by a click
    drives_applied: int  # number of different steady drives that the firmware applied
    missed: tuple[Wanted, ...]  # commands that were sent in time and never applied by the firmware
    not_rendered: tuple[Wanted, ...]  # what ended before a stalled machine brought it to the firmware
    felt: Felt | None  # what the fingers felt; None where no state changed

    @property
    def agrees(self) -> bool:
        """Whether every command that was compared keeps its promise, and none was missed."""
        found = [each.disagreement for each in self.drives] + [each.disagreement for each in self.clicks]
        return not self.missed and all(disagreement <= AGREEMENT for disagreement in found)


def table_for(device: Device, path: Path, progress: Progress) -> Table:
    """The table of `device` at `path`, or the early one beside it, which is built with clicks at few places if need be.

    Such a table is there after seconds of processor time; the page of the demo builds the fine one.
    """
    found = open_cached(device, path)
    if found is not None and found.clicks and not found.is_shipped:
        return found
    if found is not None:
        found.close()
    path.parent.mkdir(parents=True, exist_ok=True)
    return table_at(device, early_path(path), progress, is_outdated=True)


def table_at(device: Device, path: Path, progress: Progress, *, is_outdated: bool = False) -> Table:
    """Open the table of `device` at `path`. One that is missing or outdated is built first, with few clicks."""
    if is_outdated or not path.exists():
        build_table(device, path, click_options=early_options(), workers=available_cores(), progress=progress)
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
    reporter = Reporter(table, effects.drives)
    applied = first_applied(run)
    felt = reporter.surface.feel(run, LONGEST_REPLAY_S + 1.0) if run.moments else None
    # Each drive is held for seconds of simulated time, and a finger that drags under one gets hundreds of them.
    held = [wanted for wanted, event in applied.items() if event.waveform is None]
    compared = [held[round(k)] for k in np.linspace(0, len(held) - 1, min(len(held), MOST_DRIVES))]
    drives = tuple(reporter.report_drive(wanted, applied[wanted]) for wanted in compared)
    sounded = ((wanted, event) for wanted, event in applied.items() if event.waveform is not None)
    clicks = tuple(reporter.report_click(wanted, event) for wanted, event in sounded)
    missed, not_rendered = find_missed(run, applied)
    return DemoReport(
        table.device, table.path, recording, speed, run, drives, clicks, len(held), missed, not_rendered, felt
    )


class Reporter:
    """Compares what commands of a table's runs promise with what the simulated surface does under their fingers."""

    def __init__(self, table: Table, drives: Drives = Drives.POSITIONS) -> None:
        self.surface, self._drives = SimulatedSurface(table.device), drives
        self._device, self._promises = table.device, Promises(table)
        self._plant = assemble(table.device)
        self._zone_at = ZoneFinder(table.device).zone_at

    def report_drive(self, wanted: Wanted, event: DriveEvent) -> DriveReport:
        """Report a steady drive that the firmware got."""
        placement = wanted.placement
        drive: SteadyDrive | BestRow
        if self._drives is Drives.ZONES:
            drive, promise = self._promises.of_row(placement, wanted.level_db)
        else:
            strongest = max(event.channels, key=lambda channel: channel.amplitude)
            drive, promise = self._promises.of_drive(placement, wanted.level_db, strongest.frequency_hz)
        hz = np.array(drive.frequencies_hz)
        loaded = self._plant.with_fingers(placement.position_m, self._device.finger)
        zones = {self._zone_at(placement.position_m[finger]) for finger in placement.felt} - {None}
        felt_zones = tuple(sorted(zone for zone in zones if zone is not None))
        share = compute_steady_state(loaded, hz, drive.complex_amplitudes).share
        return DriveReport(
            promise,
            drive,
            self.surface.simulate_held(event, placement.position_m),
            felt_zones,
            float(share[list(felt_zones)].sum()),
        )

    def report_click(self, wanted: Wanted, event: DriveEvent) -> ClickReport:
        """Report a click that the firmware got."""
        click, promise = self._promises.of_click(wanted.placement, wanted.level_db)
        return ClickReport(promise, click, self.surface.simulate_click(event, wanted.placement.position_m))


def find_missed(run: LiveRun, applied: Collection[Wanted]) -> tuple[tuple[Wanted, ...], tuple[Wanted, ...]]:
    """What was wanted and not applied: first what should have been, then the rest.

    The rest was replaced before it was sent, or refused because it came too late.
    """
    due = dict[Wanted, bool]()
    for change in run.trace:
        wanted = wanted_of(change)
        if wanted is None or wanted in applied:
            continue
        due[wanted] = due.get(wanted, False) or (change.drive_sequence is not None and not run.came_late(change))
    return tuple(wanted for wanted in due if due[wanted]), tuple(w for w in due if not due[w])


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
            "states": [_drive_json(report.device, drive) for drive in report.drives],
            "steady_drives_applied": report.drives_applied,
            "clicks": [_click_json(report.device, click) for click in report.clicks],
            "missed_states": [_key_json(report.device, key) for key in report.missed],
            "states_not_rendered": [_key_json(report.device, key) for key in report.not_rendered],
            "agreement": AGREEMENT,
            "agrees": report.agrees,
        }
    )


def _key_json(device: Device, wanted: Wanted) -> dict[str, Any]:
    fingers = placement_json(device, wanted.placement)
    return {"fingers": fingers, "level_db": wanted.level_db, "click": wanted.is_click}


def _drive_json(device: Device, report: DriveReport) -> dict[str, Any]:
    drive = report.drive
    return {
        **zone_lists(device, report.placement),
        "wanted_level_db": drive.wanted_level_db,
        "level_db": drive.level_db if isinstance(drive, BestRow) else drive.weakest_felt_db,
        "achieved": drive.achieved,
        **_origin_json(drive),
        "frequencies_hz": drive.frequencies_hz,
        "amplitudes": drive.amplitudes,
        "phases_rad": drive.phases_rad,
        "promised_localized_factor": report.promised_factor,
        "measured_localized_factor": report.simulated_factor,
        **_levels_json(device, report, report.simulated.at_finger),
    }


def _origin_json(drive: SteadyDrive | BestRow) -> dict[str, Any]:
    if isinstance(drive, BestRow):
        return {
            "drives": Drives.ZONES,
            "row": {"group": drive.group, "index": drive.index, "localized_factor": drive.localized_factor},
        }
    objective = {"objective": drive.objective, "expected_contrast_db": drive.expected_contrast_db}
    return {"drives": Drives.POSITIONS, **objective}


def _click_json(device: Device, report: ClickReport) -> dict[str, Any]:
    click = report.click
    return {
        **zone_lists(device, report.placement),
        "places_m": click.placement.position_m,
        "tolerance_m": click.tolerance_m,
        "wanted_level_db": click.wanted_level_db,
        "level_db": click.level_db,
        "achieved": click.achieved,
        "amplitude": click.amplitude,
        "length_s": click.length_s,
        "exceeds_s": click.exceeds_at_s(),
        "felt_level_db": click.felt,
        "quiet_level_db": click.quiet,
        **_levels_json(device, report, report.simulated.at_finger),
    }


def _levels_json(device: Device, report: DriveReport | ClickReport, at_finger: Array) -> dict[str, Any]:
    """Promise and simulation of every finger."""
    promise = report.promise
    return {
        "fingers": [
            {
                **finger,
                "promised_level_db": promise.level_db[k],
                "promised_acceleration_at_finger_m_per_s2": promise.acceleration_m_per_s2[k],
                "measured_acceleration_at_finger_m_per_s2": at_finger[k],
            }
            for k, finger in enumerate(placement_json(device, report.placement))
        ],
        "disagreement": report.disagreement,
    }
