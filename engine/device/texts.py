"""Texts of device files with other values by key; comments and order are kept."""

import re
from collections.abc import Mapping
from typing import Any

from engine.device.parts import DeviceError

_KEY = re.compile(r"(?:(\w+)(?:\[([1-9]\d{0,2})\])?\.)?(\w+)")


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
