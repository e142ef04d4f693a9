"""Effect files by their endings: text to events to one effect."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from engine.device.toml_table import read_text
from engine.effects.files import ahap, haptic, hjif
from engine.effects.files.conversion import FULL_LEVEL_DB, Converted, convert
from engine.effects.files.json_part import Part
from engine.effects.files.pattern import Pattern
from engine.effects.rules import EffectError

FORMATS: Mapping[str, Callable[[Part], Pattern]] = MappingProxyType(
    {ahap.FORMAT: ahap.read_ahap, haptic.FORMAT: haptic.read_haptic, hjif.FORMAT: hjif.read_hjif}
)
"""Readers by format, which is also the ending of a file's name."""
MOST_BYTES = 4 << 20  # an event of 35 bytes each millisecond of the longest effect, 120 s


def read_effect_file(path: Path, name: str, full_level_db: float = FULL_LEVEL_DB) -> Converted:
    """The effect called `name` of a file; `full_level_db` is the level of its intensity 1.

    Raises EffectError for what is no effect file; OSError when there is no such file.
    """
    file_format = path.suffix.removeprefix(".").lower()
    if file_format not in FORMATS:
        raise EffectError(f"{path}: ends in {path.suffix!r}; expected {', '.join('.' + each for each in FORMATS)}")
    if path.stat().st_size > MOST_BYTES:
        raise EffectError(f"{path}: {path.stat().st_size} bytes; expected at most {MOST_BYTES}: shorten the file")
    return decode_effect_file(Part.parse(read_text(path, EffectError), str(path)), file_format, name, full_level_db)


def decode_effect_file(document: Part, file_format: str, name: str, full_level_db: float = FULL_LEVEL_DB) -> Converted:
    """The same for a document that was read already, in one of `FORMATS`. Raises EffectError."""
    return convert(FORMATS[file_format](document), name, full_level_db)
