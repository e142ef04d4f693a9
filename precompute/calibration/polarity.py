"""Responses of the wrong sign: a sensor that lies upside down, or an actuator whose plug is turned.

A sign that is turned is half a turn of phase at every place and frequency. A wrong bar turns phases only between its
resonances and those of the model: over 400 bars of which modulus, density and stiffnesses were wrong by up to a factor
of two, the mean cosine of the difference was -0.25 at the least (SIMULATED). So the device file is asked as it was
before the fit, which would find other values that explain half of it.
"""

import numpy as np

from engine.device import Device
from precompute.measurements import Kind, Measurements
from precompute.measurements.model import MeasurementModel

_TURNED = -0.5
"""Mean cosine of the difference of phase below which a sign is turned."""
_LEAST_READINGS = 4
"""Of an actuator that is driven alone."""


def polarity_doubt(device: Device, measurements: Measurements) -> str:
    """A sentence that names what is turned, with the remedy; empty where nothing is, or where no phase is known."""
    if measurements.kind is not Kind.RESPONSE:
        return ""
    predicted = MeasurementModel(device, measurements, ()).predict(np.zeros(0)).log_acceleration
    agreement = np.cos(predicted.imag - np.angle(measurements.acceleration))
    driven = measurements.amplitude != 0
    is_turned = {
        actuator.name: bool(agreement[rows].mean() < _TURNED)
        for index, actuator in enumerate(device.actuators)
        if (rows := driven[:, index] & (driven.sum(axis=1) == 1)).sum() >= _LEAST_READINGS
    }
    turned = [name for name, it_is in is_turned.items() if it_is]
    if not turned:
        return ""
    if len(turned) == len(is_turned):
        return "all responses have the wrong sign: the sensor lies upside down, or its plug is turned; measure again"
    names = " and ".join(turned)
    return f"the responses to {names} have the wrong sign: turn the plug of {names}, or of its loopback; measure again"
