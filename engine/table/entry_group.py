"""The group `entries` of a table file: a drive and its promises for each level and state."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from engine.device import Device
from engine.table.entry import Entry, EntrySpread, Percentiles, WorstCase, ZonePromise
from engine.table.file import TableWriter, Variable, is_text
from engine.touch import ZoneState

_ROW = ("level", "state")
ENTRY_VARIABLES = {
    "frequencies_hz": Variable("drive_frequency", (*_ROW, "actuator"), "Hz", "frequency of each actuator"),
    "amplitudes": Variable("drive_amplitude", (*_ROW, "actuator"), "1", "amplitude as a fraction of full scale"),
    "phases_rad": Variable("drive_phase", (*_ROW, "actuator"), "rad", "phase of each actuator"),
    "level_db": Variable("felt_level", _ROW, "dB", "sensation level of the weakest felt finger"),
    "reached_db": Variable("reached_level", _ROW, "dB", "level that is compared with the wanted one"),
    "achieved": Variable("achieved", _ROW, "1", "1: the wanted level is reached in every felt zone"),
    "contrast_db": Variable("contrast", _ROW, "dB", "weakest felt over strongest quiet finger; NaN: nothing is quiet"),
    "expected_contrast_db": Variable(
        "expected_contrast", _ROW, "dB", "the same, levels averaged in power over the fingers looked at"
    ),
    "localized_factor": Variable("localized_factor", _ROW, "1", "share of the felt zones, paper eq. (10)"),
    "objective": Variable("objective", _ROW, "1", "what was maximised above the level"),
    "upper_bound": Variable("upper_bound", _ROW, "1", "no drive does better: a share, or dB, as the objective is"),
    "optimality_gap_db": Variable("optimality_gap", _ROW, "dB", "what the bound leaves open"),
    "t90_s": Variable("rise_time", _ROW, "s", "t90 of the slowest felt finger"),
    "family": Variable("family", _ROW, "1", "single tone, coherent, two tones or several tones"),
    "limited_by": Variable("limited_by", _ROW, "1", "what limited the drive"),
}
WORST_VARIABLES = {
    "level_db": Variable("worst_felt_level", _ROW, "dB", "weakest felt finger of all that were looked at"),
    "quiet_level_db": Variable("worst_quiet_level", _ROW, "dB", "strongest quiet finger of all; NaN: none is quiet"),
    "contrast_db": Variable("worst_contrast", _ROW, "dB", "least contrast over the fingers; NaN: none is quiet"),
    "localized_factor": Variable("worst_localized_factor", _ROW, "1", "least over the fingers"),
    "t90_s": Variable("worst_rise_time", _ROW, "s", "greatest over the fingers"),
}
_SPREAD = (*_ROW, "spread")
SPREAD_VARIABLES = {
    "felt": Variable("felt_level_spread", _SPREAD, "dB", "weakest felt finger over the sampled cases"),
    "quiet": Variable("quiet_level_spread", _SPREAD, "dB", "strongest quiet finger over them; NaN: none is quiet"),
    "contrast": Variable("contrast_spread", _SPREAD, "dB", "contrast over them; NaN: nothing is quiet"),
}
_PERCENTILES = ("5 %", "50 %", "95 %")
_ZONE = (*_ROW, "zone")
_END = (*_ZONE, "end")
ZONE_VARIABLES = {
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


def write_entries(writer: TableWriter, entries: Sequence[Entry], device: Device) -> None:
    """Write the entries group. The entries are every state at the first level, in the same order at the next ..."""
    levels_db = list(dict.fromkeys(entry.wanted_level_db for entry in entries))
    states = [entry.index for entry in entries[: len(entries) // len(levels_db)]]
    writer.write("entries", Variable.names("actuator"), [actuator.name for actuator in device.actuators])
    writer.write("entries", Variable.names("zone"), [zone.name for zone in device.zones])
    writer.write("entries", Variable("end", ("end",), "1", "of a range"), ["least", "greatest"])
    level = Variable("level", ("level",), "dB", "wanted sensation level of every felt finger; infinite: full scale")
    writer.write("entries", level, np.array(levels_db, dtype=np.float64))
    index = Variable("state", ("state",), "1", "sum of zone state times 3**zone")
    writer.write("entries", index, np.array(states, dtype=np.int64))
    rows = (len(levels_db), len(states))
    for key, variable in ENTRY_VARIABLES.items():
        _write_column(writer, variable, [getattr(entry, key) for entry in entries], rows)
    for key, variable in WORST_VARIABLES.items():
        _write_column(writer, variable, [getattr(entry.worst_case, key) for entry in entries], rows)
    for key, variable in ZONE_VARIABLES.items():
        _write_column(writer, variable, [[getattr(zone, key) for zone in entry.zones] for entry in entries], rows)
    spreads = [entry.spread for entry in entries if entry.spread is not None]
    if len(spreads) == len(entries):
        which = Variable("spread", ("spread",), "1", "how many of the sampled cases lie below")
        writer.write("entries", which, list(_PERCENTILES))
        for key, variable in SPREAD_VARIABLES.items():
            _write_column(writer, variable, [_numbers(getattr(spread, key)) for spread in spreads], rows)


def _write_column(writer: TableWriter, variable: Variable, column: list[Any], rows: tuple[int, int]) -> None:
    if is_text(column):
        writer.write("entries", variable, np.array(column, dtype=object).reshape(rows))
        return
    if variable.dimensions[-1] == "end":
        column = [[(np.nan, np.nan) if value is None else value for value in row] for row in column]
    values = np.array(column, dtype=np.float64)  # None becomes NaN
    writer.write("entries", variable, values.reshape(*rows, *values.shape[1:]))


def _numbers(found: Percentiles | None) -> tuple[float, float, float]:
    return (np.nan, np.nan, np.nan) if found is None else (found.low_db, found.middle_db, found.high_db)


def read_entries(group: Any, device: Device) -> Iterator[Entry]:
    """Entries of an open group, in its order."""

    def columns(variables: Mapping[str, Variable]) -> dict[str, list[Any]]:
        # Tables of revision 3 have no reached_level.
        there = {key: variable for key, variable in variables.items() if variable.name in group.variables}
        return {key: _read_column(group, variable) for key, variable in there.items()}

    levels_db = [float(level_db) for level_db in group.variables["level"][...]]
    own, worst, zones = (columns(part) for part in (ENTRY_VARIABLES, WORST_VARIABLES, ZONE_VARIABLES))
    # Tables of revision 3 state no spread.
    spread = columns(SPREAD_VARIABLES) if SPREAD_VARIABLES["felt"].name in group.variables else None
    states = len(own["achieved"]) // len(levels_db)
    for row in range(len(own["achieved"])):
        values: dict[str, Any] = {key: column[row] for key, column in own.items()}
        values |= {key: tuple(value) for key, value in values.items() if isinstance(value, list)}
        yield Entry(
            **values | {"achieved": bool(values["achieved"])},
            wanted_level_db=levels_db[row // states],
            worst_case=WorstCase(**{key: column[row] for key, column in worst.items()}),
            zones=tuple(_read_zone(zones, row, z, zone.name) for z, zone in enumerate(device.zones)),
            spread=None if spread is None else EntrySpread(**{key: _read(spread[key][row]) for key in spread}),
        )


def _read(found: list[float | None]) -> Any:
    return None if None in found else Percentiles(*found)  # type: ignore[arg-type]  # none is None


def _read_column(group: Any, variable: Variable) -> list[Any]:
    """One value an entry; NaN, which stands for absence, as None."""
    values = np.asarray(group.variables[variable.name][...])
    values = values.reshape(-1, *values.shape[2:])
    if values.dtype.kind == "f":
        values = np.where(np.isnan(values), None, values)  # type: ignore[call-overload]  # an array of objects
    rows: list[Any] = values.tolist()
    return rows


def _read_zone(zones: Mapping[str, list[Any]], row: int, zone: int, name: str) -> ZonePromise:
    figures = {key: column[row][zone] for key, column in zones.items()}
    ranges = {key: _range(value) for key, value in figures.items() if isinstance(value, list)}
    return ZonePromise(**figures | ranges | {"name": name, "state": ZoneState(int(figures["state"]))})


def _range(ends: list[float | None]) -> tuple[float, float] | None:
    least, greatest = ends
    return None if least is None or greatest is None else (least, greatest)
