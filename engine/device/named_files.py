"""Texts of device files with other values, and with the contents of the files that they name.

A table holds the text of its device, which must be whole wherever the table goes. So a named file (a threshold curve, a
finger, an impedance or a set of spreads) becomes a part of the text when the description is read. A path counts from
the folder of the file that names it; a text that is no file, such as one that a page was given, names no files.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from base.files import shipped
from engine.device.parts import DeviceError
from engine.device.quantity import QuantityError, read_number
from engine.device.toml_table import read_text

_TABLES = ("finger", "spread")  # that a name may stand for
IMPEDANCE_HEADER = "frequency (Hz),real (N s/m),imaginary (N s/m)"
_KEY = re.compile(r"(?:(\w+)(?:\[([1-9]\d{0,2})\])?\.)?(\w+)")


def names_files(values: Mapping[str, Any]) -> bool:
    """Whether the values of a description name a file that is to be put into its text."""
    finger = values.get("finger")
    has_csv = isinstance(finger, dict) and _is_path(finger.get("impedance"), ".csv")
    return has_csv or any(isinstance(values.get(k), str) for k in _TABLES) or _is_path(values.get("threshold"), ".toml")


def with_files_inside(text: str, source: str, folder: Path | None) -> str:
    """The text with the contents of the files that it names. `folder`: of the description; None: it is no file.

    `finger` and `spread` may also name a shipped file. Raises DeviceError where a file cannot be read.
    """
    import tomlkit  # only a text that names a file needs it

    document = document_of(text, source)
    curve, finger_folder = document.get("threshold"), folder
    if _is_path(curve, ".toml"):
        document.pop("threshold")
        document["threshold"] = _read_document(_resolve(curve, source, folder, "threshold"), source, "threshold")
    for key in _TABLES:
        named = document.get(key)
        if isinstance(named, str):
            is_path = _is_path(named, ".toml")
            path = _resolve(named, source, folder, key) if is_path else find_shipped(key, named, source)
            if key == "finger":
                finger_folder = path.parent
            document.pop(key)
            document[key] = _read_document(path, source, key)
    table = document.get("finger")
    if isinstance(table, dict) and _is_path(table.get("impedance"), ".csv"):
        path = _resolve(table["impedance"], source, finger_folder, "finger.impedance")
        rows = tomlkit.array()
        for row in read_impedance(path, source):
            rows.add_line(row)
        rows.add_line(indent="")
        table["impedance"] = rows
    return tomlkit.dumps(document)


def text_with_threshold(text: str, curve: Path | str, source: str) -> str:
    """The text with a threshold curve: a shipped one by its name, or the contents of a TOML file by its path."""
    import tomlkit

    document = document_of(text, source)
    document.pop("threshold", None)
    document["threshold"] = _read_document(curve, source, "threshold") if isinstance(curve, Path) else curve
    return tomlkit.dumps(document)


def shipped_names(key: str) -> list[str]:
    """Names of the shipped fingers, spreads or thresholds, by the key of their table."""
    return sorted(path.stem for path in shipped(Path(__file__).parent, f"{key}s").glob("*.toml"))


def shipped_path(key: str, name: str) -> Path:
    """The file of one of these."""
    return shipped(Path(__file__).parent, f"{key}s") / f"{name}.toml"


def read_impedance(path: Path, source: str) -> list[list[float]]:
    """Points [frequency in Hz, real, imaginary part in N s/m] of a CSV file; raises DeviceError with file and line."""
    lines = _read(path, source, "finger.impedance").splitlines()
    numbered = [(k, line) for k, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if not numbered or numbered[0][1].strip() != IMPEDANCE_HEADER:
        raise DeviceError(f"{path}: line {numbered[0][0] if numbered else 1}: expected the header {IMPEDANCE_HEADER!r}")
    rows = []
    for k, line in numbered[1:]:
        try:
            row = [read_number(cell) for cell in line.split(",")]
        except QuantityError:
            row = []
        if len(row) != 3:
            raise DeviceError(f"{path}: line {k}: {line!r}: expected three numbers: {IMPEDANCE_HEADER}")
        rows.append(row)
    return rows


def _is_path(value: object, ending: str) -> bool:
    return isinstance(value, str) and value.endswith(ending)


def _resolve(name: str, source: str, folder: Path | None, key: str) -> Path:
    if folder is None:
        raise DeviceError(f"{source}: {key}: {str(name)!r}: a text that is no file names no other file; put it inside")
    return folder / name


def find_shipped(key: str, name: object, source: str) -> Path:
    """The file of one of these; raises DeviceError with the known ones."""
    if not isinstance(name, str) or name not in shipped_names(key):
        known = ", ".join(shipped_names(key))
        raise DeviceError(
            f"{source}: {key}: {str(name)!r}: expected a shipped {key} ({known}), the path of a TOML file like theirs, "
            f"or a table [{key}]"
        )
    return shipped_path(key, name)


def _read_document(path: Path, source: str, key: str) -> dict[str, Any]:
    return document_of(_read(path, source, key), str(path)).unwrap()


def _read(path: Path, source: str, key: str) -> str:
    try:
        return read_text(path, DeviceError)
    except OSError as error:
        raise DeviceError(f"{source}: {key}: {path}: cannot be read: {error.strerror}") from error


def text_with_values(text: str, values: Mapping[str, str | float | list[str]], source: str) -> str:
    """Text with `values` by key: bar.thickness, actuator[2].mass, or actuator.mass for every actuator.

    Whether a key exists and a value is valid shows when the text is read. Raises DeviceError.
    """
    if not values:
        return text
    import tomlkit  # only who changes a text needs it

    document = document_of(text, source)
    for key, value in values.items():
        tables, last = tables_of(document, key, source)
        for table in tables:
            if isinstance(table.get(last), dict):
                table.pop(last)  # a value in its place would stand among the keys of the table before it
            table[last] = int(value) if isinstance(value, str) and value.isascii() and value.isdigit() else value
    return tomlkit.dumps(document)


def document_of(text: str, source: str) -> Any:
    """The text as a TOML document that keeps comments and order. Raises DeviceError."""
    import tomlkit
    from tomlkit.exceptions import ParseError

    try:
        return tomlkit.parse(text)
    except ParseError as error:
        raise DeviceError(f"{source}: not TOML: {error}") from error


def tables_of(document: Any, key: str, source: str) -> tuple[list[Any], str]:
    """The TOML tables that a key addresses, and its last part."""
    match = _KEY.fullmatch(key)
    if match is None:
        raise DeviceError(f"{source}: {key!r}: expected a key such as bar.thickness or actuator[1].stiffness")
    part, index, last = match.groups()
    if part is None:
        return [document], last
    found = document.get(part)
    tables = found if isinstance(found, list) else [found]
    if index is not None:
        tables = tables[int(index) - 1 : int(index)] if isinstance(found, list) else []
    if not tables or not all(isinstance(table, dict) for table in tables):
        raise DeviceError(f"{source}: {key}: the description has no such table")
    return tables, last
