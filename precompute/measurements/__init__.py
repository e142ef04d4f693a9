"""Measured accelerations and responses: files of three formats, the model's prediction of them, simulated ones."""

from precompute.measurements.file import read_measurements
from precompute.measurements.types import CalibrationError, Kind, MeasurementError, Measurements, lay_out

__all__ = ["CalibrationError", "Kind", "MeasurementError", "Measurements", "lay_out", "read_measurements"]
