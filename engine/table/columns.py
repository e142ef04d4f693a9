"""The group `entries` of a table file: an array for each figure, with a row for each state of the zones at a level.

The tables of variables below say which field of `Entry` is which array, None is stored as NaN, and the order of rows is
that of the entries that were given. tables/FORMAT.md lists the same arrays for readers in other languages.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple
from functools import partial
from typing import Any

import h5py
import numpy as np

from engine.device import Device
from engine.table.entry import Entry, EntrySpread, Percentiles, WorstCase, ZonePrediction
from engine.table.file import TableWriter, Values, Variable, is_text
from engine.table.soundness import Arrays
from engine.touch import ZoneState

_STATE = Variable("state", ("state",), "1", "sum of zone state times 3**zone")
_ENTRY = ("level", "state")
_ENTRY_VARIABLES = {
    "frequencies_hz": Variable("drive_frequency", (*_ENTRY, "actuator"), "Hz", "frequency of each actuator"),
    "amplitudes": Variable("drive_amplitude", (*_ENTRY, "actuator"), "1", "amplitude as a fraction of full scale"),
    "phases_rad": Variable("drive_phase", (*_ENTRY, "actuator"), "rad", "phase of each actuator"),
    "level_db": Variable("felt_level", _ENTRY, "dB", "sensation level of the weakest felt finger"),
    "reached_db": Variable("reached_level", _ENTRY, "dB", "level that is compared with the wanted one"),
    "achieved": Variable("achieved", _ENTRY, "1", "1: the wanted level is reached in every felt zone"),
    "contrast_db": Variable(
        "contrast", _ENTRY, "dB", "weakest felt over strongest quiet finger; NaN: nothing is quiet"
    ),
    "expected_contrast_db": Variable(
        "expected_contrast", _ENTRY, "dB", "the same, levels averaged in power over the fingers looked at"
    ),
    "localized_factor": Variable("localized_factor", _ENTRY, "1", "share of the felt zones, paper eq. (10)"),
    "objective": Variable("objective", _ENTRY, "1", "what was maximised above the level"),
    "upper_bound": Variable("upper_bound", _ENTRY, "1", "no drive does better: a share, or dB, as the objective is"),
    "optimality_gap_db": Variable("optimality_gap", _ENTRY, "dB", "what the bound leaves open"),
    "t90_s": Variable("rise_time", _ENTRY, "s", "t90 of the slowest felt finger; 10: longer"),
    "family": Variable("family", _ENTRY, "1", "single tone, coherent, two tones or several tones"),
    "limited_by": Variable("limited_by", _ENTRY, "1", "what limited the drive"),
}
_WORST_VARIABLES = {
    "level_db": Variable("worst_felt_level", _ENTRY, "dB", "weakest felt finger of all that were looked at"),
    "quiet_level_db": Variable("worst_quiet_level", _ENTRY, "dB", "strongest quiet finger of all; NaN: none is quiet"),
    "contrast_db": Variable("worst_contrast", _ENTRY, "dB", "least contrast over the fingers; NaN: none is quiet"),
    "localized_factor": Variable("worst_localized_factor", _ENTRY, "1", "least over the fingers"),
    "t90_s": Variable("worst_rise_time", _ENTRY, "s", "greatest over the fingers; 10: longer"),
}
_SPREAD = (*_ENTRY, "spread")
_SPREAD_VARIABLES = {
    "felt": Variable("felt_level_spread", _SPREAD, "dB", "weakest felt finger over the sampled cases"),
    "quiet": Variable("quiet_level_spread", _SPREAD, "dB", "strongest quiet finger over them; NaN: none is quiet"),
    "contrast": Variable("contrast_spread", _SPREAD, "dB", "contrast over them; NaN: nothing is quiet"),
}
_ZONE = (*_ENTRY, "zone")
_END = (*_ZONE, "end")
_ZONE_VARIABLES = {
    "state": Variable("zone_state", _ZONE, "1", "0 free, 1 quiet, 2 felt"),
    "share": Variable("share", _ZONE, "1", "localized factor of the zone"),
    "share_range": Variable("share_range", _END, "1", "least and greatest over the fingers looked at"),
    "peak_acceleration_m_per_s2": Variable("peak_acceleration", _ZONE, "m s-2", "greatest in the zone"),
    "peak_acceleration_range_m_per_s2": Variable(
        "peak_acceleration_range", _END, "m s-2", "least and greatest over the fingers looked at"
    ),
    "peak_position_m": Variable("peak_position", _ZONE, "m", "where it is, from the bar's start"),
    "dead_acceleration_m_per_s2": Variable("dead_spot", _ZONE, "m s-2", "least in the zone"),
    "dead_position_m": Variable("dead_position", _ZONE, "m", "where it is, from the bar's start"),
    "acceleration_at_finger_m_per_s2": Variable(
        "acceleration_at_finger", _ZONE, "m s-2", "under the finger; NaN: no finger"
    ),
    "sensation_level_db": Variable("sensation_level", _ZONE, "dB", "above the detection threshold; NaN: no finger"),
    "sensation_level_range_db": Variable(
        "sensation_level_range", _END, "dB", "least and greatest over the fingers looked at; NaN: no finger"
    ),
}


# ---- writing ---------------------------------------------------------------------------------------------


def write_entries(writer: TableWriter, entries: Sequence[Entry], device: Device) -> None:
    """Write the group `entries`. The entries are every state at the first level, in the same order at the next ..."""
    write, levels_db = partial(writer.write, "entries"), list(dict.fromkeys(entry.wanted_level_db for entry in entries))
    states = [entry.index for entry in entries[: len(entries) // len(levels_db)]]
    rows = (len(levels_db), len(states))
    write(Variable.names("actuator"), [actuator.name for actuator in device.actuators])
    write(Variable.names("zone"), [zone.name for zone in device.zones])
    write(Variable("end", ("end",), "1", "of a range"), ["least", "greatest"])
    level = Variable("level", ("level",), "dB", "wanted sensation level of every felt finger; infinite: full scale")
    write(level, np.array(levels_db, dtype=np.float64))
    write(_STATE, np.array(states, dtype=np.int64))
    for key, variable in _ENTRY_VARIABLES.items():
        write(variable, _array([getattr(entry, key) for entry in entries], rows))
    for key, variable in _WORST_VARIABLES.items():
        write(variable, _array([getattr(entry.worst_case, key) for entry in entries], rows))
    for key, variable in _ZONE_VARIABLES.items():
        column = [[getattr(zone, key) for zone in entry.zones] for entry in entries]
        if variable.dimensions == _END:
            column = [[(np.nan, np.nan) if value is None else value for value in row] for row in column]
        write(variable, _array(column, rows))
    spreads = [entry.spread for entry in entries if entry.spread is not None]
    if len(spreads) == len(entries):
        write(Variable("spread", ("spread",), "1", "how many of the sampled cases lie below"), ["5 %", "50 %", "95 %"])
        for key, variable in _SPREAD_VARIABLES.items():
            write(variable, _array([_numbers(getattr(spread, key)) for spread in spreads], rows))


def _array(column: Sequence[Any], rows: tuple[int, ...]) -> Values:
    """A column as an array whose first axes have the lengths `rows`; None becomes NaN, texts stay texts."""
    if is_text(column):
        return np.array(column, dtype=object).reshape(rows)
    values = np.array(column, dtype=np.float64)
    return values.reshape(*rows, *values.shape[1:])


def _numbers(levels: Percentiles | None) -> tuple[float, ...]:
    return (np.nan,) * 3 if levels is None else astuple(levels)


# ---- reading ---------------------------------------------------------------------------------------------


def read_entries(arrays: Arrays, device: Device) -> Iterator[Entry]:
    """Entries of the group with these open arrays, in its order."""

    def columns(variables: Mapping[str, Variable]) -> dict[str, list[Any]]:
        # Only entries that were solved for spreads have them.
        there = {key: variable for key, variable in variables.items() if variable.name in arrays}
        return {key: _column(arrays, variable, axes=2) for key, variable in there.items()}

    levels_db = [float(level_db) for level_db in arrays["level"][...]]
    own, worst, zones = (columns(part) for part in (_ENTRY_VARIABLES, _WORST_VARIABLES, _ZONE_VARIABLES))
    spreads = columns(_SPREAD_VARIABLES)
    states = len(own["achieved"]) // len(levels_db)
    for row in range(len(own["achieved"])):
        values: dict[str, Any] = {key: column[row] for key, column in own.items()}
        values |= {key: tuple(value) for key, value in values.items() if isinstance(value, list)}
        spread = {key: None if None in column[row] else Percentiles(*column[row]) for key, column in spreads.items()}
        yield Entry(
            **values | {"achieved": bool(values["achieved"])},
            wanted_level_db=levels_db[row // states],
            worst_case=WorstCase(**{key: column[row] for key, column in worst.items()}),
            zones=tuple(_zone_promise(zones, row, z, zone.name) for z, zone in enumerate(device.zones)),
            spread=EntrySpread(**spread) if spread else None,  # type: ignore[arg-type]  # felt is never None
        )


def _column(arrays: Arrays, variable: Variable, *, axes: int) -> list[Any]:
    """The values of each row, whose first `axes` axes are the rows; NaN, which stands for absence, as None."""
    dataset = arrays[variable.name]
    values = np.asarray((dataset.asstr() if h5py.check_string_dtype(dataset.dtype) else dataset)[...])
    values = values.reshape(-1, *values.shape[axes:])
    if values.dtype.kind == "f":
        values = np.where(np.isnan(values), None, values)  # type: ignore[call-overload]  # an array of objects
    rows: list[Any] = values.tolist()
    return rows


def _zone_promise(zones: Mapping[str, list[Any]], row: int, zone: int, name: str) -> ZonePrediction:
    figures = {key: column[row][zone] for key, column in zones.items()}
    ranges = {k: None if None in ends else tuple(ends) for k, ends in figures.items() if isinstance(ends, list)}
    return ZonePrediction(**figures | ranges | {"name": name, "state": ZoneState(int(figures["state"]))})
