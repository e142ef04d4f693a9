"""A folder, a manifest or a study to the units of a fleet (docs/fleet.md)."""

import csv
import io
from collections.abc import Iterator
from pathlib import Path

from engine.device.toml_table import read_text
from precompute.fleet.error import FleetError
from precompute.fleet.manifest import ManifestSection
from precompute.fleet.study import units_of_study
from precompute.fleet.units import Unit, checked_units

_MEASURED = (".csv", ".nc", ".nc4", ".uff", ".unv", ".uf")
_COLUMNS = ("name", "device", "measurements")


def plan_fleet(source: Path) -> list[Unit]:
    """The units of a folder, of a manifest (.toml, .csv) or of a study (.toml). Raises FleetError, OSError."""
    if source.is_dir():
        return checked_units(_units_of_folder(source), str(source))
    ending = source.suffix.lower()
    if ending not in (".csv", ".toml"):
        raise FleetError(f"{source}: expected a folder, or a manifest or study that ends in .toml or .csv")
    text = read_text(source, FleetError)
    if ending == ".csv":
        return checked_units(_units_of_csv(text, source), str(source))
    top = ManifestSection.parse(text, str(source))
    units = list(units_of_study(top, source.parent) if "study" in top.left else _units_of_toml(top, source.parent))
    top.refuse_rest()
    return checked_units(units, str(source))


def _units_of_folder(folder: Path) -> Iterator[Unit]:
    """A subfolder each: device.toml, or its only .toml; and measurements.*, if there is one."""
    for path in sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")):
        descriptions = sorted(path.glob("*.toml"))
        device = descriptions[0] if len(descriptions) == 1 else path / "device.toml"
        measured = (path / f"measurements{ending}" for ending in _MEASURED)
        yield Unit(path.name, device, next((file for file in measured if file.exists()), None))


def _units_of_toml(top: ManifestSection, folder: Path) -> Iterator[Unit]:
    for part in top.tables("unit"):
        name, device = part.name("name"), part.file("device", folder)
        measurements = part.file("measurements", folder) if "measurements" in part.left else None
        own = ManifestSection(part.source, f"{part.path}.values", part.take("values", {}))
        values = {}
        for key, value in own.left.items():
            if not isinstance(value, str):
                raise own.error(key, value, "expected a value with its unit, as text")
            values[key] = value
        part.known.append("measurements")
        part.refuse_rest()
        yield Unit(name, device, measurements, values)


def _units_of_csv(text: str, source: Path) -> Iterator[Unit]:
    """The columns name, device, measurements; any other is a key of the devices, its cells values with units."""
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
