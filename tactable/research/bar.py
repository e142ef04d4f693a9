"""Functions of a bar without a table: its modes, its response, and fingers on it."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from engine.device import Device
from engine.touch import Placement
from precompute.model.assembly import assemble
from precompute.model.modes import compute_modes
from precompute.model.response import solve_response

if TYPE_CHECKING:
    import xarray

POINTS = 201
"""Positions along the bar where none are given."""


def placement(device: Device, felt: Sequence[str | float], quiet: Sequence[str | float] = ()) -> Placement:
    """Fingers on the bar, each felt or quiet: a text such as "35 mm", metres, or a zone's name, which is its middle.

    Raises PlacementError for positions beside the bar, more than ten, and two closer than 8 mm, which are one finger.

    >>> placement(device, felt=["35 mm"], quiet=["III"]).is_felt
    (True, False)
    """
    return Placement.named(device, felt, quiet)


def modes(device: Device, fingers: Sequence[str | float] = (), up_to_hz: float = 1000.0) -> "xarray.Dataset":
    """Modes of the bar up to a frequency, rising, with the device's finger at each position of `fingers`.

    frequency (Hz), damping_ratio and decay_time (s, to 1/e) along mode; shape (mode, position), greatest 1.

    >>> found = modes(device, up_to_hz=300)
    >>> found.shape.dims, found.frequency.attrs["units"]
    (('mode', 'position'), 'Hz')
    """
    import xarray

    position_m = np.linspace(0.0, device.bar.length_m, POINTS)
    found = compute_modes(device, position_m, up_to_hz, _positions_m(device, fingers))
    shapes = np.array([mode.shape for mode in found]).reshape(len(found), POINTS)
    return xarray.Dataset(
        {
            "frequency": ("mode", [mode.frequency_hz for mode in found], {"units": "Hz"}),
            "damping_ratio": ("mode", [mode.damping_ratio for mode in found], {"units": "1"}),
            "decay_time": ("mode", [mode.decay_s for mode in found], {"units": "s", "long_name": "time to 1/e"}),
            "shape": (("mode", "position"), shapes, {"units": "1", "long_name": "greatest displacement 1"}),
        },
        {"mode": np.arange(1, len(found) + 1), "position": ("position", position_m, {"units": "m"})},
        origin_of(device),
    )


def response(
    device: Device,
    frequency_hz: ArrayLike | None = None,
    position_m: ArrayLike | None = None,
    fingers: Sequence[str | float] = (),
) -> "xarray.DataArray":
    """Complex acceleration (frequency, actuator, position) in m/s^2, one actuator at full scale and the others still.

    `frequency_hz` is by default the device's sweep, `position_m` 201 points along the bar; the device's finger lies at
    each position of `fingers`. A time course is the real part of the value times exp(j omega t).

    >>> found = response(device, frequency_hz=[150.0], fingers=["120 mm"])
    >>> found.dims, found.attrs["units"]
    (('frequency', 'actuator', 'position'), 'm s-2')
    """
    import xarray

    hz = device.sweep.frequency_hz if frequency_hz is None else np.atleast_1d(np.asarray(frequency_hz, dtype=float))
    along_m = np.linspace(0.0, device.bar.length_m, POINTS) if position_m is None else np.atleast_1d(position_m)
    plant = assemble(device).with_fingers(_positions_m(device, fingers), device.finger)
    return xarray.DataArray(
        solve_response(plant, hz).acceleration(np.asarray(along_m, dtype=float)),
        {
            "frequency": ("frequency", hz, {"units": "Hz"}),
            "actuator": [actuator.name for actuator in device.actuators],
            "position": ("position", along_m, {"units": "m"}),
        },
        ("frequency", "actuator", "position"),
        "acceleration",
        {"units": "m s-2", "long_name": "acceleration at full scale", **origin_of(device)},
    )


def origin_of(device: Device) -> dict[str, str]:
    """Attributes that say what an array was computed from."""
    estimates = ", ".join(device.estimated_values)
    return {"device": device.name, "device_fingerprint": device.fingerprint, "source": "model", "estimates": estimates}


def _positions_m(device: Device, fingers: Sequence[str | float]) -> tuple[float, ...]:
    return placement(device, (), fingers).position_m if fingers else ()
