"""Reports of a digitizer to the fingers on the bar: where each one is and which zone it touches."""

from engine.touch.choice import open_digitizer
from engine.touch.descriptor import DescriptorError
from engine.touch.digitizer import Contact, Digitizer, DigitizerError, TouchFrame
from engine.touch.finger_tracker import FingerTracker, Touch, TouchPosition, ZoneState
from engine.touch.placement import Placement, PlacementError

__all__ = [
    "Contact",
    "DescriptorError",
    "Digitizer",
    "DigitizerError",
    "FingerTracker",
    "Placement",
    "PlacementError",
    "Touch",
    "TouchFrame",
    "TouchPosition",
    "ZoneState",
    "open_digitizer",
]
