"""Levels in dB above threshold: the default one, how near is near enough, and levels that shift together."""

from dataclasses import astuple
from typing import Any, TypeVar

DEFAULT_LEVEL_DB = 20.0  # the default sensation level: plainly felt, and 20 dB below full drive on the published bar
LEVEL_TOLERANCE_DB = 1e-3  # a level within this of the wanted one is reached

Levels = TypeVar("Levels", bound=Any)  # a dataclass whose fields are all in dB


def shifted(levels: Levels, change_db: float) -> Levels:
    """A dataclass of levels in dB, all of them raised by `change_db`."""
    return type(levels)(*(level_db + change_db for level_db in astuple(levels)))
