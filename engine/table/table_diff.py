"""Compares two tables: device, build options, responses, and the figures of every best row and click."""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from base.points import point_text
from engine.device.values import Change, Value, compare_values, device_values
from engine.table.best_rows import BestRow
from engine.table.clicks import ClickEntry
from engine.table.table import Table
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE

_PROVENANCE = ("created", "code_fingerprint", "code_version")
_DEVICE = ("title", "device_name", "device_description", "device_fingerprint")
# Value by value, or derived from such.
_COMPARED = ("responses", "modes", "sweep", "coherent_sweep", "best_rows", "clicks")
_AXES = {"frequency": "frequencies", "actuator": "actuators", "position": "places", "position_across": "places"}
_INPUT_FINGERPRINT = "_input_fingerprint"  # fingerprints of the same
_Key = tuple[tuple[str, ...], tuple[str, ...], float | None]
_Part = TypeVar("_Part", BestRow, ClickEntry)
DEFAULT_LIMIT_DB = 0.1  # changes of a level up to this are ignored: a tenth of what a finger can tell apart
_FREQUENCY_LIMIT_HZ = 0.015  # a step on the wire is 0.01 Hz
_UNITS = {
    "achieved": "",
    "level_db": "dB",
    "localized_factor": "%",
    "frequency_hz": "Hz",
    "amplitude": "%",
    "phase_rad": "rad",
    "felt_level_db": "dB",
    "quiet_level_db": "dB",
    "length_s": "%",
    "waveform": "%",
}
FIGURES = tuple(_UNITS)  # those of a best row are the ones up to phase_rad; `achieved` and the rest are of a click
Sizes = Iterator[tuple[str, Value, Value, float]]  # figure, before, after, size


@dataclass(frozen=True)
class Tolerance:
    """Changes up to this are ignored: of levels in dB, of other figures the equivalent in their unit."""

    level_db: float = DEFAULT_LIMIT_DB

    @property
    def ratio(self) -> float:
        """A relative change of an amplitude by `level_db`."""
        return float(10 ** (self.level_db / 20) - 1)

    def limit(self, figure: str) -> float:
        """The limit for a figure, in the unit of its size."""
        limits = {"": 0.0, "dB": self.level_db, "%": 100 * self.ratio, "Hz": _FREQUENCY_LIMIT_HZ, "rad": self.ratio}
        return limits[_UNITS[figure]]


@dataclass(frozen=True)
class FigureChange:
    """A figure of FIGURES that changed beyond the tolerance.

    size is in `unit`: dB, per cent, Hz or rad; infinite where the figure came or went. Of several actuators, before and
    after are the values of the actuator that changed most; for a waveform, 0 and the greatest difference in per cent.
    """

    figure: str
    before: Value
    after: Value
    size: float

    @property
    def unit(self) -> str:
        """Unit of the size."""
        return _UNITS[self.figure]


@dataclass(frozen=True)
class StateChange:
    """A best row, or with level_db None a click, that changed, and its figures.

    felt, quiet: names of zones; for a click the positions of the places that it is made for.
    """

    felt: tuple[str, ...]
    quiet: tuple[str, ...]
    level_db: float | None
    figures: tuple[FigureChange, ...]

    @property
    def severity(self) -> tuple[bool, float, float]:
        """Sort key, the worst is greatest: whether `achieved` changed, greatest change in dB, then in per cent."""
        largest = {unit: max((f.size for f in self.figures if f.unit == unit), default=0.0) for unit in ("dB", "%")}
        return any(f.figure == "achieved" for f in self.figures), largest["dB"], largest["%"]


def describe(felt: Sequence[str], quiet: Sequence[str], level_db: float | None) -> str:
    """A state or a placement in words, such as "felt I, quiet IV at 20 dB"; without a level for a click."""
    zones = f"felt {' '.join(felt)}" + (f", quiet {' '.join(quiet)}" if quiet else "")
    if level_db is None:
        return zones
    return f"{zones} at {'full scale' if math.isinf(level_db) else f'{level_db:g} dB'}"


@dataclass(frozen=True)
class PartDiff:
    """The best rows, or the clicks, of both tables: how many are in both, those that changed, worst first, and others.

    vanished, appeared: in words, only in the table before, only in that after.
    """

    compared: int
    changed: tuple[StateChange, ...]
    vanished: tuple[str, ...]
    appeared: tuple[str, ...]

    @property
    def differs(self) -> bool:
        """Whether anything changed."""
        return bool(self.changed or self.vanished or self.appeared)

    def largest(self) -> list[tuple[int, StateChange, FigureChange]]:
        """For every changed figure: how often it changed, and the state and size of its greatest change."""
        found = []
        for figure in FIGURES:
            of_figure = [(state, f) for state in self.changed for f in state.figures if f.figure == figure]
            if of_figure:
                found.append((len(of_figure), *max(of_figure, key=lambda pair: pair[1].size)))
        return found


@dataclass(frozen=True)
class TableDiff:
    """All differences between two tables.

    notes: what could not be compared, in sentences. response_percent: greatest change of a unit response by actuator,
    relative to its greatest; those beyond the tolerance. arrays: of groups that are not compared value by value, such
    as measured responses, those that are not the same bytes.
    """

    tolerance: Tolerance
    notes: tuple[str, ...]
    device: tuple[Change, ...]
    options: tuple[Change, ...]
    provenance: tuple[Change, ...]
    response_percent: Mapping[str, float]
    arrays: tuple[str, ...]
    best_rows: PartDiff
    clicks: PartDiff

    @property
    def differs(self) -> bool:
        """Whether device, options or figures differ; author and date of the tables do not count."""
        parts = (self.notes, self.device, self.options, self.response_percent, self.arrays)
        return any(parts) or self.best_rows.differs or self.clicks.differs


def compare_tables(before: Table, after: Table, tolerance: Tolerance | None = None) -> TableDiff:
    """What changed beyond the tolerance; best rows are matched by zones, clicks by the positions of their places."""
    tolerance = tolerance or Tolerance()
    notes, response_percent = _compare_responses(before, after, tolerance)
    same_actuators = _names(before.device.actuators) == _names(after.device.actuators)
    rows = _compare_part(
        _rows_by_key(before), _rows_by_key(after), lambda a, b: row_figures(a, b, same_actuators), tolerance
    )
    is_one_grid = not (before.clicks and after.clicks) or before.places == after.places
    clicks = _compare_part(
        {_click_key(click): click for click in before.clicks} if is_one_grid else {},
        {_click_key(click): click for click in after.clicks} if is_one_grid else {},
        lambda a, b: click_figures(a, b, same_actuators),
        tolerance,
    )
    own, other = _attributes(before), _attributes(after)
    return TableDiff(
        tolerance=tolerance,
        notes=(*_layout_notes(before, after), *notes),
        device=compare_values(device_values(before.device), device_values(after.device)),
        options=compare_values(*({k: v for k, v in values.items() if k not in _PROVENANCE} for values in (own, other))),
        provenance=compare_values(*({k: values.get(k) for k in _PROVENANCE} for values in (own, other))),
        response_percent=response_percent,
        arrays=_other_arrays(before, after),
        best_rows=rows,
        clicks=clicks,
    )


def _names(things: Iterable[Any]) -> list[str]:
    return [thing.name for thing in things]


def _layout_notes(before: Table, after: Table) -> Iterator[str]:
    consequences = {
        "actuators": "drives and waveforms are not compared",
        "zones": "best rows are matched by the names of their zones",
    }
    for part, consequence in consequences.items():
        own, other = (", ".join(_names(getattr(table.device, part))) for table in (before, after))
        if own != other:
            yield f"the {part} were {own} and are {other}: {consequence}"
    own_mm, other_mm = (f"{1e3 * table.places.pitch_m:.3g} mm" for table in (before, after))
    if before.clicks and after.clicks and before.places != after.places:
        yield f"places were {own_mm} apart and are {other_mm} apart: clicks are not compared"


def _attributes(table: Table) -> dict[str, Value]:
    """Attributes of the file, those in JSON one by one; without the device, which is compared value by value."""
    found: dict[str, Value] = {}
    for key, value in table.attributes.items():
        plain = value.item() if isinstance(value, np.generic) else value
        parts = json.loads(plain) if isinstance(plain, str) and plain.startswith("{") else plain
        if key not in _DEVICE and not key.endswith(_INPUT_FINGERPRINT):
            found |= {f"{key}.{k}": _plain(v) for k, v in parts.items()} if isinstance(parts, dict) else {key: parts}
    return found


def _plain(value: Any) -> Value:
    return value if isinstance(value, Value) else json.dumps(value)


def _compare_responses(before: Table, after: Table, tolerance: Tolerance) -> tuple[list[str], dict[str, float]]:
    if before.is_shipped or after.is_shipped:
        return [], {}  # a shipped table holds none
    own, other = before.checksums(), after.checksums()
    for axis, what in _AXES.items():
        if own.get(f"responses/{axis}") != other.get(f"responses/{axis}"):
            return [f"the responses have other {what}, and are not compared"], {}
    values, changed = (
        table.values("responses", "acceleration") @ np.array([1, 1j]) for table in (before, after)
    )  # (frequency, actuator, zone, point) from (..., part)
    size = 100 * abs(changed - values).max(axis=(0, 2, 3)) / abs(values).max(axis=(0, 2, 3))
    names = _names(before.device.actuators)
    return [], {name: float(s) for name, s in zip(names, size, strict=True) if s > 100 * tolerance.ratio}


def _other_arrays(before: Table, after: Table) -> tuple[str, ...]:
    own, other = before.checksums(), after.checksums()
    changed = (name for name in own | other if own.get(name) != other.get(name))
    return tuple(name for name in changed if name.partition("/")[0] not in _COMPARED)


def _rows_by_key(table: Table) -> dict[_Key, BestRow]:
    names = _names(table.device.zones)
    every = (row for rows in table.best_rows.values() for row in rows)
    return {(tuple(names[zone] for zone in row.zones), (), row.wanted_level_db): row for row in every}


def _click_key(click: ClickEntry) -> _Key:
    placement = click.placement
    words = [point_text(np.round(at_m, 4).item()) for at_m in placement.position_m]
    felt, quiet = (tuple(words[finger] for finger in which) for which in (placement.felt, placement.quiet))
    return felt, quiet, None


def _compare_part(
    before: Mapping[_Key, _Part],
    after: Mapping[_Key, _Part],
    sizes: Callable[[_Part, _Part], Sizes],
    tolerance: Tolerance,
) -> PartDiff:
    both = [key for key in before if key in after]
    changed = list[StateChange]()
    for key in both:
        found = (FigureChange(*figure) for figure in sizes(before[key], after[key]))
        figures = tuple(f for f in found if f.size > tolerance.limit(f.figure))
        if figures:
            changed.append(StateChange(*key, figures))
    return PartDiff(
        compared=len(both),
        changed=tuple(sorted(changed, key=lambda state: state.severity, reverse=True)),
        vanished=tuple(describe(*key) for key in before if key not in after),
        appeared=tuple(describe(*key) for key in after if key not in before),
    )


def row_figures(before: BestRow, after: BestRow, same_actuators: bool) -> Sizes:
    """Every figure of a best row before and after, and the size of its change; drives only of the same actuators."""
    yield "achieved", before.achieved, after.achieved, float(before.achieved != after.achieved)
    yield _decibels("level_db", before.level_db, after.level_db)
    yield _percent("localized_factor", before.localized_factor, after.localized_factor)
    if same_actuators:
        yield from _drive_figures(before, after)


def _drive_figures(before: BestRow, after: BestRow) -> Sizes:
    own, other = np.array(before.amplitudes), np.array(after.amplitudes)
    loudest = max(own.max(), other.max())
    most = int(abs(other - own).argmax())
    yield "amplitude", float(own[most]), float(other[most]), 100 * float(abs(other - own)[most] / loudest)
    both = np.flatnonzero((own > 0) & (other > 0))
    if not len(both):
        return
    hz = np.array([before.frequencies_hz, after.frequencies_hz])[:, both]
    most = int(abs(hz[1] - hz[0]).argmax())
    yield "frequency_hz", float(hz[0, most]), float(hz[1, most]), float(abs(hz[1] - hz[0])[most])
    # Only phases between actuators of one tone are felt.
    together = (hz == hz[:, :1]).all(axis=0)
    phase = np.array([before.phases_rad, after.phases_rad])[:, both][:, together]
    relative = _wrapped(phase - phase[:, :1])
    turned = abs(_wrapped(relative[1] - relative[0]))
    most = int(turned.argmax())
    yield "phase_rad", float(relative[0, most]), float(relative[1, most]), float(turned[most])


def _wrapped(phase_rad: Any) -> Any:
    return np.angle(np.exp(1j * phase_rad))


def click_figures(before: ClickEntry, after: ClickEntry, same_actuators: bool) -> Sizes:
    """The same as `row_figures`, for a click; waveforms are compared only for the same actuators and rate.

    Which way the bar moves first is not felt, as the phase that all actuators of a drive have in common.
    """
    yield _decibels("felt_level_db", before.felt.low_db, after.felt.low_db)
    quiet_db = [None if click.quiet is None else click.quiet.high_db for click in (before, after)]
    yield _decibels("quiet_level_db", *quiet_db)
    yield _percent("length_s", before.length_s, after.length_s)
    if same_actuators and before.sample_rate_hz == after.sample_rate_hz:
        longest = max(len(before.samples), len(after.samples))
        own, other = (
            np.pad(c.samples / SAMPLE_FULL_SCALE, ((0, longest - len(c.samples)), (0, 0))) for c in (before, after)
        )
        percent = 100 * min(float(abs(other - own).max()), float(abs(other + own).max()))
        yield "waveform", 0.0, percent, percent


def _decibels(figure: str, before: float | None, after: float | None) -> tuple[str, Value, Value, float]:
    if before == after:
        return figure, before, after, 0.0
    return figure, before, after, math.inf if before is None or after is None else abs(after - before)


def _percent(figure: str, before: float, after: float) -> tuple[str, Value, Value, float]:
    if before == after:
        return figure, before, after, 0.0
    return figure, before, after, math.inf if before == 0 else 100 * abs(after / before - 1)
