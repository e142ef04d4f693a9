"""The group `clicks` of a table file: a waveform and its promises for each state."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from engine.device import Device
from engine.table.click import ClickEntry, ClickZone, LevelSpread
from engine.table.file import TableWriter, Variable
from engine.touch import ZoneState
from firmware_link.protocol.bank import SAMPLE_FULL_SCALE

SPREAD = ("nominal", "5 %", "50 %", "95 %")
_FULL_SCALE = 1.0
_ROW = ("state",)

WAVEFORM = Variable(
    "waveform",
    ("state", "actuator", "sample"),
    "1",
    "base displacement as a fraction of full scale, straight lines between samples, 0 beyond its samples",
    scale=1 / SAMPLE_FULL_SCALE,
)
SAMPLES = Variable("samples", _ROW, "1", "how many of the waveform's samples are the click's")
ZONE_STATE = Variable("zone_state", ("state", "zone"), "1", "0 free, 1 quiet, 2 felt")
FELT = Variable("felt_level", ("state", "spread"), "dB", "peak of the weakest felt finger above its threshold")
QUIET = Variable("quiet_level", ("state", "spread"), "dB", "peak of the strongest quiet finger; NaN: none is quiet")
ZONE_ACCELERATION = Variable(
    "acceleration_at_finger", ("state", "zone"), "m s-2", "peak in the nominal plant; NaN: no finger"
)
ZONE_LEVEL = Variable("sensation_level", ("state", "zone"), "dB", "peak over threshold, nominal; NaN: no finger")
EXCEEDS = Variable(
    "exceedance_time", ("state", "level"), "s", "when every felt finger has passed its threshold; NaN: one never does"
)
FIGURES = {
    "wanted_level_db": Variable("wanted_level", _ROW, "dB", "level asked for; infinite: as strong as can be"),
    "peak_s": Variable("peak_time", _ROW, "s", "when the last felt finger has its peak"),
    "residual_from_s": Variable("residual_start", _ROW, "s", "from when on the residual is taken"),
    "residual_db": Variable("residual_level", _ROW, "dB", "strongest felt finger from then on"),
    "objective": Variable("objective", _ROW, "1", "what was maximised"),
    "bound_db": Variable("upper_bound", _ROW, "dB", "no click of its tones is felt more strongly; mean of the plants"),
    "gap_db": Variable("optimality_gap", _ROW, "dB", "what the bound leaves open"),
    "achieved": Variable("achieved", _ROW, "1", "1: the quiet level is kept and the wanted one reached"),
}


def write_clicks(writer: TableWriter, clicks: Sequence[ClickEntry], device: Device) -> None:
    """Write the clicks group, as tabulated: every click at one rate and at full amplitude."""
    rate_hz, levels_db = clicks[0].sample_rate_hz, list(clicks[0].exceeds_s)
    longest = max(len(click.samples) for click in clicks)

    def write(variable: Variable, values: Any) -> None:
        writer.write("clicks", variable, values)

    write(Variable.names("actuator"), [actuator.name for actuator in device.actuators])
    write(Variable.names("zone"), [zone.name for zone in device.zones])
    write(Variable("spread", ("spread",), "1", "nominal plant, and how many sampled plants lie below"), list(SPREAD))
    write(Variable("sample", ("sample",), "s", "time from the click's start"), np.arange(longest) / rate_hz)
    level = Variable("level", ("level",), "dB", "that the click is played at; infinite: as it is")
    write(level, np.array(levels_db, dtype=np.float64))
    index = Variable("state", _ROW, "1", "sum of zone state times 3**zone")
    write(index, np.array([click.index for click in clicks], dtype=np.int64))
    waveform = np.zeros((len(clicks), len(device.actuators), longest), dtype=np.int16)
    for row, click in zip(waveform, clicks, strict=True):
        row[:, : len(click.samples)] = click.samples.T
    write(WAVEFORM, waveform)
    write(SAMPLES, np.array([len(click.samples) for click in clicks], dtype=np.int64))
    write(ZONE_STATE, np.array([click.states for click in clicks], dtype=np.int64))
    write(FELT, np.array([spread_numbers(click.felt) for click in clicks]))
    write(QUIET, np.array([spread_numbers(click.quiet) for click in clicks]))
    write(EXCEEDS, np.array([list(click.exceeds_s.values()) for click in clicks], dtype=np.float64))
    zones = [click.zones for click in clicks]
    at_finger = [[np.nan if z is None else z.acceleration_at_finger_m_per_s2 for z in row] for row in zones]
    write(ZONE_ACCELERATION, np.array(at_finger))
    write(ZONE_LEVEL, np.array([[np.nan if z is None else z.level_db for z in row] for row in zones]))
    for key, variable in FIGURES.items():
        column = [getattr(click, key) for click in clicks]
        write(variable, column if isinstance(column[0], str) else np.array(column, dtype=np.float64))


def read_clicks(group: Any, device: Device) -> Iterator[ClickEntry]:
    """Clicks of an open group, in its order."""

    def column(variable: Variable) -> Any:
        return np.asarray(group.variables[variable.name][...])

    rate_hz = _rate_hz(group)
    levels_db = column(Variable("level", ("level",), "", "")).tolist()
    waveform, samples, states = column(WAVEFORM), column(SAMPLES).tolist(), column(ZONE_STATE).tolist()
    felt, quiet, exceeds = (column(variable).tolist() for variable in (FELT, QUIET, EXCEEDS))
    at_finger, level_db = (column(variable).tolist() for variable in (ZONE_ACCELERATION, ZONE_LEVEL))
    figures = {key: column(variable).tolist() for key, variable in FIGURES.items()}
    for row, count in enumerate(samples):
        values = {key: values[row] for key, values in figures.items()}
        yield ClickEntry(
            **values | {"achieved": bool(values["achieved"])},
            states=tuple(ZoneState(state) for state in states[row]),
            sample_rate_hz=rate_hz,
            samples=np.ascontiguousarray(waveform[row, : len(device.actuators), :count].T),
            amplitude=_FULL_SCALE,
            felt=LevelSpread(*felt[row]),
            quiet=None if np.isnan(quiet[row][0]) else LevelSpread(*quiet[row]),
            zones=tuple(
                None if np.isnan(level) else ClickZone(acceleration, level)
                for acceleration, level in zip(at_finger[row], level_db[row], strict=True)
            ),
            exceeds_s={
                level: None if np.isnan(time_s) else time_s
                for level, time_s in zip(levels_db, exceeds[row], strict=True)
            },
        )


def _rate_hz(group: Any) -> int:
    first_s, second_s = np.asarray(group.variables["sample"][:2]).tolist()
    return round(1 / float(second_s - first_s))


def spread_numbers(spread: LevelSpread | None) -> list[float]:
    """One for each of SPREAD; NaN where there is nothing."""
    if spread is None:
        return [np.nan] * len(SPREAD)
    return [spread.nominal_db, spread.low_db, spread.middle_db, spread.high_db]
