"""Effect files of other makers (.haptic, .ahap, .hjif) as effects, with a report of what becomes of every event."""

from engine.effects.files.conversion import Converted, Fate
from engine.effects.files.read import FORMATS, decode_effect_file, read_effect_file

__all__ = ["FORMATS", "Converted", "Fate", "decode_effect_file", "read_effect_file"]
