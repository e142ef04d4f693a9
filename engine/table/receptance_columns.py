"""The group `receptances` of a table file: what steady drives at any positions are solved from (tables/FORMAT.md)."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.steady.receptances import Receptances
from engine.table.file import TableWriter, Variable
from engine.table.soundness import Arrays

_FREQUENCY = Variable("frequency", ("frequency",), "Hz", "rising: the grid of the device, and resonances between")
_THRESHOLD = Variable("threshold", ("frequency",), "m s-2", "detection threshold")
_PLACE = Variable("place", ("place",), "m", "position from the start of the bar, an even grid from end to end")
_DRIVE = Variable("drive", ("place", "actuator", "frequency", "part"), "m", "displacement at full scale")
_POINT = Variable(
    "point",
    ("pair", "frequency", "part"),
    "m N-1",
    "between two places: upper triangle of the symmetric matrix by rows",
)


def write_receptances(writer: TableWriter, receptances: Receptances, device: Device) -> None:
    """Write the group `receptances`."""
    write = partial(writer.write, "receptances")
    write(Variable.names("actuator"), [actuator.name for actuator in device.actuators])
    write(Variable("part", ("part",), "1", "of a complex number"), ["real", "imaginary"])
    write(_FREQUENCY, receptances.frequency_hz)
    write(_THRESHOLD, receptances.threshold_m_per_s2)
    write(_PLACE, receptances.place_m)
    write(_DRIVE, _parts(receptances.drive))
    write(_POINT, _parts(receptances.point))


def read_receptances(arrays: Arrays) -> Receptances:
    """Receptances of the group with these open arrays."""
    return Receptances(
        frequency_hz=arrays[_FREQUENCY.name][...],
        threshold_m_per_s2=arrays[_THRESHOLD.name][...],
        place_m=arrays[_PLACE.name][...],
        drive=_complex(arrays[_DRIVE.name][...]),
        point=_complex(arrays[_POINT.name][...]),
    )


def _parts(values: NDArray[np.complex64]) -> NDArray[np.float32]:
    """Real and imaginary parts (..., part)."""
    return np.ascontiguousarray(values).view(np.float32).reshape(*values.shape, 2)


def _complex(parts: NDArray[np.float32]) -> NDArray[np.complex64]:
    found: NDArray[np.complex64] = np.ascontiguousarray(parts).view(np.complex64)[..., 0]
    return found
