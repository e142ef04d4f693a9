"""Writing of responses and sweeps to a table, in chunks, so that memory is bounded."""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Complex, Mask, Single
from engine.device import Device
from engine.table.best_rows import BestRows
from engine.table.netcdf_file import TableWriter, Variable, VariableStream
from precompute.model.assembly import assemble
from precompute.model.frequencies import BEAT_HZ
from precompute.model.plant import Plant
from precompute.sweep.best import BestRowSearch, Drive, Rows
from precompute.sweep.grid import (
    GridResponse,
    compute_grid_response,
    estimate_interpolation_error,
    sampling_error,
    zone_points,
)
from precompute.sweep.sweep_kernels import AmplitudeRatios, fill_coherent_sweep, fill_pair_sweep, fold_amplitudes

_CHUNK_BYTES = 1 << 23  # of rows that are not kept; few enough for the caches of a processor
_FIGURES = (
    ("localized_factor", "1", "share of the surface's kinetic energy, paper eq. (10); NaN: nothing moves"),
    ("peak_acceleration", "m s-2", "greatest peak acceleration in the zone, paper eq. (8); NaN: nothing moves"),
    ("dead_spot", "m s-2", "least peak acceleration in the zone; NaN: nothing moves"),
)


def write_responses(writer: TableWriter, plant: Plant, grid: GridResponse) -> None:
    """Write accelerations and Gram matrices on the grid, and what interpolating between its frequencies gets wrong."""
    device = plant.device
    factor_error, peak_error = estimate_interpolation_error(plant, grid)
    group = "responses"
    _write_axes(writer, group, device, "frequency", "actuator", "zone")
    position = Variable("position", ("zone", "point"), "m", "places looked at in each zone, from the surface's start")
    writer.write_points(group, position, grid.position_m)
    writer.write(group, Variable("part", ("part",), "1", "of a complex number"), ["real", "imaginary"])
    unit = np.einsum("fii->f", grid.total).real.max()

    def write_complex(name: str, dimensions: tuple[str, ...], unit_name: str, meaning: str, values: Complex) -> None:
        split = np.stack([values.real, values.imag], axis=-1)
        writer.write(group, Variable(name, (*dimensions, "part"), unit_name, meaning), split)

    square, alone = ("actuator", "actuator_2"), "complex, one actuator at full scale, others still"
    write_complex("acceleration", ("frequency", "actuator", "zone", "point"), "m s-2", alone, grid.acceleration)
    of_zone = "R_z, energy of the zone; one arbitrary unit"
    write_complex("zone_gram", ("frequency", "zone", *square), "1", of_zone, grid.gram / unit)
    of_whole = "T, energy of the whole surface, in the unit of zone_gram"
    write_complex("total_gram", ("frequency", *square), "1", of_whole, grid.total / unit)
    middle = (grid.frequency_hz[:-1] + grid.frequency_hz[1:]) / 2
    writer.write(group, Variable("interval", ("interval",), "Hz", "middle between two frequencies"), middle)
    names, of_lines = ("interval", "actuator"), "of linear interpolation, greatest over the zones; ESTIMATE"
    of_peaks = "the same, relative to the peak; ESTIMATE"
    writer.write(group, Variable("localized_factor_error", names, "1", of_lines), factor_error)
    writer.write(group, Variable("peak_acceleration_error", names, "1", of_peaks), peak_error)
    sampling = Variable("sampling_error", (), "1", "bound on the relative error of a peak between two points")
    writer.write(group, sampling, np.array(sampling_error(device)))


def _write_axes(writer: TableWriter, group: str, device: Device, *names: str) -> None:
    sweep = device.sweep
    frequency = {"frequency": "frequency", "frequency_1": "of the first", "frequency_2": "of the second"}
    amplitude = {"amplitude_1": "of the first, of full scale", "amplitude_2": "of the second, of full scale"}
    for name in names:
        if name in frequency:
            writer.write(group, Variable(name, (name,), "Hz", frequency[name]), sweep.frequency_hz)
        elif name in amplitude:
            writer.write(group, Variable(name, (name,), "1", amplitude[name]), sweep.amplitude)
        elif name == "pair":
            pairs = [f"{a.name} + {b.name}" for a, b in itertools.combinations(device.actuators, 2)]
            writer.write(group, Variable("pair", ("pair",), "1", "first + second actuator"), pairs)
        else:
            things = device.zones if name == "zone" else device.actuators
            writer.write(group, Variable(name, (name,), "1", f"name of the {name}"), [thing.name for thing in things])


def pair_filler(grid: GridResponse, pair: tuple[int, int]) -> Callable[[slice, Sequence[Single]], None]:
    """What fills factor, peak, dead of two actuators for some rows, in single precision (`fill_pair_sweep`).

    Each has the shape (frequency_1, amplitude_1 * amplitude_2, zone, frequency_2).
    """
    (first, second), ratios = pair, fold_amplitudes(grid.device.sweep.amplitude_steps)
    gram, total = (each / np.einsum("fii->f", grid.total).real.max() for each in (grid.gram.real, grid.total.real))
    of_first = abs(grid.acceleration[:, first]), gram[:, :, first, first], total[:, first, first]
    of_second = (
        abs(grid.acceleration[:, second]).transpose(1, 2, 0),
        gram[:, :, second, second].T,
        total[:, second, second],
    )
    level_1, energy_1, total_1 = (np.ascontiguousarray(each, dtype=np.float32) for each in of_first)
    level_2, energy_2, total_2 = (np.ascontiguousarray(each, dtype=np.float32) for each in of_second)
    folded = ratios.first, ratios.second, ratios.ratio.ravel(), ratios.multiple.ravel().astype(np.float32)

    def fill(rows: slice, out: Sequence[Single]) -> None:
        fill_pair_sweep(level_1[rows], level_2, energy_1[rows], energy_2, total_1[rows], total_2, *folded, *out)

    return fill


def write_pair_sweep(
    writer: TableWriter | None, grid: GridResponse, best: BestRowSearch, memory_budget_bytes: int
) -> Iterator[float]:
    """Write the (f1, f2, a1, a2) sweep of every actuator pair, a chunk of rows at a time; yields the fraction done.

    `best` gets all rows; without a writer nothing else is kept.
    """
    device = grid.device
    pairs = list(itertools.combinations(range(len(device.actuators)), 2))
    if not pairs:
        return
    names = ("pair", "frequency_1", "amplitude_1", "amplitude_2", "zone", "frequency_2")
    ratios, steps = fold_amplitudes(device.sweep.amplitude_steps), device.sweep.amplitude_steps + 1
    count, zones = len(grid.frequency_hz), len(device.zones)
    shape = (len(pairs), count, steps, steps, zones, count)
    row_bytes = len(_FIGURES) * 4 * steps * steps * zones * count
    chunk = max(1, min(count, memory_budget_bytes // row_bytes))
    buffers = [np.empty((chunk, steps * steps, zones, count), dtype=np.float32) for _ in _FIGURES]
    streams = []
    if writer is not None:
        _write_axes(writer, "sweep", device, *names)
        streams = [writer.open_stream("sweep", Variable(n, names, u, m), shape, np.float32) for n, u, m in _FIGURES]
    for p, pair in enumerate(pairs):
        fill, diagonal = pair_filler(grid, pair), _diagonal(grid, pair, ratios)
        for start in range(0, count, chunk):
            rows = slice(start, min(start + chunk, count))
            views = [buffer[: rows.stop - start] for buffer in buffers]
            fill(rows, views)
            for view, values in zip(views, diagonal, strict=True):
                frequencies = np.arange(start, rows.stop)
                view[frequencies - start, :, :, frequencies] = values[frequencies]
                view[~grid.in_band[rows, pair[0]]] = np.nan
                view[..., ~grid.in_band[:, pair[1]]] = np.nan
            for stream, view in zip(streams, views, strict=writer is not None):
                stream.append(view)
            best.take_rows(_pair_rows(grid, p, pair, ratios, start, views))
            yield (p + rows.stop / count) / len(pairs)
    for stream in streams:
        stream.close()


def _pair_rows(
    grid: GridResponse, p: int, pair: tuple[int, int], ratios: AmplitudeRatios, start: int, views: Sequence[Single]
) -> Rows:
    """The rows of two frequencies from `start` on in the chunk, each ratio once: (frequency_1, ratio, frequency_2)."""
    device, hz = grid.device, grid.frequency_hz
    # A ratio's row is its loudest pair of amplitudes, which is the last one in the order of the table.
    last = {int(ratio): at for at, ratio in enumerate(ratios.ratio.ravel())}
    sounding = np.flatnonzero((ratios.first > 0) & (ratios.second > 0))
    loudest = np.array([last[ratio] for ratio in sounding.tolist()])
    amplitude = np.stack([ratios.first, ratios.second], axis=-1, dtype=np.float64)[sounding]
    strongest = ratios.multiple.ravel()[loudest] * amplitude.max(axis=1)
    factor, *levels = (np.moveaxis(view[:, loudest], 2, 0) for view in views)
    rows = np.arange(start, start + len(views[0]))
    beats = abs(hz[rows, None] - hz) < BEAT_HZ
    factor[np.broadcast_to(beats[:, None], factor.shape)] = np.nan
    threshold = device.threshold.peak_m_per_s2(hz)
    # The table does not hold the parts m1 and m2 of a peak m1 + m2, whose levels add in power. Over the root of the sum
    # of both squared thresholds it promises no more than is felt, by the inequality of Cauchy and Schwarz:
    # (m1 + m2)^2 <= (t1^2 + t2^2) (m1^2 / t1^2 + m2^2 / t2^2).
    both = np.hypot(threshold[rows, None, None], threshold)

    def drive_at(at: tuple[int, ...]) -> Drive:
        row, ratio, other = start + at[0], at[1], at[2]
        index = (p, row, loudest[ratio], other)
        shape = (p + 1, len(hz), ratios.ratio.size, len(hz))
        drive = _by_actuator(device, pair, (hz[row], hz[other]), amplitude[ratio], 0.0)
        return int(np.ravel_multi_index(index, shape)), *drive

    figures = (factor, *(level / strongest[:, None].astype(np.float32) for level in levels))
    return Rows("sweep", figures, both.astype(np.float32), drive_at)


def _by_actuator(
    device: Device, pair: tuple[int, int], hz: Sequence[float], amplitude: Sequence[float], phase_rad: float
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Frequency, amplitude (the strongest is 1) and phase by actuator, of a pair that plays while others are still."""
    amplitude = [float(each) / float(max(amplitude)) for each in amplitude]
    values = [(float(hz[0]), 0.0, 0.0)] * len(device.actuators)
    values[pair[0]] = float(hz[0]), amplitude[0], 0.0
    values[pair[1]] = float(hz[1]), amplitude[1], phase_rad
    frequencies_hz, amplitudes, phases_rad = zip(*values, strict=True)
    return frequencies_hz, amplitudes, phases_rad


def _diagonal(grid: GridResponse, pair: tuple[int, int], ratios: AmplitudeRatios) -> list[Single]:
    """Factor, peak, dead (frequency, combination, zone) where both actuators play one frequency at phase 0."""
    directions = np.zeros((len(grid.device.actuators), len(ratios.first)), dtype=np.complex128)
    directions[pair[0]], directions[pair[1]] = ratios.first, ratios.second
    figures = compute_coherent_figures(grid, directions)
    index, multiple = ratios.ratio.ravel(), ratios.multiple.ravel().astype(np.float32)
    factor, peak, dead = (each.transpose(0, 2, 1)[:, index] for each in (figures.factor, figures.peak, figures.dead))
    multiple[multiple == 0] = np.nan  # nothing moves
    return [factor + 0 * multiple[:, None], peak * multiple[:, None], dead * multiple[:, None]]


def write_coherent_sweep(writer: TableWriter | None, grid: GridResponse, best: BestRowSearch) -> None:
    """Write the sweep over (frequency, amplitude ratio, phase) of every actuator pair at one common frequency.

    `best` gets all rows; without a writer nothing else is kept.
    """
    device = grid.device
    pairs = list(itertools.combinations(range(len(device.actuators)), 2))
    if not pairs:
        return
    ratios, steps = fold_amplitudes(device.sweep.amplitude_steps), device.sweep.phase_steps
    shape = (len(pairs), len(grid.frequency_hz), len(device.zones), len(ratios.first), steps)
    streams = [] if writer is None else _open_coherent(writer, device, ratios, shape)
    for p, pair in enumerate(pairs):
        figures = compute_coherent_figures(grid, pair_directions(len(device.actuators), pair, ratios, steps))
        tabulated = figures.factor, figures.peak, figures.dead
        for values in tabulated:
            values.transpose(0, 2, 1)[~figures.allowed] = np.nan
        for stream, values in zip(streams, tabulated, strict=writer is not None):
            stream.append(values.reshape(shape[1:]))
        best.take_rows(_coherent_rows(grid, p, pair, ratios, tabulated))
    for stream in streams:
        stream.close()


def _open_coherent(
    writer: TableWriter, device: Device, ratios: AmplitudeRatios, shape: tuple[int, ...]
) -> list[VariableStream]:
    """The axes of the coherent sweep, written, and streams of its figures."""
    group, names = "coherent_sweep", ("pair", "frequency", "zone", "ratio", "phase")
    _write_axes(writer, group, device, "pair", "frequency", "zone")
    strongest = np.maximum(ratios.first, ratios.second)
    for name, amplitude in (("amplitude_1", ratios.first / strongest), ("amplitude_2", ratios.second / strongest)):
        meaning = "of this ratio, the stronger actuator at full scale"
        writer.write(group, Variable(name, ("ratio",), "1", meaning), amplitude)
    phase, steps = Variable("phase", ("phase",), "rad", "of the second actuator against the first"), shape[-1]
    writer.write(group, phase, 2 * np.pi * np.arange(steps) / steps)
    return [writer.open_stream(group, Variable(n, names, u, m), shape, np.float32) for n, u, m in _FIGURES]


def _coherent_rows(
    grid: GridResponse, p: int, pair: tuple[int, int], ratios: AmplitudeRatios, tabulated: Sequence[Single]
) -> Rows:
    """The rows of one pair in the coherent sweep: (frequency, direction)."""
    device, hz, steps = grid.device, grid.frequency_hz, grid.device.sweep.phase_steps
    threshold = device.threshold.peak_m_per_s2(hz).astype(np.float32)[:, None]
    directions = tabulated[0].shape[2]

    def drive_at(at: tuple[int, ...]) -> Drive:
        frequency, direction = at
        ratio, phase = divmod(direction, steps)
        index = (p * len(hz) + frequency) * directions + direction
        amplitude = (ratios.first[ratio], ratios.second[ratio])
        return index, *_by_actuator(device, pair, [hz[frequency]] * 2, amplitude, 2 * math.pi * phase / steps)

    return Rows("coherent_sweep", [np.moveaxis(each, 1, 0) for each in tabulated], threshold, drive_at)


def find_best_rows(device: Device) -> BestRows:
    """The best rows of a device whose sweep is not kept."""
    grid = compute_grid_response(assemble(device), device.sweep.frequency_hz, zone_points(device))
    best = BestRowSearch(device)
    write_coherent_sweep(None, grid, best)
    for _ in write_pair_sweep(None, grid, best, _CHUNK_BYTES):
        pass
    return best.best_rows()


@dataclass(frozen=True)
class CoherentFigures:
    """Per frequency, zone and direction, shape (frequency, zone, direction); peak and dead in m/s^2.

    Where a direction drives an actuator outside its band, `allowed` (frequency, direction) is False.
    """

    factor: Single
    peak: Single
    dead: Single
    allowed: Mask


def pair_directions(actuators: int, pair: tuple[int, int], ratios: AmplitudeRatios, phase_steps: int) -> Complex:
    """Shape (actuator, ratio * phase): both actuators of a pair, the stronger at full scale, phase on the second."""
    phase = np.exp(2j * np.pi * np.arange(phase_steps) / phase_steps)
    strongest = np.maximum(ratios.first, ratios.second)
    out = np.zeros((actuators, len(strongest), phase_steps), dtype=np.complex128)
    out[pair[0]] = (ratios.first / strongest)[:, None]
    out[pair[1]] = (ratios.second / strongest)[:, None] * phase
    return out.reshape(actuators, -1)


def compute_coherent_figures(grid: GridResponse, directions: Complex) -> CoherentFigures:
    """Localized factor, peak and dead spot of every zone under every direction, at every frequency of the grid."""
    shape = (len(grid.frequency_hz), len(grid.device.zones), directions.shape[1])
    factor, peak, dead = (np.empty(shape, dtype=np.float32) for _ in range(3))
    unit = np.einsum("fii->f", grid.total).real.max()  # the kernel is in single precision
    fields = (grid.acceleration, grid.gram / unit, grid.total / unit, directions)
    fill_coherent_sweep(*(part for field in fields for part in _split(field)), factor, peak, dead)
    allowed = ~((~grid.in_band).astype(np.int64) @ (abs(directions) > 0).astype(np.int64)).astype(bool)
    return CoherentFigures(factor, peak, dead, allowed)


def _split(values: Complex) -> tuple[Single, Single]:
    return np.ascontiguousarray(values.real, dtype=np.float32), np.ascontiguousarray(values.imag, dtype=np.float32)
