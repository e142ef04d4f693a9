"""The plant to its entries: best drive of every zone combination, with everything it promises."""

import itertools
from collections.abc import Iterator
from contextlib import contextmanager

import numba
import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.entry import Entry, ZonePromise
from engine.table import TableError
from engine.zones import ZoneState
from precompute.assembly import Plant
from precompute.grid import compute_grid_response, refine_frequencies
from precompute.modal import ModalModel, compute_basis, compute_modal_model, compute_rise_time
from precompute.optimum import FREQUENCY_STEP_HZ, Optimizer, Optimum
from precompute.steady import SteadyState, compute_steady_state

_BELOW_BOUND = 1e-4
MAX_COMBINED_ZONES = 10
"""Beyond this many zones an entry for every combination is no table any more."""


def solve_entries(plant: Plant, points_m: NDArray[np.float64]) -> Iterator[tuple[Entry, float]]:
    """The entry of every zone combination on the untouched bar, with the fraction done."""
    device = plant.device
    zones = range(len(device.zones))
    if len(device.zones) > MAX_COMBINED_ZONES:
        raise TableError(f"{device.name}: {len(device.zones)} zones; a table holds up to {MAX_COMBINED_ZONES}")
    model = compute_modal_model(compute_basis(plant))
    refined_hz = refine_frequencies(device.sweep.frequency_hz, model)
    optimizer = Optimizer(plant, compute_grid_response(plant, refined_hz, points_m))
    combinations = [c for size in range(1, len(zones) + 1) for c in itertools.combinations(zones, size)]
    for done, felt in enumerate(combinations, 1):
        with _one_thread():
            entry = _make_entry(plant, model, felt, optimizer.solve(felt))
        yield entry, done / len(combinations)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Kernels on one thread: a search makes many small calls, and a barrier waits for whoever shares the machine."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(threads)


def _make_entry(plant: Plant, model: ModalModel, felt: tuple[int, ...], optimum: Optimum) -> Entry:
    device, best = plant.device, optimum.best
    frequency_hz = np.round(best.frequency_hz / FREQUENCY_STEP_HZ) * FREQUENCY_STEP_HZ
    amplitude = best.amplitude * device.limits.amplitude
    magnitude = np.minimum(abs(amplitude), device.limits.amplitude)  # a product may round up beyond the limit
    steady = compute_steady_state(plant, frequency_hz, amplitude)
    share = float(steady.share[list(felt)].sum())
    states = [ZoneState.FELT if zone in felt else ZoneState.FREE for zone in range(len(device.zones))]
    peaks_m = steady.peak_position_m[list(felt)]
    return Entry(
        frequencies_hz=tuple(frequency_hz.tolist()),
        amplitudes=tuple(magnitude.tolist()),
        phases_rad=tuple(np.angle(amplitude).tolist()),
        zones=tuple(_promise(device, steady, z, state) for z, state in enumerate(states)),
        localized_factor=share,
        upper_bound=max(optimum.upper_bound, share),
        contrast_db=_contrast_db(device, felt, share),
        t90_s=float(compute_rise_time(model, frequency_hz, amplitude, peaks_m).max()),
        family=best.family,
        limited_by=_limited_by(device, optimum, steady, felt),
        achieved=_reaches_floor(device, steady, felt),
    )


def _promise(device: Device, steady: SteadyState, zone: int, state: ZoneState) -> ZonePromise:
    return ZonePromise(
        name=device.zones[zone].name,
        state=state,
        share=float(steady.share[zone]),
        peak_acceleration_m_per_s2=float(steady.peak[zone]),
        peak_position_m=float(steady.peak_position_m[zone]),
        dead_acceleration_m_per_s2=float(steady.dead[zone]),
        dead_position_m=float(steady.dead_position_m[zone]),
    )


def _contrast_db(device: Device, felt: tuple[int, ...], share: float) -> float | None:
    """Energy per length, felt zones over the rest of the bar (the paper's 0.8626 for three of five is 6.2 dB)."""
    inside_m = sum(device.zones[zone].length_m for zone in felt)
    outside_m = device.bar.length_m - inside_m
    if outside_m < 1e-9 * device.bar.length_m or not 0 < share < 1:
        return None
    return float(10 * np.log10(share / inside_m * outside_m / (1 - share)))


def _reaches_floor(device: Device, steady: SteadyState, felt: tuple[int, ...]) -> bool:
    return bool(steady.peak[list(felt)].min() >= device.limits.level_floor_m_per_s2)


def _limited_by(device: Device, optimum: Optimum, steady: SteadyState, felt: tuple[int, ...]) -> str:
    """Names of what holds the drive: the level floor, the amplitude limit, a band's edge."""
    best, floor, parts = optimum.best, device.limits.level_floor_m_per_s2, list[str]()
    if not _reaches_floor(device, steady, felt):
        out_of_reach = [zone for zone in felt if steady.peak[zone] < floor]
        parts.append(f"level floor out of reach in {device.zone_names(out_of_reach)}")
    elif best.localized_factor < optimum.upper_bound - _BELOW_BOUND:
        low = [zone for zone in felt if steady.peak[zone] < 1.01 * floor]
        parts.append(f"level floor in {device.zone_names(low)}" if low else "level floor")
    for actuator, frequency, weight in zip(device.actuators, best.frequency_hz, abs(best.amplitude), strict=True):
        if weight > 1 - 1e-6:
            parts.append(f"full scale of {actuator.name}")
        if weight > 0 and min(abs(frequency - edge) for edge in actuator.band_hz) < FREQUENCY_STEP_HZ:
            parts.append(f"band of {actuator.name}")
    return "; ".join(parts)
