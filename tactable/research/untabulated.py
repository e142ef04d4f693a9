"""Functions of a surface without a table: its modes, its response, fingers on it, and clicks and drives solved now."""

from collections.abc import Sequence
from functools import lru_cache
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from base.arrays import Points
from engine.device import Device
from engine.table.clicks import played_at
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.touch import Placement
from engine.touch.placement import PlacementError
from precompute.model.assembly import assemble
from precompute.model.modal import compute_modes, seen_points
from precompute.model.response import solve_response
from tactable.research.played import Click, Drive, asked_placement, origin_of

if TYPE_CHECKING:
    import xarray

    from precompute.clicks import ClickSolver
    from precompute.predict.at_positions import SteadyDesigner


def placement(device: Device, felt: Sequence[str | complex], quiet: Sequence[str | complex] = ()) -> Placement:
    """Fingers on a surface, felt or quiet: a text such as "35 mm", metres, or a zone's name, which is its middle.

    Raises PlacementError for positions beside the surface, more than ten, and two closer than 8 mm, which are one.

    >>> placement(device, felt=["35 mm"], quiet=["III"]).is_felt
    (True, False)
    """
    return Placement.named(device, felt, quiet)


def modes(device: Device, fingers: Sequence[str | complex] = (), up_to_hz: float = 1000.0) -> "xarray.Dataset":
    """Modes of the surface up to a frequency, rising, with the device's finger at each position of `fingers`.

    frequency (Hz), damping_ratio and decay_time (s, to 1/e) along mode; shape (mode, position), greatest 1. On a plate
    the coordinate position_across goes with position.

    >>> found = modes(device, up_to_hz=300)
    >>> found.shape.dims, found.frequency.attrs["units"]
    (('mode', 'position'), 'Hz')
    """
    import xarray

    position_m = seen_points(device)
    found = compute_modes(device, position_m, up_to_hz, _positions_m(device, fingers))
    shapes = np.array([mode.shape for mode in found]).reshape(len(found), len(position_m))
    return xarray.Dataset(
        {
            "frequency": ("mode", [mode.frequency_hz for mode in found], {"units": "Hz"}),
            "damping_ratio": ("mode", [mode.damping_ratio for mode in found], {"units": "1"}),
            "decay_time": ("mode", [mode.decay_s for mode in found], {"units": "s", "long_name": "time to 1/e"}),
            "shape": (("mode", "position"), shapes, {"units": "1", "long_name": "greatest displacement 1"}),
        },
        {"mode": np.arange(1, len(found) + 1), **_coordinates(position_m)},
        origin_of(device),
    )


def response(
    device: Device,
    frequency_hz: ArrayLike | None = None,
    position_m: ArrayLike | None = None,
    fingers: Sequence[str | complex] = (),
) -> "xarray.DataArray":
    """Complex acceleration (frequency, actuator, position) in m/s^2, one actuator at full scale and the others still.

    `frequency_hz` is by default the device's sweep, `position_m` points all over the surface; the device's finger lies
    at each position of `fingers`. A time course is the real part of the value times exp(j omega t).

    >>> found = response(device, frequency_hz=[150.0], fingers=["120 mm"])
    >>> found.dims, found.attrs["units"]
    (('frequency', 'actuator', 'position'), 'm s-2')
    """
    import xarray

    hz = device.sweep.frequency_hz if frequency_hz is None else np.atleast_1d(np.asarray(frequency_hz, dtype=float))
    points_m = seen_points(device) if position_m is None else np.atleast_1d(np.asarray(position_m))
    plant = assemble(device).with_fingers(_positions_m(device, fingers), device.finger)
    return xarray.DataArray(
        solve_response(plant, hz).acceleration(points_m),
        {
            "frequency": ("frequency", hz, {"units": "Hz"}),
            "actuator": [actuator.name for actuator in device.actuators],
            **_coordinates(points_m),
        },
        ("frequency", "actuator", "position"),
        "acceleration",
        {"units": "m s-2", "long_name": "acceleration at full scale", **origin_of(device)},
    )


def solve_click(
    device: Device, felt: Sequence[str | complex], quiet: Sequence[str | complex] = (), level_db: float = inf
) -> Click:
    """Solve the click for up to ten fingers where they are; infinite `level_db`: as strong as it can be.

    A position is a text such as "35 mm", metres, or the name of a zone, which means its middle. The first click of a
    device also samples its plants, which takes a fraction of a second. Raises PlacementError for positions that are no
    placement, and where no finger is felt.

    >>> click = solve_click(device, felt=["35 mm"], quiet=["120 mm", "200 mm"])
    >>> click.waveform.shape
    (121, 2)
    """
    placement = _felt_placement(device, felt, quiet, level_db)
    return Click.of(played_at(_click_solver(device).solve(placement), level_db), device, placement)


def solve_drive(
    device: Device,
    felt: Sequence[str | complex],
    quiet: Sequence[str | complex] = (),
    level_db: float = DEFAULT_LEVEL_DB,
) -> Drive:
    """Solve the steady drive for fingers where they are, given as in `solve_click`, at a level in dB.

    >>> solve_drive(device, felt=["35 mm"], quiet=["120 mm"], level_db=20).achieved
    True
    """
    placement = _felt_placement(device, felt, quiet, level_db)
    found = _designer(device).solver.solve(placement.position_m, placement.is_felt, level_db)
    return Drive.of(found, device, placement)


def _felt_placement(
    device: Device, felt: Sequence[str | complex], quiet: Sequence[str | complex], level_db: float
) -> Placement:
    placement = asked_placement(device, felt, quiet, level_db)
    if not felt:
        raise PlacementError('no finger is felt: name at least one, such as felt=["35 mm"]')
    return placement


@lru_cache(maxsize=4)
def _click_solver(device: Device) -> "ClickSolver":
    from precompute.clicks import DEFAULT_OPTIONS, ClickSolver

    return ClickSolver(device, DEFAULT_OPTIONS.at_fingers)


@lru_cache(maxsize=4)
def _designer(device: Device) -> "SteadyDesigner":
    from precompute.predict.at_positions import SteadyDesigner

    return SteadyDesigner(device)


def _coordinates(position_m: Points) -> dict[str, Any]:
    parts = {"position": position_m.real} | (
        {"position_across": position_m.imag} if np.iscomplexobj(position_m) else {}
    )
    return {name: ("position", part, {"units": "m"}) for name, part in parts.items()}


def _positions_m(device: Device, fingers: Sequence[str | complex]) -> tuple[complex, ...]:
    return placement(device, (), fingers).position_m if fingers else ()
