"""Measured accelerations and responses: files of three formats, the model's prediction of them, simulated ones."""
