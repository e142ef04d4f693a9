"""The group `bursts` of a table file: few shapes, and for each state a drive, its shape, its stop and its promises."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from engine.device import Device
from engine.table.burst import NUMBER_OF_SHAPES, BurstEntry, OnsetStep, Shape
from engine.table.click import LevelSpread
from engine.table.click_group import FELT, QUIET, SPREAD, ZONE_STATE, spread_numbers
from engine.table.error import TableError
from engine.table.file import TableWriter, Variable
from engine.touch import ZoneState

_CHANNEL = ("state", "actuator")

UNTIL = Variable("shape_until", ("shape", "step"), "s", "a step holds its gain until so long after the start")
GAIN = Variable("shape_gain", ("shape", "step"), "1", "what a step multiplies all amplitudes by; 1 after the last")
SHAPE = Variable("burst_shape", ("state",), "1", "which of the shapes the burst has, 0 for the first")
STOP = Variable("stop_time", ("state",), "s", "when the amplitudes are set to 0")
FREQUENCY = Variable("drive_frequency", _CHANNEL, "Hz", "of the drive")
AMPLITUDE = Variable("drive_amplitude", _CHANNEL, "1", "fraction of full scale after the last step")
PHASE = Variable("drive_phase", _CHANNEL, "rad", "of a sine, at the start")


def write_bursts(writer: TableWriter, bursts: Sequence[BurstEntry], shapes: Sequence[Shape], device: Device) -> None:
    """Write the bursts group; all shapes have as many steps. Raises TableError for more shapes than devices keep."""
    if len(shapes) > NUMBER_OF_SHAPES:
        raise TableError(
            f"{writer.path}: bursts of {len(shapes)} shapes; devices keep {NUMBER_OF_SHAPES}: let the bursts share them"
        )

    def write(variable: Variable, values: Any) -> None:
        writer.write("bursts", variable, values)

    write(Variable.names("actuator"), [actuator.name for actuator in device.actuators])
    write(Variable.names("zone"), [zone.name for zone in device.zones])
    write(Variable("spread", ("spread",), "1", "nominal plant, and how many sampled plants lie below"), list(SPREAD))
    index = Variable("state", ("state",), "1", "sum of zone state times 3**zone")
    write(index, np.array([burst.index for burst in bursts], dtype=np.int64))
    write(UNTIL, np.array([[step.until_s for step in steps] for steps in shapes]))
    write(GAIN, np.array([[step.gain for step in steps] for steps in shapes]))
    write(ZONE_STATE, np.array([burst.states for burst in bursts], dtype=np.int64))
    write(SHAPE, np.array([burst.shape for burst in bursts], dtype=np.int64))
    write(STOP, np.array([burst.stop_s for burst in bursts]))
    write(FREQUENCY, np.array([burst.frequencies_hz for burst in bursts]))
    write(AMPLITUDE, np.array([burst.amplitudes for burst in bursts]))
    write(PHASE, np.array([burst.phases_rad for burst in bursts]))
    write(FELT, np.array([spread_numbers(burst.felt) for burst in bursts]))
    write(QUIET, np.array([spread_numbers(burst.quiet) for burst in bursts]))


def read_shapes(group: Any) -> tuple[Shape, ...]:
    """Shapes of an open group, in its order."""
    until_s, gain = (np.asarray(group.variables[variable.name][...]).tolist() for variable in (UNTIL, GAIN))
    return tuple(
        tuple(OnsetStep(*step) for step in zip(*steps, strict=True)) for steps in zip(until_s, gain, strict=True)
    )


def read_bursts(group: Any) -> Iterator[BurstEntry]:
    """Bursts of an open group, in its order."""
    variables = (ZONE_STATE, FREQUENCY, AMPLITUDE, PHASE, SHAPE, STOP, FELT, QUIET)
    columns = [np.asarray(group.variables[variable.name][...]).tolist() for variable in variables]
    for states, frequencies_hz, amplitudes, phases_rad, shape, stop_s, felt, quiet in zip(*columns, strict=True):
        yield BurstEntry(
            states=tuple(ZoneState(state) for state in states),
            frequencies_hz=tuple(frequencies_hz),
            amplitudes=tuple(amplitudes),
            phases_rad=tuple(phases_rad),
            shape=shape,
            stop_s=stop_s,
            felt=LevelSpread(*felt),
            quiet=None if np.isnan(quiet[0]) else LevelSpread(*quiet),
        )
