"""A table's drives on another bar: what is left of their promises where they are played as they are."""

import statistics

import numpy as np

from engine.device import Device
from engine.table import Entry, Table
from engine.touch import ZoneState
from precompute.entries.performance import compute_figures
from precompute.entries.prediction import touched_zones
from precompute.fleet.error import FleetError
from precompute.fleet.figures import usual_entries
from precompute.model.assembly import Plant, assemble
from precompute.sampling.fingers import Touches, sample_touches


def judge_table(table: Table, device: Device) -> dict[str, float | None]:
    """Of the entries next to 20 dB, by name: contrasts on `device`, and what is lost of contrast and level.

    Raises FleetError for a bar with other zones or actuators.
    """
    for part in ("zones", "actuators"):
        own, other = ([thing.name for thing in getattr(each, part)] for each in (table.device, device))
        if own != other:
            raise FleetError(f"{table.path}: is for {part} {', '.join(own)}, this bar has {', '.join(other)}")
    plant, touches = assemble(device), sample_touches(device)
    judged = [(entry, *_judge(plant, touches, entry)) for entry in usual_entries(table)]
    level_lost_db = [entry.level_db - level_db for entry, level_db, _ in judged]
    pairs = [
        (e.expected_contrast_db, db) for e, _, db in judged if e.expected_contrast_db is not None and db is not None
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


def _judge(plant: Plant, touches: Touches, entry: Entry) -> tuple[float, float | None]:
    """Level of the weakest felt standard finger, and expected contrast; dB."""
    touched = touched_zones(entry.states)
    amplitude = np.array(entry.amplitudes) * np.exp(1j * np.array(entry.phases_rad))
    power = compute_figures(plant, touches, touched, np.array(entry.frequencies_hz), amplitude).power
    felt = np.array([entry.states[zone] is ZoneState.FELT for zone in touched])
    level_db = float(10 * np.log10(power[0, felt].min()))
    if felt.all():
        return level_db, None
    mean = power[1:].mean(axis=0)
    return level_db, float(10 * np.log10(mean[felt].min() / mean[~felt].max()))
