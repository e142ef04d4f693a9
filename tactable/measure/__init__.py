"""Driving a bar by hand or by plan, and recording what sensors read of it."""

from tactable.measure.asked_drive import AskedDrive, check_drive
from tactable.measure.driven_device import DrivenDevice

__all__ = ["AskedDrive", "DrivenDevice", "check_drive"]
