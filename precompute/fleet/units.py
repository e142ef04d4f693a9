"""Values of a fleet: its units from a folder or a manifest (docs/fleet.md), options and job of each, and the outcome.

A folder has a subfolder for each unit; a manifest (.csv) lists units by their files, and values in place of those of a
file.
"""

import csv
import hashlib
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from base.errors import TactableError
from base.plain import to_plain
from engine.device.toml_table import read_text
from engine.device.values import Value
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.clicks import DEFAULT_OPTIONS

NAME = re.compile(r"[\w+-][\w.+-]{0,63}")  # names of units, which are also the names of their folders


class FleetError(TactableError, ValueError):
    """A fleet cannot be run as described; the message names the file, the place in it, and the remedy."""


@dataclass(frozen=True)
class Unit:
    """One device of a fleet.

    `values` (text with a unit, by a name such as actuator[1].stiffness) replace those of its file.
    """

    name: str
    device: Path
    measurements: Path | None = None
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class FleetOptions:
    """The job that is done for every unit: how it is calibrated, if it was measured, and what its table holds.

    parameters: names of what is fitted; None: the usual six. also: names that are fitted in addition.
    """

    clicks_up_to: int | None = None
    pitch_m: float | None = DEFAULT_OPTIONS.pitch_m
    parameters: tuple[str, ...] | None = None
    also: tuple[str, ...] = ()
    sensor_mass_kg: float = 0.0


@dataclass(frozen=True)
class Job:
    """A unit with its options and its folder; `key` is a fingerprint of everything that decides the outcome."""

    unit: Unit
    options: FleetOptions
    folder: Path
    created: str
    code_fingerprint: str
    key: str


@dataclass(frozen=True)
class Outcome:
    """Outcome of a unit; with an `error` the other fields are empty.

    values: of the device after calibration (engine.device.values). figures: of its table, by name.
    """

    name: str
    key: str
    seconds: float = 0.0
    error: str | None = None
    fingerprint: str = ""
    table_crc32: int | None = None  # CRC-32 of the table file
    values: Mapping[str, Value] = field(default_factory=dict)
    figures: Mapping[str, float | None] = field(default_factory=dict)
    report: Mapping[str, Any] = field(default_factory=dict)
    """What a verdict needs of the report of its calibration; empty where the unit was not measured."""
    is_kept: bool = False  # whether the outcome of an earlier run was kept

    def as_json(self) -> str:
        """JSON text of everything except `is_kept`."""
        return json.dumps({key: value for key, value in to_plain(self).items() if key != "is_kept"}, indent=1)


def make_job(unit: Unit, options: FleetOptions, out: Path, created: str) -> Job:
    """The job of a unit in the folder `out`. Raises OSError where a file of the unit cannot be read."""
    files = [file for file in (unit.device, unit.measurements) if file is not None]
    wanted = {**to_plain(options), "values": dict(unit.values)}
    parts = [code_fingerprint(), json.dumps(wanted)]
    parts += [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    return Job(unit, options, out / unit.name, created, code_fingerprint(), key)


def checked_units(units: Iterable[Unit], source: str) -> list[Unit]:
    """The units, with names that are distinct and valid for folders. Raises FleetError."""
    found: dict[str, Unit] = {}
    for unit in units:
        if not NAME.fullmatch(unit.name):
            raise FleetError(f"{source}: {unit.name!r}: expected a name of letters, digits, _ . + or -, for a folder")
        if unit.name in found:
            raise FleetError(f"{source}: {unit.name!r}: two units have this name")
        found[unit.name] = unit
    if not found:
        raise FleetError(f"{source}: has no unit; give at least one")
    return list(found.values())


_MEASURED = (".csv", ".uff", ".unv", ".uf")
_COLUMNS = ("name", "device", "measurements")


def plan_fleet(source: Path) -> list[Unit]:
    """The units of a folder or a manifest. Raises FleetError, OSError."""
    if source.is_dir():
        return checked_units(_units_of_folder(source), str(source))
    if source.suffix.lower() != ".csv":
        raise FleetError(f"{source}: expected a folder, or a manifest that ends in .csv")
    return checked_units(_units_of_csv(read_text(source, FleetError), source), str(source))


def _units_of_folder(folder: Path) -> Iterator[Unit]:
    """A unit for each subfolder: device.toml or its only .toml file, and measurements.* where it has one."""
    for path in sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")):
        descriptions = sorted(path.glob("*.toml"))
        device = descriptions[0] if len(descriptions) == 1 else path / "device.toml"
        measured = (path / f"measurements{ending}" for ending in _MEASURED)
        yield Unit(path.name, device, next((file for file in measured if file.exists()), None))


def _units_of_csv(text: str, source: Path) -> Iterator[Unit]:
    """A unit for each row: name, device, measurements; other columns are keys of the device with values and units."""
    rows = csv.reader(io.StringIO(text, newline=""))
    header = [title.strip() for title in next(rows, [])]
    for needed in _COLUMNS[:2]:
        if needed not in header:
            raise FleetError(f"{source}: has no column {needed!r}; the first line names the columns")
    for row in rows:
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(header):
            raise FleetError(f"{source}: line {rows.line_num}: has {len(row)} cells, the header {len(header)}")
        cells = {title: cell.strip() for title, cell in zip(header, row, strict=True)}
        for needed in _COLUMNS[:2]:
            if not cells[needed]:
                raise FleetError(f"{source}: line {rows.line_num}: {needed}: is empty")
        yield Unit(
            name=cells["name"],
            device=source.parent / cells["device"],
            measurements=source.parent / cells["measurements"] if cells.get("measurements") else None,
            values={key: cell for key, cell in cells.items() if key not in _COLUMNS and cell},
        )
