"""The group `modes` of a table file: what steady drives at any positions are solved from (tables/FORMAT.md)."""

from functools import partial

import numpy as np

from engine.device import Device
from engine.steady.modes import Modes
from engine.table.netcdf_file import TableWriter, Variable
from engine.table.soundness import Arrays
from engine.touch.places import Places

_FREQUENCY = Variable("frequency", ("frequency",), "Hz", "rising: the grid of the device, and resonances between")
_THRESHOLD = Variable("threshold", ("frequency",), "m s-2", "detection threshold")
_ALONG = Variable("along", ("along",), "m", "position from the start, an even grid from end to end")
_ACROSS = Variable("across", ("across",), "m", "position across a plate, an even grid; 0 alone on a bar")
_SHAPE = Variable("shape", ("across", "along", "function"), "kg-0.5", "functions; modes are first, others are plain")
_DRIVE = Variable("drive", ("function", "actuator", "frequency", "part"), "m kg0.5", "share of it at full scale")
_NATURAL = Variable("natural_frequency", ("mode",), "Hz", "without damping")
_DAMPING = Variable("damping", ("mode",), "s-1", "damping over mass, without what dampers of the mounts add")
_AT_ACTUATOR = Variable("shape_at_actuator", ("mode", "actuator"), "kg-0.5", "shape of a mode at an actuator")
_DAMPER = Variable("damper", ("actuator",), "N s m-1", "damper of the mount that is not in the damping of the modes")


def write_modes(writer: TableWriter, modes: Modes, device: Device) -> None:
    """Write the group `modes`."""
    write, places = partial(writer.write, "modes"), modes.places
    write(Variable.names("actuator"), [actuator.name for actuator in device.actuators])
    write(Variable("part", ("part",), "1", "of a complex number"), ["real", "imaginary"])
    write(_FREQUENCY, modes.frequency_hz)
    write(_THRESHOLD, modes.threshold_m_per_s2)
    write(_ALONG, np.linspace(0.0, places.corner_m.real, places.along))
    write(_ACROSS, np.linspace(0.0, places.corner_m.imag, places.across))
    write(_SHAPE, modes.shape.reshape(places.across, places.along, -1))
    write(_DRIVE, np.ascontiguousarray(modes.drive).view(np.float32).reshape(*modes.drive.shape, 2))
    write(_NATURAL, modes.natural_frequency_hz)
    write(_DAMPING, modes.damping_per_s)
    write(_AT_ACTUATOR, modes.at_actuator)
    write(_DAMPER, modes.damper_n_s_per_m)


def read_modes(arrays: Arrays, device: Device) -> Modes:
    """Modes of the group with these open arrays."""
    shape = arrays[_SHAPE.name][...]
    across, along, functions = shape.shape
    return Modes(
        frequency_hz=arrays[_FREQUENCY.name][...],
        threshold_m_per_s2=arrays[_THRESHOLD.name][...],
        places=Places(device.surface.corner_m, along, across),
        shape=shape.reshape(-1, functions),
        drive=np.ascontiguousarray(arrays[_DRIVE.name][...]).view(np.complex64)[..., 0],
        natural_frequency_hz=arrays[_NATURAL.name][...],
        damping_per_s=arrays[_DAMPING.name][...],
        at_actuator=arrays[_AT_ACTUATOR.name][...],
        damper_n_s_per_m=arrays[_DAMPER.name][...],
    )
