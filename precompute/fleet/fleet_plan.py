"""Units of a fleet from a folder or a manifest (docs/fleet.md).

A folder has a subfolder for each unit; a manifest (.csv) lists units by their files, and values in place of those of a
file.
"""

import csv
import io
from collections.abc import Iterator
from pathlib import Path

from engine.device.toml_table import read_text
from precompute.fleet.units import FleetError, Unit, checked_units

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
