"""Read a file of measurements in the format that its ending names."""

import stat
from pathlib import Path

from base.files import replace_file
from engine.device import Device
from engine.device.toml_table import read_text
from precompute.measurements.csv import parse_csv, write_csv
from precompute.measurements.lvm import parse_lvm
from precompute.measurements.types import MeasurementError, Measurements

MOST_BYTES = 100_000_000  # a million rows of CSV, where a fit takes 10 000 readings at most
_UNIVERSAL = (".uff", ".unv", ".uf")
_TEXT, _READ_ONLY = (".csv", ".tsv", ".txt"), (".tsv", ".txt", ".lvm", ".mat")


def read_measurements(path: Path | str, device: Device, sensor_mass_kg: float = 0.0) -> Measurements:
    """Read the file in the format that its ending names; `sensor_mass_kg` applies where the file does not state one.

    Raises MeasurementError; OSError if the file does not exist.
    """
    path = Path(path)
    check_file(path)
    ending = check_ending(path, to_read=True)
    if ending in _TEXT:
        return parse_csv(read_table_text(path), device, sensor_mass_kg, str(path))
    if ending == ".lvm":
        return parse_lvm(read_table_text(path), device, sensor_mass_kg, str(path))
    if ending == ".mat":
        from precompute.measurements.mat import read_mat

        return read_mat(path, device, sensor_mass_kg)
    from precompute.measurements.uff import read_uff

    return read_uff(path, device, sensor_mass_kg)


def read_table_text(path: Path) -> str:
    """Text in UTF-8 or UTF-16, or in Windows-1252, which spreadsheets in Europe write. Raises MeasurementError."""
    try:
        text = read_text(path, MeasurementError)
    except MeasurementError as error:
        if not isinstance(error.__cause__, UnicodeDecodeError) or error.__cause__.encoding != "utf-8":
            raise
        try:
            text = path.read_text(encoding="cp1252")
        except UnicodeDecodeError:
            raise error from error.__cause__
    if "\0" in text:
        raise MeasurementError(f"{path}: has bytes of 0, which no text has; save it as CSV in UTF-8")
    return text


def write_measurements(path: Path, measurements: Measurements, device: Device, comment: str) -> None:
    """Write measurements in the format that the ending names; `comment` names their source. Raises MeasurementError."""
    ending = check_ending(path)
    if measurements.force_m is not None:
        raise MeasurementError(f"{path}: responses per newton are read, not written; keep the file that they came from")
    with replace_file(path) as partial:
        if ending == ".csv":
            partial.write_text(write_csv(measurements, device, comment), encoding="utf-8")
        else:
            from precompute.measurements.uff import write_uff

            write_uff(partial, measurements, device, comment)


def check_file(path: Path) -> None:
    """Raise MeasurementError for what is no file of measurements by its name, kind or size, before a byte is read.

    A pipe would be waited for, and a device never ends. Raises OSError if the file does not exist.
    """
    check_ending(path, to_read=True)
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise MeasurementError(f"{path}: is not a plain file; write the measurements into one")
    if status.st_size > MOST_BYTES:
        raise MeasurementError(
            f"{path}: has {status.st_size / 1e6:.3g} MB, expected at most {MOST_BYTES / 1e6:.0f} MB: "
            "fewer measurements suffice"
        )


def check_ending(path: Path, *, to_read: bool = False) -> str:
    """The ending of a file of measurements, to be written unless `to_read`; raises MeasurementError for another one."""
    ending = path.suffix.lower()
    known = (".csv", *_UNIVERSAL, *(_READ_ONLY if to_read else ()))
    if ending not in known:
        raise MeasurementError(f"{path}: measurements end in {', '.join(known)}; choose one of them")
    return ending
