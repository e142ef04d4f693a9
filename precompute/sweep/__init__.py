"""Sweeps: localized factor and acceleration of every zone over frequencies, amplitudes and phases."""
