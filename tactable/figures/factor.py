"""The localized factor over two frequencies, of the untouched surface."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from base.arrays import Array
from engine.device import Device
from engine.table import Table, TableError
from tactable.figures.picture_file import Picture
from tactable.figures.style import COLOUR_MAP, GREY, VERMILLION, finish_picture

_PANELS, _PANEL_INCHES, _LARGE_PANEL_INCHES = 3, 3.4, 4.4  # panels in a row and their sides, of many and of one
_ON_GRID = 1e-6  # an amplitude this close to one of the sweep is it


@dataclass(frozen=True)
class PairDrive:
    """Two actuators (indices, in the order of the device) and their amplitudes as fractions of full scale."""

    actuators: tuple[int, int]
    amplitudes: tuple[float, float]


def pair_drive(device: Device, names: Sequence[str], amplitudes: Sequence[float]) -> PairDrive:
    """The drive of two actuators by name, none: the first two. Raises TableError for what the sweep does not have."""
    pairs = list(itertools.combinations(range(len(device.actuators)), 2))
    if not pairs:
        raise TableError(f"{device.name}: has one actuator, a sweep over two frequencies needs two")
    known = {tuple(device.actuators[i].name for i in pair): pair for pair in pairs}
    pair = known.get(tuple(names)) if names else pairs[0]
    if pair is None:
        listed = "; ".join(",".join(names) for names in known)
        raise TableError(f"{device.name}: there is no actuator pair {','.join(names)!r}; pairs are {listed}")
    steps = device.sweep.amplitude
    if len(amplitudes) != 2 or any(min(abs(steps - amplitude)) > _ON_GRID for amplitude in amplitudes):
        given, listed = ",".join(f"{amplitude:g}" for amplitude in amplitudes), ", ".join(f"{a:g}" for a in steps)
        raise TableError(f"{device.name}: amplitudes {given!r} are not two of the sweep's: {listed}")
    if not any(amplitude > _ON_GRID for amplitude in amplitudes):
        raise TableError(f"{device.name}: with both amplitudes 0 nothing moves; drive at least one")
    first, second = amplitudes
    return PairDrive(pair, (first, second))


def plot_factor(table: Table, combinations: Sequence[Sequence[str]], drive: PairDrive) -> Picture:
    """Picture of each combination of zones from the table's sweep.

    Raises DeviceError for unknown zones, TableError where the table has no sweep.
    """
    device = table.device
    is_alone = len(combinations) == 1
    named = ["untouched"] if is_alone else [f"{', '.join(zones)} untouched" for zones in combinations]
    maps = {name: read_factor(table, zones, drive) for name, zones in zip(named, combinations, strict=True)}
    columns = min(len(maps), _PANELS)
    rows = -(-len(maps) // columns)
    size = _LARGE_PANEL_INCHES if is_alone else _PANEL_INCHES
    figure = Figure(figsize=(1.6 + size * columns, 1.3 + 0.87 * size * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    every = np.stack(list(maps.values()))
    scale = (float(np.nanmin(every)), float(np.nanmax(every)))
    for axes, (name, factor) in zip(panels.ravel(), maps.items(), strict=False):
        image = _draw(axes, device, factor, scale)
        axes.set_title(f"{name}: {_greatest_text(device, factor)}", fontsize="small")
    for axes in panels.ravel()[len(maps) :]:
        axes.set_visible(False)
    for axes in panels[:, 0]:
        axes.set_ylabel(_axis_text(device, drive, 1))
    for column in range(columns):
        last = [row for row in range(rows) if row * columns + column < len(maps)][-1]
        panels[last, column].set_xlabel(_axis_text(device, drive, 0))
        panels[last, column].tick_params(labelbottom=True)
    words = ", ".join(combinations[0]) if is_alone else "each zone"
    figure.colorbar(image, ax=panels, label=f"localized factor of {words} (1)", pad=0.02)
    legend = "on the diagonal one frequency: there fields add, in phase"
    if np.isnan(every).any():
        legend += "; grey: out of an actuator's band"
    return finish_picture(
        figure,
        device,
        f"{device.name}: localized factor of {words}",
        "; ".join(f"{name} {_greatest_text(device, factor)}" for name, factor in maps.items()),
        _columns(device, drive, maps),
        {
            "zones": [list(zones) for zones in combinations],
            "actuators": [device.actuators[i].name for i in drive.actuators],
            "amplitudes": list(drive.amplitudes),
            "greatest": [_greatest(device, factor) for factor in maps.values()],
        },
        notes=(),
        subtitle=f"({legend})",
    )


def read_factor(table: Table, zones: Sequence[str], drive: PairDrive) -> Array:
    """The factor (frequency_1, frequency_2) in the sweep of the untouched bar; NaN out of an actuator's band."""
    device = table.device
    pair = list(itertools.combinations(range(len(device.actuators)), 2)).index(drive.actuators)
    first, second = (int(abs(device.sweep.amplitude - amplitude).argmin()) for amplitude in drive.amplitudes)
    return np.asarray(table.localized_factor(zones, pair)[:, :, first, second], dtype=np.float64)


def _draw(axes: Axes, device: Device, factor: Array, scale: tuple[float, float]) -> AxesImage:
    sweep = device.sweep
    edges_hz = (sweep.start_hz - sweep.step_hz / 2, sweep.stop_hz + sweep.step_hz / 2)
    axes.set_facecolor(GREY)  # where an actuator is out of its band
    extent, (least, greatest) = (*edges_hz, *edges_hz), scale
    image = axes.imshow(
        factor.T, origin="lower", extent=extent, aspect="auto", cmap=COLOUR_MAP, vmin=least, vmax=greatest
    )
    best = _greatest(device, factor)
    axes.plot(
        best["frequency_1_hz"], best["frequency_2_hz"], "o", ms=10, mew=2, mfc="none", color=VERMILLION, clip_on=False
    )
    return image


def _axis_text(device: Device, drive: PairDrive, which: int) -> str:
    name = device.actuators[drive.actuators[which]].name
    return f"frequency of {name}, at {100 * drive.amplitudes[which]:g} % (Hz)"


def _greatest(device: Device, factor: Array) -> dict[str, float]:
    first, second = np.unravel_index(np.nanargmax(factor), factor.shape)
    hz = device.sweep.frequency_hz
    return {
        "localized_factor": float(factor[first, second]),
        "frequency_1_hz": float(hz[first]),
        "frequency_2_hz": float(hz[second]),
    }


def _greatest_text(device: Device, factor: Array) -> str:
    best = _greatest(device, factor)
    return f"{best['localized_factor']:.3f} at {best['frequency_1_hz']:g} and {best['frequency_2_hz']:g} Hz"


def _columns(device: Device, drive: PairDrive, maps: dict[str, Array]) -> dict[str, Array]:
    hz = device.sweep.frequency_hz
    names = [device.actuators[i].name for i in drive.actuators]
    first, second = np.meshgrid(hz, hz, indexing="ij")
    frequencies = {f"frequency of {names[0]} (Hz)": first.ravel(), f"frequency of {names[1]} (Hz)": second.ravel()}
    return frequencies | {f"localized factor {name} (1)": factor.ravel() for name, factor in maps.items()}
