"""Units of a fleet from a folder, a manifest or a study (docs/fleet.md).

A folder has a subfolder for each unit; a manifest (.csv) lists units by their files; a study (.toml) varies the values
of one device over a grid, or samples them evenly in a box.
"""

import csv
import io
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from engine.device.toml_table import TomlTable, read_text
from precompute.fleet.units import FleetError, Unit, checked_units
from precompute.sampling.plants import latin_hypercube

_MEASURED = (".csv", ".uff", ".unv", ".uf")
_COLUMNS = ("name", "device", "measurements")
_MOST_UNITS = 100_000  # a slip in a count or a product of values, not a fleet
_QUANTITY = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?) ?(\D.*)?")
_DIGITS = 8


class StudySection(TomlTable):
    """A table of a study; files it names are relative to `folder`."""

    family = FleetError

    def file(self, key: str, folder: Path) -> Path:
        """Path of a named file, which may be missing: a missing file fails its unit, not the fleet."""
        value = self.take_value(key)
        if not isinstance(value, str) or not value:
            raise self.error(key, value, "expected the name of a file")
        return folder / value


def plan_fleet(source: Path) -> list[Unit]:
    """The units of a folder, a manifest or a study. Raises FleetError, OSError."""
    if source.is_dir():
        return checked_units(_units_of_folder(source), str(source))
    ending = source.suffix.lower()
    if ending not in (".csv", ".toml"):
        raise FleetError(f"{source}: expected a folder, a manifest that ends in .csv, or a study that ends in .toml")
    text = read_text(source, FleetError)
    if ending == ".csv":
        return checked_units(_units_of_csv(text, source), str(source))
    top = StudySection.parse(text, str(source))
    units = list(_units_of_study(top, source.parent))
    top.refuse_rest()
    return checked_units(units, str(source))


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


def _units_of_study(top: StudySection, folder: Path) -> Iterator[Unit]:
    """Units of the table [study]: every combination of the listed values, or `count` samples between two of each.

    `judge` names a table whose drives are evaluated on every variation; no table is built then.
    """
    part = StudySection(top.source, "study", top.take_value("study"))
    device = part.file("device", folder)
    evaluated = part.file("judge", folder) if "judge" in part.left else None
    is_sampled = "count" in part.left
    count = part.integer("count", 1, _MOST_UNITS, 1)
    seed = part.integer("seed", 0, 2**31 - 1, 0)
    listed = _listed(StudySection(part.source, "study.values", part.take_value("values")))
    part.known.append("judge")
    part.refuse_rest()
    rows = _sample(listed, count, seed, part) if is_sampled else _grid(listed, part)
    digits = len(str(len(rows) - 1))
    for i, row in enumerate(rows):
        yield Unit(f"{i:0{digits}d}", device, None, row, evaluated)


def _listed(part: StudySection) -> dict[str, list[str]]:
    found = {}
    for key, values in part.left.items():
        if not (isinstance(values, list) and values and all(isinstance(value, str) for value in values)):
            raise part.error(key, values, "expected a list of values with units, such as ['18 kN/m', '20 kN/m']")
        found[key] = values
    if not found:
        raise part.error("", {}, "expected at least one key of the device with its values")
    return found


def _grid(listed: Mapping[str, Sequence[str]], part: StudySection) -> list[dict[str, str]]:
    count = math.prod(map(len, listed.values()))
    if count > _MOST_UNITS:
        raise part.error("values", f"{count} combinations", f"expected at most {_MOST_UNITS}; or a count to sample")
    return [dict(zip(listed, row, strict=True)) for row in itertools.product(*listed.values())]


def _sample(listed: Mapping[str, Sequence[str]], count: int, seed: int, part: StudySection) -> list[dict[str, str]]:
    """A seeded Latin hypercube between the two values of each key."""
    ends = {key: _ends(key, values, part) for key, values in listed.items()}
    points = latin_hypercube(count, len(ends), np.random.default_rng(seed))
    return [
        {
            key: f"{low + at * (high - low):.{_DIGITS}g}{unit}"
            for (key, (low, high, unit)), at in zip(ends.items(), point, strict=True)
        }
        for point in points.tolist()
    ]


def _ends(key: str, values: Sequence[str], part: StudySection) -> tuple[float, float, str]:
    matches = [_QUANTITY.fullmatch(value.strip()) for value in values]
    if len(matches) != 2 or matches[0] is None or matches[1] is None or matches[0][2] != matches[1][2]:
        raise part.error(f"values.{key}", values, "expected the least and the greatest value, in the same unit")
    unit = matches[0][2]
    return float(matches[0][1]), float(matches[1][1]), f" {unit}" if unit else ""
