"""Fit the parameters of a device to measurements, with confidence intervals, a report and what to measure next."""
