"""Drives of the untouched surface: the acceleration over it and the factor of every zone (paper's Figures 3 and 8)."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from base.arrays import Array
from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.gram import SteadyState, compute_steady_state
from precompute.model.plant import Plant
from precompute.model.response import peak_along
from precompute.predict.untouched import BarDrive, find_untouched_optima
from tactable.figures import style
from tactable.figures.picture_file import FigureError, Picture

_HEADROOM = 1.3  # above the greatest value: names of the zones and legend
_HATCHES = ("", "///", "...", "xxx")
_TITLE_LETTERS = 60  # a line of the title of a map
_BAR_SHARE = 0.8  # of a zone's width; the rest parts it from its neighbours


@dataclass(frozen=True)
class _Shown:
    """A drive, its peak acceleration at the points of the picture (point,), m/s^2, and its figures by zone."""

    drive: BarDrive
    level: Array
    state: SteadyState


def plot_zones(device: Device, drives: Sequence[BarDrive]) -> Picture:
    """Picture of up to four drives. Raises FigureError for more."""
    if not 1 <= len(drives) <= len(_HATCHES):
        raise FigureError(f"{len(drives)} drives: expected one to {len(_HATCHES)}; draw the others by themselves")
    shown = _compute(assemble(device), drives)
    return _picture(device, shown, f"{device.name}: acceleration and localized factor by zone, untouched", [])


def plot_optimum(device: Device, zones: Sequence[str]) -> Picture:
    """Picture of the drives of greatest localized factor of `zones` together. Raises DeviceError for no such zone."""
    wanted = [device.zone_index(name) for name in zones]
    plant = assemble(device)
    shown = _compute(plant, find_untouched_optima(plant, wanted))
    return _picture(device, shown, f"{device.name}: greatest localized factor of {', '.join(zones)}, untouched", wanted)


def _compute(plant: Plant, drives: Sequence[BarDrive]) -> list[_Shown]:
    place_m = style.surface_field(plant.device).position_m
    return [
        _Shown(
            drive,
            peak_along(plant, drive.frequency_hz, drive.amplitude, place_m),
            compute_steady_state(plant, drive.frequency_hz, drive.amplitude),
        )
        for drive in drives
    ]


def _picture(device: Device, shown: Sequence[_Shown], caption: str, wanted: Sequence[int]) -> Picture:
    if style.is_plate(device):
        rows, map_inches = (len(shown) + 1) // 2, style.map_height(device, 3.4)
        figure = Figure(figsize=(9, rows * map_inches + 3.2), layout="constrained")
        grid = figure.add_gridspec(rows + 1, 2, height_ratios=[map_inches] * rows + [2.2])
        for k, each in enumerate(shown):
            axes = figure.add_subplot(grid[k // 2, k % 2])
            style.draw_map(axes, device, style.surface_field(device), each.level, "peak (m/s²)")
            axes.set_title(textwrap.fill(_label(device, each.drive), _TITLE_LETTERS), fontsize="x-small")
        _draw_factors(figure.add_subplot(grid[rows, :]), device, shown, wanted)
    else:
        figure = Figure(figsize=(9, 6.2), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
        _draw_acceleration(above, device, shown, wanted)
        _draw_factors(below, device, shown, wanted)
    return style.finish_picture(
        figure,
        device,
        caption,
        "; ".join(_factor_text(device, each, wanted) for each in shown),
        _columns(device, shown),
        {
            "zones": [device.zones[zone].name for zone in wanted],
            "drives": [_summary_of(device, each, wanted) for each in shown],
        },
        notes=(),
    )


def _draw_acceleration(axes: Axes, device: Device, shown: Sequence[_Shown], wanted: Sequence[int]) -> None:
    place_mm = 1e3 * style.surface_field(device).position_m.real
    for zone in wanted:
        start_mm, stop_mm = 1e3 * device.zones[zone].start_m.real, 1e3 * device.zones[zone].stop_m.real
        axes.axvspan(start_mm, stop_mm, color=style.GREEN, alpha=0.12, lw=0)
    for each, (colour, ls) in zip(shown, style.CURVES, strict=False):
        axes.plot(place_mm, each.level, color=colour, ls=ls, lw=1.7, label=_label(device, each.drive))
    axes.set(
        ylabel="peak acceleration (m/s²)",
        xlim=(0, place_mm[-1]),
        ylim=(0, _HEADROOM * max(float(each.level.max()) for each in shown)),
    )
    axes.grid(color=style.GREY, lw=0.3)
    style.draw_gravities(axes)
    style.draw_zone_names(axes, device)
    style.draw_actuators(axes, device)
    axes.legend(fontsize="x-small", loc="upper center", bbox_to_anchor=(0.5, 0.93))


def _draw_factors(axes: Axes, device: Device, shown: Sequence[_Shown], wanted: Sequence[int]) -> None:
    middle_mm = np.array([1e3 * zone.middle_m.real for zone in device.zones])
    width_mm = _BAR_SHARE / len(shown) * np.array([1e3 * zone.length_m for zone in device.zones])
    if style.is_plate(device):  # side by side in their order
        middle_mm, width_mm = np.arange(len(device.zones)) + 1.0, np.full(len(device.zones), _BAR_SHARE / len(shown))
    for k, (each, (colour, _)) in enumerate(zip(shown, style.CURVES, strict=False)):
        place_mm = middle_mm + (k - (len(shown) - 1) / 2) * width_mm
        axes.bar(place_mm, each.state.share, 0.92 * width_mm, color=colour, hatch=_HATCHES[k], ec="white", lw=0)
        for x_mm, share in zip(place_mm, each.state.share, strict=True):
            axes.text(x_mm, share, f"{share:.3f}", ha="center", va="bottom", fontsize="x-small")
    names = [f"{zone.name}, wanted" if k in wanted else zone.name for k, zone in enumerate(device.zones)]
    greatest = max(float(each.state.share.max()) for each in shown)
    if style.is_plate(device):
        axes.set_xticks(middle_mm, names)
    else:
        style.draw_zone_names(axes, device, names)
        axes.set_xlabel("along the bar (mm)")
    axes.set(ylabel="localized factor\nof each zone (1)", ylim=(0, _HEADROOM * greatest))


def _label(device: Device, drive: BarDrive) -> str:
    """The drive in words, such as "left 60 Hz, right 90 Hz at 60 %, +0.50 rad"."""
    parts = []
    for actuator, hz, amplitude in zip(device.actuators, drive.frequency_hz, drive.amplitude, strict=True):
        if amplitude:
            share = "" if abs(amplitude) > 1 - 1e-9 else f" at {100 * abs(amplitude):.3g} %"
            phase = f", {np.angle(amplitude):+.2f} rad" if abs(np.angle(amplitude)) > 5e-3 else ""
            parts.append(f"{actuator.name} {hz:g} Hz{share}{phase}")
    words = "; ".join(parts)
    return f"{drive.name}: {words}" if drive.name else words


def _factor_text(device: Device, shown: _Shown, wanted: Sequence[int]) -> str:
    if wanted:
        return f"{shown.state.share[list(wanted)].sum():.4f} by {_label(device, shown.drive)}"
    first, last = (device.zones[int(at)].name for at in (shown.state.share.argmax(), shown.state.share.argmin()))
    return f"{_label(device, shown.drive)}: greatest in {first}, least in {last}"


def _columns(device: Device, shown: Sequence[_Shown]) -> dict[str, Sequence[object] | Array]:
    """The zones of the first drive, of the second, and so on."""
    columns: dict[str, Sequence[object] | Array] = {
        "drive": [_label(device, each.drive) for each in shown for _ in device.zones],
        "zone": [zone.name for _ in shown for zone in device.zones],
    }
    figures = {
        "localized factor (1)": "share",
        "peak acceleration (m/s^2)": "peak",
        "position of the peak (m)": "peak_position_m",
        "least acceleration (m/s^2)": "dead",
        "position of the least (m)": "dead_position_m",
    }
    for header, name in figures.items():
        values = np.concatenate([getattr(each.state, name) for each in shown])
        columns |= style.position_columns(values, header) if name.endswith("position_m") else {header: values}
    return columns


def _summary_of(device: Device, shown: _Shown, wanted: Sequence[int]) -> dict[str, object]:
    drive = shown.drive
    return {
        "drive": _label(device, drive),
        "frequency_hz": drive.frequency_hz,
        "amplitude": abs(drive.amplitude),
        "phase_rad": np.angle(drive.amplitude),
        "localized_factor": shown.state.share[list(wanted)].sum() if wanted else None,
        "by_zone": dict(zip((zone.name for zone in device.zones), shown.state.share.tolist(), strict=True)),
    }
