"""Two entries, or two clicks, of one state to the figures that changed between them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from engine.device.values import Value
from engine.table.click import ClickEntry
from engine.table.entry import Entry
from firmware_link.protocol.bank import SAMPLE_FULL_SCALE

DEFAULT_LIMIT_DB = 0.1
"""Changes of a level up to this count as none: a tenth of what a finger can tell apart."""
_FREQUENCY_LIMIT_HZ = 0.015  # a step on the wire is 0.01 Hz
_UNITS = {
    "achieved": "",
    "level_db": "dB",
    "contrast_db": "dB",
    "expected_contrast_db": "dB",
    "worst_contrast_db": "dB",
    "localized_factor": "%",
    "t90_s": "%",
    "frequency_hz": "Hz",
    "amplitude": "%",
    "phase_rad": "rad",
    "felt_level_db": "dB",
    "quiet_level_db": "dB",
    "length_s": "%",
    "waveform": "%",
}
FIGURES = tuple(_UNITS)
"""What is compared: of an entry up to phase_rad, of a click achieved and the rest."""


@dataclass(frozen=True)
class Tolerance:
    """Changes up to this count as none: of levels in dB, of everything else the same in its own unit."""

    level_db: float = DEFAULT_LIMIT_DB

    @property
    def ratio(self) -> float:
        """A relative change of an amplitude by `level_db`."""
        return float(10 ** (self.level_db / 20) - 1)

    def limit(self, figure: str) -> float:
        """In the unit of the figure's sizes."""
        limits = {"": 0.0, "dB": self.level_db, "%": 100 * self.ratio, "Hz": _FREQUENCY_LIMIT_HZ, "rad": self.ratio}
        return limits[_UNITS[figure]]


@dataclass(frozen=True)
class FigureChange:
    """A figure of FIGURES that changed beyond the tolerance.

    size is in `unit`: dB, per cent, Hz or rad; infinite where the figure came or went. Of several actuators, before and
    after are those of the one that changed most; of a waveform, 0 and the greatest difference in per cent.
    """

    figure: str
    before: Value
    after: Value
    size: float

    @property
    def unit(self) -> str:
        """Of the size."""
        return _UNITS[self.figure]


@dataclass(frozen=True)
class StateChange:
    """An entry, or with level_db None a click, that changed: names of felt and quiet zones, its figures."""

    felt: tuple[str, ...]
    quiet: tuple[str, ...]
    level_db: float | None
    figures: tuple[FigureChange, ...]

    @property
    def severity(self) -> tuple[bool, float, float]:
        """What the worst come first by: reached or not, then the greatest change in dB, then in per cent."""
        largest = {unit: max((f.size for f in self.figures if f.unit == unit), default=0.0) for unit in ("dB", "%")}
        return any(f.figure == "achieved" for f in self.figures), largest["dB"], largest["%"]


Sizes = Iterator[tuple[str, Value, Value, float]]
"""Figure, before, after, size."""


def describe(felt: Sequence[str], quiet: Sequence[str], level_db: float | None) -> str:
    """A state in words, such as "felt I, quiet IV at 20 dB"; without a level for a click."""
    zones = f"felt {' '.join(felt)}" + (f", quiet {' '.join(quiet)}" if quiet else "")
    if level_db is None:
        return zones
    return f"{zones} at {'full scale' if math.isinf(level_db) else f'{level_db:g} dB'}"


def entry_figures(before: Entry, after: Entry, same_actuators: bool) -> Sizes:
    """Every figure of an entry before and after, and the size of its change; drives only of the same actuators."""
    yield "achieved", before.achieved, after.achieved, float(before.achieved != after.achieved)
    for key in ("level_db", "contrast_db", "expected_contrast_db"):
        yield _decibels(key, getattr(before, key), getattr(after, key))
    yield _decibels("worst_contrast_db", before.worst_case.contrast_db, after.worst_case.contrast_db)
    yield _percent("localized_factor", before.localized_factor, after.localized_factor)
    yield _percent("t90_s", before.t90_s, after.t90_s)
    if same_actuators:
        yield from _drive_figures(before, after)


def _drive_figures(before: Entry, after: Entry) -> Sizes:
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
    """The same of a click; waveforms only of the same actuators at the same rate."""
    yield "achieved", before.achieved, after.achieved, float(before.achieved != after.achieved)
    yield _decibels("felt_level_db", before.felt.low_db, after.felt.low_db)
    quiet_db = [None if click.quiet is None else click.quiet.high_db for click in (before, after)]
    yield _decibels("quiet_level_db", *quiet_db)
    yield _percent("length_s", before.length_s, after.length_s)
    if same_actuators and before.sample_rate_hz == after.sample_rate_hz:
        longest = max(len(before.samples), len(after.samples))
        own, other = (
            np.pad(c.samples / SAMPLE_FULL_SCALE, ((0, longest - len(c.samples)), (0, 0))) for c in (before, after)
        )
        percent = 100 * float(abs(other - own).max())
        yield "waveform", 0.0, percent, percent


def _decibels(figure: str, before: float | None, after: float | None) -> tuple[str, Value, Value, float]:
    if before == after:
        return figure, before, after, 0.0
    return figure, before, after, math.inf if before is None or after is None else abs(after - before)


def _percent(figure: str, before: float, after: float) -> tuple[str, Value, Value, float]:
    if before == after:
        return figure, before, after, 0.0
    return figure, before, after, math.inf if before == 0 else 100 * abs(after / before - 1)
