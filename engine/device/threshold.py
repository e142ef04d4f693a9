"""Detection threshold curves: the acceleration that a fingertip just detects, by frequency, read from TOML.

Every level of this project is dB above such a curve. A device names the one that it is made for: a shipped curve
(tables/thresholds), or a file of the same form, which becomes a part of the description (`named_files`), so that a
table holds the whole curve. A curve may be given as acceleration or displacement, peak or RMS; what is computed with is
always peak acceleration.
"""

import itertools
import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from base.arrays import Array
from engine.device.named_files import find_shipped, shipped_path
from engine.device.parts import DeviceError
from engine.device.toml_table import TomlTable, read_text

DEFAULT = "oh-choi-2019"  # the curve of a device whose file names none
_MOST_POINTS = 1000
_LOWEST_HZ, _HIGHEST_HZ = 1e-3, 1e5  # the credible frequencies of toml_table.py
_FORCES_N = 1e-3, 1e3  # of fingers; slips of units lie beyond
_MOST_DB = 300.0  # a factor of 1e15 in either direction: a slip, whatever the curve is relative to


@dataclass(frozen=True)
class Threshold:
    """A curve by points: straight lines in dB over frequency or its logarithm; beyond the points prolonged or held.

    frequency_hz (point,): rising. level_db (point,): dB re `reference`, in m/s^2 or m. measured_hz: which of the points
    were measured, the others being interpolated; None: the source does not say. people_db: by how much people differ;
    0: the source does not say. force_n: the pressing force that the levels hold for; None: the source does not say.
    by_force: forces in N, rising, each with its levels in dB at measured_hz. is_force_known: else it is assumed.
    """

    name: str
    title: str
    source: str
    quantity: Literal["acceleration", "displacement"]
    amplitude: Literal["peak", "rms"]
    reference: float
    interpolation: Literal["frequency", "log frequency"]
    beyond: Literal["prolonged", "held"]
    frequency_hz: tuple[float, ...]
    level_db: tuple[float, ...]
    measured_hz: tuple[float, ...] | None
    people_db: float
    force_n: float | None = None
    by_force: tuple[tuple[float, tuple[float, ...]], ...] = ()
    is_force_known: bool = False

    def at_force(self, force_n: float) -> "Threshold":
        """The curve of a finger that presses with another force. Raises DeviceError for a curve without forces.

        Its points move as the measured ones do: on straight lines in dB over the logarithm of the force, between
        measured frequencies over that of frequency; beyond either end the last value is held.
        """
        if self.force_n is None or not self.by_force:
            raise DeviceError(f"threshold {self.name}: says nothing of forces; take {DEFAULT}, or leave the force out")
        forces, levels = (
            np.log([force for force, _ in self.by_force]),
            np.array([level for _, level in self.by_force]).T,
        )
        moved = [np.interp(np.log([force_n, self.force_n]), forces, each) for each in levels]
        shift = np.interp(np.log(self.frequency_hz), np.log(self.measured_hz or ()), [new - old for new, old in moved])
        level_db = tuple((np.array(self.level_db) + shift).tolist())
        return replace(self, level_db=level_db, force_n=force_n, by_force=(), is_force_known=True)

    def peak_m_per_s2(self, frequency_hz: Array) -> Array:
        """Peak acceleration at the threshold, for each frequency."""
        known, at = np.array(self.frequency_hz), frequency_hz
        if self.beyond == "held":
            at = np.clip(at, known[0], known[-1])
        if self.interpolation == "log frequency":
            known, at = np.log2(known), np.log2(at)
        points_db = np.array(self.level_db)
        piece = np.clip(np.searchsorted(known, at) - 1, 0, len(known) - 2)
        slope = np.diff(points_db) / np.diff(known)
        level_db = points_db[piece] + slope[piece] * (at - known[piece])
        threshold: Array = self.reference * 10 ** (level_db / 20)
        if self.amplitude == "rms":
            threshold = threshold * math.sqrt(2)
        return threshold * (2 * np.pi * frequency_hz) ** 2 if self.quantity == "displacement" else threshold

    @property
    def values(self) -> dict[str, Any]:
        """What the curve is computed from, by name: neither its names nor where it comes from."""
        keys = ("quantity", "amplitude", "reference", "interpolation", "beyond", "frequency_hz", "level_db")
        return {key: getattr(self, key) for key in keys}

    @property
    def above(self) -> str:
        """What a level is, to follow "dB": above which threshold, and of what force."""
        force = "" if self.force_n is None else f" at {self.force_n:g} N{'' if self.is_force_known else ' (assumed)'}"
        return f"above threshold {self.name}{force}"

    @property
    def note(self) -> str:
        """The curve in a list of estimates."""
        people = f" (within {self.people_db:g} dB between people)" if self.people_db else ""
        return f"detection threshold {self.name}{people}"


class _CurveTable(TomlTable):
    family = DeviceError


def read_threshold(value: object, source: str) -> Threshold:
    """The curve of a description: the name of a shipped one, or a table with a curve's keys. Raises DeviceError."""
    if isinstance(value, dict):
        return _curve_of(_CurveTable(source, "threshold", value))
    return shipped_threshold(find_shipped("threshold", value, source).stem)


@cache
def shipped_threshold(name: str) -> Threshold:
    """A shipped curve by its name; raises DeviceError for another one."""
    return read_threshold_file(shipped_path("threshold", name))


def read_threshold_file(path: Path) -> Threshold:
    """A curve from its file. Raises DeviceError, also where there is no such file."""
    try:
        text = read_text(path, DeviceError)
    except OSError as error:
        raise DeviceError(f"{path}: no threshold curve can be read there: {error.strerror}") from error
    return _curve_of(_CurveTable.parse(text, str(path)))


def _curve_of(part: TomlTable) -> Threshold:
    name = part.name("name")
    frequency_hz = _numbers(part, "frequency_hz", _LOWEST_HZ, _HIGHEST_HZ)
    if any(later <= former for former, later in itertools.pairwise(frequency_hz)):
        raise part.error("frequency_hz", list(frequency_hz), "expected rising frequencies")
    level_db = _numbers(part, "level_db", -_MOST_DB, _MOST_DB)
    if len(level_db) != len(frequency_hz):
        raise part.error("level_db", list(level_db), f"expected one level for each of {len(frequency_hz)} frequencies")
    measured_hz = None
    if part.has("measured_hz"):
        measured_hz = _numbers(part, "measured_hz", _LOWEST_HZ, _HIGHEST_HZ, fewest=1)
        if not set(measured_hz) <= set(frequency_hz):
            raise part.error("measured_hz", list(measured_hz), "expected some of frequency_hz")
    people_db = part.take_value("people_db", 0.0)
    if not _is_number(people_db, 0.0, _MOST_DB):
        raise part.error("people_db", people_db, f"expected a number from 0 to {_MOST_DB:g}")
    quantity: Literal["acceleration", "displacement"] = part.word("quantity", ("acceleration", "displacement"))
    curve = Threshold(
        name=name,
        title=part.sentence("title") or name,
        source=part.sentence("source"),
        quantity=quantity,
        amplitude=part.word("amplitude", ("peak", "rms")),
        reference=part.quantity("reference", "m/s^2" if quantity == "acceleration" else "m", exclusive=True),
        interpolation=part.word("interpolation", ("frequency", "log frequency")),
        beyond=part.word("beyond", ("prolonged", "held")),
        frequency_hz=frequency_hz,
        level_db=level_db,
        measured_hz=measured_hz,
        people_db=float(people_db),
        **_read_forces(part, len(measured_hz or ())),
    )
    part.refuse_rest()
    return curve


def _read_forces(part: TomlTable, measured: int) -> dict[str, Any]:
    """The keys force_n, forces_n and forces_db, of which a curve may have the first alone."""
    part.known += (keys := ["force_n", "forces_n", "forces_db"])
    given = [key for key in keys if key in part.left]
    if not given:
        return {}
    force_n = part.take_value("force_n")
    if not _is_number(force_n, *_FORCES_N):
        raise part.error("force_n", force_n, f"expected a number from {_FORCES_N[0]:g} to {_FORCES_N[1]:g}")
    if given == ["force_n"]:
        return {"force_n": float(force_n)}
    forces_n, rows = _numbers(part, "forces_n", *_FORCES_N), part.take_value("forces_db")
    is_table = isinstance(rows, list) and all(isinstance(row, list) for row in rows)
    is_full = is_table and [len(row) for row in rows] == [measured or -1] * len(forces_n)
    if (
        list(forces_n) != sorted(set(forces_n))
        or not is_full
        or not all(_is_number(each, -_MOST_DB, _MOST_DB) for row in rows for each in row)
    ):
        expected = "expected a row for each of the rising forces_n, a level in it for each of measured_hz"
        raise part.error("forces_db", rows, expected)
    return {"force_n": float(force_n), "by_force": tuple(zip(forces_n, map(tuple, rows), strict=True))}


def _numbers(part: TomlTable, key: str, least: float, most: float, fewest: int = 2) -> tuple[float, ...]:
    """A list of numbers between bounds."""
    values = part.take_value(key)
    if (
        not isinstance(values, list)
        or not fewest <= len(values) <= _MOST_POINTS
        or not all(_is_number(value, least, most) for value in values)
    ):
        raise part.error(key, values, f"expected {fewest} to {_MOST_POINTS} numbers from {least:g} to {most:g}")
    return tuple(float(value) for value in values)


def _is_number(value: object, least: float, most: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and least <= value <= most
