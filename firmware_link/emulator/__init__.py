"""The firmware in Python with virtual time, its faults, and its process behind a pseudo-terminal."""

from firmware_link.emulator.drive_log import Cause, ChannelTarget, DriveEvent, Outcome, PlayedWaveform, ReceivedFrame
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.emulator.state import LONGEST_LEASE_MS, DeviceConfiguration, DeviceCounters
from firmware_link.emulator.synthesis import Synthesis, synthesise
from firmware_link.host.link_values import BOARD_EMULATED, BOARD_SOUND_CARD

__all__ = [
    "BOARD_EMULATED",
    "BOARD_SOUND_CARD",
    "LONGEST_LEASE_MS",
    "Cause",
    "ChannelTarget",
    "DeviceConfiguration",
    "DeviceCounters",
    "DriveEvent",
    "EmulatedFirmware",
    "Outcome",
    "PlayedWaveform",
    "ReceivedFrame",
    "Synthesis",
    "synthesise",
]
