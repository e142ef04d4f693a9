"""Effect files of other makers (.haptic, .ahap, .hjif) as effects, with a report of what becomes of every event."""

from engine.effects.files.conversion import Converted, EventReport, Fate, convert
from engine.effects.files.read import FORMATS, decode_effect_file, read_effect_file

__all__ = ["FORMATS", "Converted", "EventReport", "Fate", "convert", "decode_effect_file", "read_effect_file"]
