"""The groups `entries` and `clicks` of a table file: an array for each figure, with a row for each state.

A row of `entries` is a state at a level, a row of `clicks` a state. Both are written and read in the same way: the
tables of variables below say which field of `Entry` or `ClickEntry` is which array, None is stored as NaN, and the
order of rows is that of the entries and clicks that were given. tables/FORMAT.md lists the same arrays for readers in
other languages.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple
from functools import partial
from typing import Any

import numpy as np

from engine.device import Device
from engine.table.click import ClickEntry, ClickZone, LevelSpread
from engine.table.entry import Entry, EntrySpread, Percentiles, WorstCase, ZonePrediction
from engine.table.file import TableWriter, Values, Variable, is_text
from engine.touch import ZoneState
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, Basis, BasisSet
from firmware_link.protocol.errors import MessageError

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

_CLICK = ("state",)
_FUNCTIONS = Variable(
    "basis_function",
    ("function", "sample"),
    "1",
    "base displacement as a fraction of full scale, straight lines between samples, 0 beyond the samples of its set",
    scale=1 / SAMPLE_FULL_SCALE,
)
_FUNCTION_ACTUATOR = Variable("function_actuator", ("function",), "1", "index of the actuator that the function moves")
_FUNCTION_SET = Variable("function_set", ("function",), "1", "index of the set that the function belongs to")
_SET_SAMPLES = Variable("set_samples", ("set",), "1", "how many samples the functions of the set have")
_WEIGHTS = Variable(
    "weight", (*_CLICK, "weight_of_set"), "1", "of each function of the click's set, in order, in steps; 0 beyond"
)
_FRACTION_BITS = Variable("fraction_bits", _CLICK, "1", "a step of the weights is 2**-fraction_bits")
_BASIS_SET = Variable("basis_set", _CLICK, "1", "index of the set whose functions are weighted")
_ZONE_STATE = Variable("zone_state", ("state", "zone"), "1", "0 free, 1 quiet, 2 felt")
_FELT = Variable("felt_level", ("state", "spread"), "dB", "peak of the weakest felt finger above its threshold")
_QUIET = Variable("quiet_level", ("state", "spread"), "dB", "peak of the strongest quiet finger; NaN: none is quiet")
_ZONE_ACCELERATION = Variable(
    "acceleration_at_finger", ("state", "zone"), "m s-2", "peak in the nominal plant; NaN: no finger"
)
_ZONE_LEVEL = Variable("sensation_level", ("state", "zone"), "dB", "peak over threshold, nominal; NaN: no finger")
_EXCEEDS = Variable(
    "exceedance_time", ("state", "level"), "s", "when every felt finger has passed its threshold; NaN: one never does"
)
_CLICK_VARIABLES = {
    "wanted_level_db": Variable("wanted_level", _CLICK, "dB", "level asked for; infinite: as strong as can be"),
    "peak_s": Variable("peak_time", _CLICK, "s", "when the last felt finger has its peak"),
    "residual_from_s": Variable("residual_start", _CLICK, "s", "from when on the residual is taken"),
    "residual_db": Variable("residual_level", _CLICK, "dB", "strongest felt finger from then on"),
    "objective": Variable("objective", _CLICK, "1", "what was maximised"),
    "bound_db": Variable(
        "upper_bound", _CLICK, "dB", "no click of its tones is felt more strongly; mean of the plants"
    ),
    "gap_db": Variable("optimality_gap", _CLICK, "dB", "what the bound leaves open"),
    "achieved": Variable("achieved", _CLICK, "1", "1: the quiet level is kept and the wanted one reached"),
}


# ---- writing ---------------------------------------------------------------------------------------------


def write_entries(writer: TableWriter, entries: Sequence[Entry], device: Device) -> None:
    """Write the group `entries`. The entries are every state at the first level, in the same order at the next ..."""
    write, levels_db = partial(writer.write, "entries"), list(dict.fromkeys(entry.wanted_level_db for entry in entries))
    states = [entry.index for entry in entries[: len(entries) // len(levels_db)]]
    rows = (len(levels_db), len(states))
    _write_names(write, device)
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
            write(variable, _array([_numbers(getattr(spread, key), 3) for spread in spreads], rows))


def write_clicks(writer: TableWriter, clicks: Sequence[ClickEntry], device: Device) -> None:
    """Write the group `clicks` as tabulated: the basis, which all share, and every click at full amplitude."""
    assert all(click.basis.hash == clicks[0].basis.hash for click in clicks)
    write, rows, zones = partial(writer.write, "clicks"), (len(clicks),), [click.zones for click in clicks]
    weights = np.zeros((*rows, max(len(click.weights) for click in clicks)), dtype=np.int16)
    for row, click in zip(weights, clicks, strict=True):
        row[: len(click.weights)] = click.weights
    _write_names(write, device)
    spread = Variable("spread", ("spread",), "1", "nominal plant, and how many sampled plants lie below")
    write(spread, ["nominal", "5 %", "50 %", "95 %"])
    _write_basis(write, clicks[0].basis)
    level = Variable("level", ("level",), "dB", "that the click is played at; infinite: as it is")
    write(level, np.array(list(clicks[0].exceeds_s), dtype=np.float64))
    write(_STATE, np.array([click.index for click in clicks], dtype=np.int64))
    write(_WEIGHTS, weights)
    write(_FRACTION_BITS, np.array([click.fraction_bits for click in clicks], dtype=np.int64))
    write(_BASIS_SET, np.array([click.basis_set for click in clicks], dtype=np.int64))
    write(_ZONE_STATE, np.array([click.states for click in clicks], dtype=np.int64))
    write(_FELT, _array([_numbers(click.felt, 4) for click in clicks], rows))
    write(_QUIET, _array([_numbers(click.quiet, 4) for click in clicks], rows))
    write(_EXCEEDS, _array([list(click.exceeds_s.values()) for click in clicks], rows))
    write(_ZONE_ACCELERATION, _array([[z and z.acceleration_at_finger_m_per_s2 for z in row] for row in zones], rows))
    write(_ZONE_LEVEL, _array([[None if z is None else z.level_db for z in row] for row in zones], rows))
    for key, variable in _CLICK_VARIABLES.items():
        write(variable, _array([getattr(click, key) for click in clicks], rows))


def _write_basis(write: Callable[[Variable, Values], None], basis: Basis) -> None:
    longest = max(each.samples for each in basis.sets)
    padded = [np.pad(each.functions, ((0, 0), (0, longest - each.samples))) for each in basis.sets]
    sample = Variable("sample", ("sample",), "s", "time from the click's start")
    write(sample, np.arange(longest) / basis.sample_rate_hz)
    write(_FUNCTIONS, np.concatenate(padded))
    write(_FUNCTION_ACTUATOR, np.concatenate([each.actuators.astype(np.int64) for each in basis.sets]))
    sizes = [len(each.actuators) for each in basis.sets]
    write(_FUNCTION_SET, np.repeat(np.arange(len(sizes)), sizes))
    write(_SET_SAMPLES, np.array([each.samples for each in basis.sets], dtype=np.int64))


def _write_names(write: Callable[[Variable, Sequence[str]], None], device: Device) -> None:
    write(Variable.names("actuator"), [actuator.name for actuator in device.actuators])
    write(Variable.names("zone"), [zone.name for zone in device.zones])


def _array(column: Sequence[Any], rows: tuple[int, ...]) -> Values:
    """A column as an array whose first axes have the lengths `rows`; None becomes NaN, texts stay texts."""
    if is_text(column):
        return np.array(column, dtype=object).reshape(rows)
    values = np.array(column, dtype=np.float64)
    return values.reshape(*rows, *values.shape[1:])


def _numbers(levels: Percentiles | LevelSpread | None, count: int) -> tuple[float, ...]:
    return (np.nan,) * count if levels is None else astuple(levels)


# ---- reading ---------------------------------------------------------------------------------------------


def read_entries(group: Any, device: Device) -> Iterator[Entry]:
    """Entries of an open group, in its order."""

    def columns(variables: Mapping[str, Variable]) -> dict[str, list[Any]]:
        # Only entries that were solved for spreads have them.
        there = {key: variable for key, variable in variables.items() if variable.name in group.variables}
        return {key: _column(group, variable, axes=2) for key, variable in there.items()}

    levels_db = [float(level_db) for level_db in group.variables["level"][...]]
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


def read_clicks(group: Any) -> Iterator[ClickEntry]:
    """Clicks of an open group, in its order; raises ValueError for weights that are not those of a set."""
    basis = _read_basis(group)
    sizes = [len(each.actuators) for each in basis.sets]
    levels_db, weights = group.variables["level"][...].tolist(), np.asarray(group.variables[_WEIGHTS.name][...])
    parts = (_FRACTION_BITS, _BASIS_SET, _ZONE_STATE, _FELT, _QUIET, _EXCEEDS, _ZONE_ACCELERATION, _ZONE_LEVEL)
    columns = [_column(group, variable, axes=1) for variable in parts]
    figures = {key: _column(group, variable, axes=1) for key, variable in _CLICK_VARIABLES.items()}
    for row, (bits, number, states, felt, quiet, exceeds_s, at_finger, level_db) in enumerate(
        zip(*columns, strict=True)
    ):
        if not 0 <= number < len(sizes):
            raise ValueError(f"a click is of set {number} of a basis with {len(sizes)}")
        values = {key: column[row] for key, column in figures.items()}
        fingers = zip(at_finger, level_db, strict=True)
        yield ClickEntry(
            **values | {"achieved": bool(values["achieved"])},
            states=tuple(ZoneState(state) for state in states),
            basis=basis,
            basis_set=number,
            weights=weights[row, : sizes[number]],
            fraction_bits=bits,
            amplitude=1.0,
            felt=LevelSpread(*felt),
            quiet=None if None in quiet else LevelSpread(*quiet),
            zones=tuple(None if None in finger else ClickZone(*finger) for finger in fingers),
            exceeds_s=dict(zip(levels_db, exceeds_s, strict=True)),
        )


def _read_basis(group: Any) -> Basis:
    first_s, second_s = np.asarray(group.variables["sample"][:2]).tolist()
    functions, actuator, set_of, samples = (
        np.asarray(group.variables[variable.name][...])
        for variable in (_FUNCTIONS, _FUNCTION_ACTUATOR, _FUNCTION_SET, _SET_SAMPLES)
    )
    sets = [
        BasisSet(functions[set_of == number, :count], actuator[set_of == number].astype(np.uint8))
        for number, count in enumerate(samples.tolist())
    ]
    try:
        return Basis(round(1 / (second_s - first_s)), tuple(sets))
    except MessageError as error:
        raise ValueError(str(error)) from error


def _column(group: Any, variable: Variable, *, axes: int) -> list[Any]:
    """The values of each row, whose first `axes` axes are the rows; NaN, which stands for absence, as None."""
    values = np.asarray(group.variables[variable.name][...])
    values = values.reshape(-1, *values.shape[axes:])
    if values.dtype.kind == "f":
        values = np.where(np.isnan(values), None, values)  # type: ignore[call-overload]  # an array of objects
    rows: list[Any] = values.tolist()
    return rows


def _zone_promise(zones: Mapping[str, list[Any]], row: int, zone: int, name: str) -> ZonePrediction:
    figures = {key: column[row][zone] for key, column in zones.items()}
    ranges = {k: None if None in ends else tuple(ends) for k, ends in figures.items() if isinstance(ends, list)}
    return ZonePrediction(**figures | ranges | {"name": name, "state": ZoneState(int(figures["state"]))})
