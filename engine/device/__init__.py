"""The description of one bar with its actuators, zones, finger, digitizer and limits: values, files and units."""

from engine.device.actuator_transfer import Transfer as Transfer
from engine.device.device import Device as Device
from engine.device.parts import Actuator as Actuator
from engine.device.parts import DeviceError as DeviceError
from engine.device.parts import Electrodes as Electrodes
from engine.device.parts import Finger as Finger
from engine.device.parts import FittedValue as FittedValue
from engine.device.parts import Limits as Limits
from engine.device.parts import Spread as Spread
from engine.device.parts import TouchAxis as TouchAxis
from engine.device.parts import Uncertainty as Uncertainty
from engine.device.parts import Zone as Zone
from engine.device.threshold import Threshold as Threshold
