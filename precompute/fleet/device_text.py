"""A device description with other values at some keys, everything else of the text as it was."""

import re
from collections.abc import Mapping
from typing import Any

import tomlkit
from tomlkit.exceptions import ParseError

from engine.device import DeviceError

_KEY = re.compile(r"(?:(\w+)(?:\[([1-9]\d{0,2})\])?\.)?(\w+)")


def with_values(text: str, values: Mapping[str, str], source: str) -> str:
    """`values` by key: bar.thickness, actuator[2].mass, or actuator.mass for all of them. Raises DeviceError.

    Whether there is such a key, and the value is one, is for the reader of the text to say.
    """
    if not values:
        return text
    try:
        document = tomlkit.parse(text)
    except ParseError as error:
        raise DeviceError(f"{source}: not TOML: {error}") from error
    for key, value in values.items():
        for table, last in _places(document, key, source):
            table[last] = int(value) if value.isdigit() else value
    return tomlkit.dumps(document)


def _places(document: Any, key: str, source: str) -> list[tuple[Any, str]]:
    match = _KEY.fullmatch(key)
    if match is None:
        raise DeviceError(f"{source}: {key!r}: expected a key such as bar.thickness or actuator[1].stiffness")
    part, index, last = match.groups()
    if part is None:
        return [(document, last)]
    found = document.get(part)
    tables = found if isinstance(found, list) else [found]
    if index is not None:
        tables = tables[int(index) - 1 : int(index)] if isinstance(found, list) else []
    if not tables or not all(isinstance(table, dict) for table in tables):
        raise DeviceError(f"{source}: {key}: the description has no such table")
    return [(table, last) for table in tables]
