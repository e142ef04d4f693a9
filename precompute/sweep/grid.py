"""Unit responses on the grid of a sweep: frequencies, places in each zone, and the errors between them."""

from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex, Mask, Points, even_points
from engine.device import Device
from precompute.model.frequencies import in_band
from precompute.model.gram import compute_gram
from precompute.model.plant import Plant
from precompute.model.response import solve_response

SAMPLING_ERROR = 2e-3  # relative, of a tabulated peak by finitely many points of a zone, where they are enough
_MOST_POINTS = 256
"""About how many points of a zone are looked at. A bar's zone needs tens; a tablet's would need 1 400, and a table of
133 MB that takes ten times as long to sweep."""


@dataclass(frozen=True)
class GridResponse:
    """Unit responses on a grid. Bands are not applied: `in_band` (frequency, actuator) says what may be driven.

    acceleration (frequency, actuator, zone, point) m/s^2 at full scale; gram (frequency, zone, actuator, actuator) and
    total (frequency, actuator, actuator) in one arbitrary unit of energy.
    """

    device: Device
    frequency_hz: Array
    position_m: Points
    acceleration: Complex
    gram: Complex
    total: Complex
    in_band: Mask


def zone_points(device: Device) -> Points:
    """Points (zone, point), edges included, a multiple of 8, close enough for `sampling_error`."""
    (spacing_m, _), (longest_m, widest_m) = _spacing(device), _largest_m(device)
    along, across = 8 * int(np.ceil((longest_m / spacing_m + 1) / 8)), 1 + int(np.ceil(widest_m / spacing_m))
    return np.stack([even_points(zone.start_m, zone.stop_m, along, across) for zone in device.zones])


def sampling_error(device: Device) -> float:
    """Bound on the relative error of a peak that lies between two `zone_points`.

    It is missed by about (k d)^2 / 8, k the bending wave number at the highest frequency, d the spacing; twice that is
    allowed for, since near fields curve more than waves. In both directions of a plate the same spacing serves, since
    kx^2 + ky^2 = k^2.
    """
    return SAMPLING_ERROR * _spacing(device)[1] ** 2


def _spacing(device: Device) -> tuple[float, float]:
    """Distance of neighbouring points in metres, and how often it holds the one that SAMPLING_ERROR asks for."""
    asked_m: float = np.sqrt(4 * SAMPLING_ERROR) / device.surface.wave_number_per_m(device.sweep.stop_hz)
    longest_m, widest_m = _largest_m(device)
    points = (longest_m / asked_m + 1) * (widest_m / asked_m + 1)
    times = max(1.0, float(np.sqrt(points / _MOST_POINTS)))
    return asked_m * times, times


def _largest_m(device: Device) -> tuple[float, float]:
    """The greatest length and width of a zone."""
    spans_m = [zone.stop_m - zone.start_m for zone in device.zones]
    return max(span_m.real for span_m in spans_m), max(span_m.imag for span_m in spans_m)


def compute_grid_response(plant: Plant, frequency_hz: Array, position_m: Points) -> GridResponse:
    """Solve the plant at every frequency and look at every point (zone, point)."""
    response = solve_response(plant, frequency_hz)
    acceleration = response.acceleration(position_m.ravel())
    gram, total = compute_gram(response)
    return GridResponse(
        device=plant.device,
        frequency_hz=frequency_hz,
        position_m=position_m,
        acceleration=acceleration.reshape(*acceleration.shape[:2], *position_m.shape),
        gram=gram,
        total=total,
        in_band=in_band(plant.device, frequency_hz),
    )


def estimate_interpolation_error(plant: Plant, grid: GridResponse) -> tuple[Array, Array]:
    """What a straight line between neighbouring frequencies gets wrong at their middle, where the plant is solved too.

    Greatest errors (interval, actuator) of a zone's localized factor, and of a zone's peak relative to the peak there,
    one actuator driven.
    """
    middle = compute_grid_response(plant, (grid.frequency_hz[:-1] + grid.frequency_hz[1:]) / 2, grid.position_m)
    (share, level), (share_there, level_there) = _single_figures(grid), _single_figures(middle)
    of_share = abs((share[:-1] + share[1:]) / 2 - share_there).max(axis=2)
    return of_share, abs((level[:-1] + level[1:]) / 2 / level_there - 1).max(axis=2)


def _single_figures(grid: GridResponse) -> tuple[Array, Array]:
    """Localized factor and peak of each actuator alone at full scale: (frequency, actuator, zone)."""
    energy = np.einsum("fzii->fiz", grid.gram).real
    return energy / np.einsum("fii->fi", grid.total).real[..., None], np.abs(grid.acceleration).max(axis=3)
