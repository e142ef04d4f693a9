"""The beam model: matrices, responses and modes of the bar with its actuators and fingers."""
