"""The description of one bar with its actuators, zones, finger, digitizer and limits: values, files and units."""

from engine.device.actuator_transfer import Transfer
from engine.device.device import Device
from engine.device.electrodes import Electrodes
from engine.device.parts import (
    Actuator,
    DeviceError,
    Finger,
    FittedValue,
    Limits,
    Spread,
    TouchAxis,
    Uncertainty,
    Zone,
)
from engine.device.threshold import Threshold

__all__ = [
    "Actuator",
    "Device",
    "DeviceError",
    "Electrodes",
    "Finger",
    "FittedValue",
    "Limits",
    "Spread",
    "Threshold",
    "TouchAxis",
    "Transfer",
    "Uncertainty",
    "Zone",
]
