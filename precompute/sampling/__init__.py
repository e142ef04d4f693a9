"""Sampling of what is not known: fingers, bars and actuators, and the receptance where fingers may be."""
