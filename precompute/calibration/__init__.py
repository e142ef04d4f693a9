"""Measurements to the values of a device, with their confidence."""
