"""The family of what can be wrong with a calibration: its measurements, its parameters, or where it is to go."""


class CalibrationError(ValueError):
    """A calibration that cannot be made as asked; the message names the thing, the value and what would do."""
