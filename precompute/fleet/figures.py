"""Figures of merit of a table, and of its drives played unchanged on another bar."""

import math
import statistics
from collections.abc import Callable

import numpy as np

from engine.device import Device
from engine.table import Entry, Table, TableError
from engine.table.entry import DEFAULT_LEVEL_DB
from engine.touch import ZoneState
from precompute.entries.prediction import touched_zones
from precompute.entries.solver import tabulated_states
from precompute.fleet.units import FleetError
from precompute.model.assembly import Plant, assemble
from precompute.predict.performance import compute_figures
from precompute.sampling.fingers import SampledFingers, sample_fingers


def compute_table_figures(table: Table) -> dict[str, float | None]:
    """Figures by name with units; None where no state has the figure. Raises TableError if a state is missing.

    Contrasts are those of the usual entries.
    """
    states = len(tabulated_states(table.device))
    for level_db in table.levels_db:
        if len(table.entries_of(level_db)) != states:
            raise TableError(
                f"{table.path}: {len(table.entries_of(level_db))} entries at {level_db:g} dB, not {states}"
            )
    usual = usual_entries(table)
    expected_db = [e.expected_contrast_db for e in usual if e.expected_contrast_db is not None]
    worst_db = [e.worst_case.contrast_db for e in usual if e.worst_case.contrast_db is not None]
    return {
        "worst_expected_contrast_db": _of(min, expected_db),
        "median_expected_contrast_db": _of(statistics.median, expected_db),
        "worst_contrast_db": _of(min, worst_db),
        "least_full_level_db": _of(min, [entry.level_db for entry in table.entries_of(math.inf)]),
        "slowest_t90_s": _of(max, [entry.t90_s for entry in usual]),
        "out_of_reach": sum(not entry.achieved for entry in table.entries),
        "clicks": len(table.clicks),
        "click_pitch_mm": 1e3 * table.places.pitch_m if table.clicks else None,
        "weakest_click_db": _of(min, table.clicks.felt_low_db.tolist()),
    }


def usual_entries(table: Table) -> tuple[Entry, ...]:
    """The entries of the tabulated level next to 20 dB."""
    return table.entries_of(min(table.levels_db, key=lambda level_db: abs(level_db - DEFAULT_LEVEL_DB)))


def _of(pick: Callable[[list[float]], float], values: list[float]) -> float | None:
    picked = pick(values) if values else math.inf
    return picked if math.isfinite(picked) else None


def evaluate_table(table: Table, device: Device) -> dict[str, float | None]:
    """Contrasts of the usual entries on another `device`, and the loss of contrast and level there, by name.

    Raises FleetError for a bar with other zones or actuators.
    """
    for part in ("zones", "actuators"):
        own, other = ([thing.name for thing in getattr(each, part)] for each in (table.device, device))
        if own != other:
            raise FleetError(f"{table.path}: is for {part} {', '.join(own)}, this bar has {', '.join(other)}")
    plant, sampled = assemble(device), sample_fingers(device)
    evaluated = [(entry, *_evaluate(plant, sampled, entry)) for entry in usual_entries(table)]
    level_lost_db = [entry.level_db - level_db for entry, level_db, _ in evaluated]
    pairs = [
        (e.expected_contrast_db, db) for e, _, db in evaluated if e.expected_contrast_db is not None and db is not None
    ]
    contrast_db, lost_db = [db for _, db in pairs], [promised_db - db for promised_db, db in pairs]
    return {
        "worst_expected_contrast_db": min(contrast_db, default=None),
        "median_expected_contrast_db": statistics.median(contrast_db) if contrast_db else None,
        "median_contrast_lost_db": statistics.median(lost_db) if lost_db else None,
        "greatest_contrast_lost_db": max(lost_db, default=None),
        "greatest_level_lost_db": max(level_lost_db),
        "greatest_level_gained_db": -min(level_lost_db),
    }


def _evaluate(plant: Plant, sampled: SampledFingers, entry: Entry) -> tuple[float, float | None]:
    """Level of the weakest felt standard finger, and expected contrast, dB."""
    touched = touched_zones(entry.states)
    amplitude = np.array(entry.amplitudes) * np.exp(1j * np.array(entry.phases_rad))
    power = compute_figures(plant, sampled, touched, np.array(entry.frequencies_hz), amplitude).power
    felt = np.array([entry.states[zone] is ZoneState.FELT for zone in touched])
    level_db = float(10 * np.log10(power[0, felt].min()))
    if felt.all():
        return level_db, None
    mean = power[1:].mean(axis=0)
    return level_db, float(10 * np.log10(mean[felt].min() / mean[~felt].max()))
