"""The groups `clicks` and `modes` of a table file, from which clicks and steady drives are played (tables/FORMAT.md).

Clicks have an array for each figure, with a row for each click.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from engine.device import Device
from engine.steady.modes import Modes
from engine.table.clicks import Clicks
from engine.table.netcdf_file import TableWriter, Values, Variable, read_points
from engine.table.soundness import Arrays
from engine.touch.placement import Places
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, Basis, BasisSet
from firmware_link.protocol.link_errors import MessageError

_CLICK, _FINGER, _SPREAD = ("click",), ("click", "finger"), ("click", "spread")
_PLACE = Variable("place", ("place",), "m", "position from the start of the surface")
_LEVEL = Variable("level", ("level",), "dB", "that the click is played at; infinite: as it is")
_SPREAD_NAMES = Variable("spread", ("spread",), "1", "nominal plant, how many sampled plants lie below, the worst")
_FUNCTIONS = Variable(
    "basis_function",
    ("function", "sample"),
    "1",
    "base displacement as a fraction of full scale, straight lines between samples, 0 beyond the samples of its set",
    scale=1 / SAMPLE_FULL_SCALE,
)
_FUNCTION_ACTUATOR = Variable("function_actuator", ("function",), "1", "index of the actuator that the function moves")
_FUNCTION_SET = Variable("function_set", ("function",), "1", "index of the set that the function belongs to")
_SET_SAMPLES = Variable("set_samples", ("set",), "1", "how many samples the functions of the set have")
_VARIABLES = {
    "finger_place": Variable("finger_place", _FINGER, "1", "index of the finger's place, rising; -1: no finger"),
    "is_felt": Variable("finger_felt", _FINGER, "1", "1: the finger is to feel the click, 0: it is to feel nothing"),
    "weights": Variable(
        "weight", ("click", "weight_of_set"), "1", "of each function of the click's set, in order, in steps; 0 beyond"
    ),
    "fraction_bits": Variable("fraction_bits", _CLICK, "1", "a step of the weights is 2**-fraction_bits"),
    "basis_set": Variable("basis_set", _CLICK, "1", "index of the set whose functions are weighted"),
    "felt_db": Variable("felt_level", _SPREAD, "dB", "peak of the weakest felt finger above its threshold"),
    "quiet_db": Variable("quiet_level", _SPREAD, "dB", "peak of the strongest quiet finger; NaN: none is quiet"),
    "finger_m_per_s2": Variable(
        "acceleration_at_finger", _FINGER, "m s-2", "peak in the nominal plant; NaN: no finger"
    ),
    "finger_db": Variable("sensation_level", _FINGER, "dB", "peak over threshold, nominal; NaN: no finger"),
    "exceeds_s": Variable(
        "exceedance_time",
        ("click", "level"),
        "s",
        "when every felt finger has passed its threshold; NaN: one never does",
    ),
    "peak_s": Variable("peak_time", _CLICK, "s", "when the last felt finger has its peak"),
    "residual_from_s": Variable("residual_start", _CLICK, "s", "from when on the residual is taken"),
    "residual_db": Variable("residual_level", _CLICK, "dB", "strongest felt finger from then on"),
}
"""The arrays of a file, by the fields of Clicks."""
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


def write_clicks(writer: TableWriter, clicks: Clicks, device: Device) -> None:
    """Write the group `clicks`: the places, the basis, which all clicks share, and every click at full amplitude."""
    assert clicks.basis is not None  # a table without clicks has no such group
    write = partial(writer.write, "clicks")
    write(Variable.names("actuator"), [actuator.name for actuator in device.actuators])
    writer.write_points("clicks", _PLACE, np.array(clicks.places.position_m))
    write(_SPREAD_NAMES, ["nominal", "5 %", "50 %", "95 %", "worst"])
    _write_basis(write, clicks.basis)
    write(_LEVEL, np.array(clicks.levels_db))
    for field, variable in _VARIABLES.items():
        values = getattr(clicks, field)
        write(variable, values.astype(np.int8) if values.dtype.kind == "b" else values)


def read_clicks(arrays: Arrays, corner_m: complex, tolerance_m: float) -> Clicks:
    """Clicks of the group with these open arrays, for a surface that reaches from 0 to `corner_m`.

    `tolerance_m`: within this distance of its place a finger lies. Raises ValueError for sets that the basis has not,
    and for places that are no even grid.
    """
    basis = _read_basis(arrays)
    columns = {field: np.asarray(arrays[variable.name][...]) for field, variable in _VARIABLES.items()}
    if not (columns["basis_set"] < len(basis.sets)).all():
        raise ValueError(f"a click is of set {columns['basis_set'].max()} of a basis with {len(basis.sets)}")
    columns["is_felt"] = columns["is_felt"].astype(np.bool_)
    return Clicks(
        places=Places.at(corner_m, read_points(arrays, _PLACE.name).tolist()),
        tolerance_m=tolerance_m,
        basis=basis,
        levels_db=tuple(arrays[_LEVEL.name][...].tolist()),
        **columns,
    )


def _write_basis(write: Callable[[Variable, Values], None], basis: Basis) -> None:
    longest = max(each.samples for each in basis.sets)
    padded = [np.pad(each.functions, ((0, 0), (0, longest - each.samples))) for each in basis.sets]
    sample = Variable("sample", ("sample",), "s", "time from the click's start")
    write(sample, np.arange(longest) / basis.sample_rate_hz)
    write(_FUNCTIONS, np.concatenate(padded))
    write(_FUNCTION_ACTUATOR, np.concatenate([each.actuators.astype(np.int64) for each in basis.sets]))
    sizes = [len(each.actuators) for each in basis.sets]
    write(_FUNCTION_SET, np.repeat(np.arange(len(sizes)), sizes))
    write(_SET_SAMPLES, np.array([each.samples for each in basis.sets], dtype=np.int64))


def _read_basis(arrays: Arrays) -> Basis:
    first_s, second_s = arrays["sample"][:2].tolist()
    functions, actuator, set_of, samples = (
        np.asarray(arrays[variable.name][...])
        for variable in (_FUNCTIONS, _FUNCTION_ACTUATOR, _FUNCTION_SET, _SET_SAMPLES)
    )
    sets = [
        BasisSet(functions[set_of == number, :count], actuator[set_of == number].astype(np.uint8))
        for number, count in enumerate(samples.tolist())
    ]
    try:
        return Basis(round(1 / (second_s - first_s)), tuple(sets))
    except MessageError as error:
        raise ValueError(str(error)) from error


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
