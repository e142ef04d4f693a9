"""Dataclasses, enums, arrays and paths as plain values that `json.dumps` writes."""

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


@overload
def to_plain(value: "Mapping[Any, object] | DataclassInstance") -> dict[str, Any]: ...
@overload
def to_plain(value: object) -> Any: ...
def to_plain(value: object) -> Any:
    """A value as dicts, lists, strings, finite numbers, booleans and None.

    A dataclass becomes a dict of its fields, an enum its value, an array nested lists, a complex number its two parts,
    a path its text, a set a sorted list; infinite and undefined numbers become None, since JSON has none. Raises
    TypeError for anything else.
    """
    if isinstance(value, Enum):
        return to_plain(value.value)
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, complex):
        return [to_plain(value.real), to_plain(value.imag)]
    if isinstance(value, np.generic | np.ndarray):
        return to_plain(value.tolist())
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {to_plain(key): to_plain(part) for key, part in value.items()}
    if isinstance(value, Set):
        return sorted(map(to_plain, value))
    if isinstance(value, Sequence) and not isinstance(value, bytes | bytearray | memoryview):
        return [to_plain(part) for part in value]
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{value!r} has no plain form")
