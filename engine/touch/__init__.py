"""Reports of a digitizer to the fingers on the bar: where each one is and which zone it touches."""

from engine.touch.descriptor import DescriptorError as DescriptorError
from engine.touch.digitizer import Contact as Contact
from engine.touch.digitizer import Digitizer as Digitizer
from engine.touch.digitizer import DigitizerError as DigitizerError
from engine.touch.digitizer import TouchFrame as TouchFrame
from engine.touch.digitizer import open_digitizer as open_digitizer
from engine.touch.finger_tracker import FingerTracker as FingerTracker
from engine.touch.finger_tracker import Touch as Touch
from engine.touch.finger_tracker import TouchPosition as TouchPosition
from engine.touch.finger_tracker import ZoneState as ZoneState
from engine.touch.placement import Placement as Placement
from engine.touch.placement import PlacementError as PlacementError
