"""Acceleration over the surface, with readings (on a bar the paper's Figures 6 and 7), and the reading of any place."""

import math
import textwrap
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from base.arrays import Array, Mask, Points
from base.points import json_of, point_text
from engine.device import Device
from precompute.measurements.model import MeasurementModel
from precompute.measurements.types import Measurements, lay_out
from tactable.figures import style
from tactable.figures.picture_file import Picture

MOST_PANELS, _MOST_STACKED = 12, 4  # a page's worth; one above the other
NODE = 0.1  # a minimum below this fraction of the greatest acceleration is marked: a dead spot of this drive
_MM_PER_INCH = 25.4  # by definition
_MAPS_A_ROW, _MAP_INCHES = 2, 4.0
_TITLE_LETTERS = 60  # a line above a panel
_HEADROOM = 1.18  # above the greatest value: the names of the zones


def plot_response(device: Device, layout: Measurements, *, has_readings: bool, is_wrong: Mask | None = None) -> Picture:
    """Picture of at most MOST_PANELS drives of `layout`, evenly chosen, a panel each; with the readings, if it has any.

    The curve is what the sensor would read. Fields of one frequency add, of several magnitudes (paper eq. (8)).
    is_wrong (row,): readings that a fit took for wrong.
    """
    measured = layout if has_readings else None
    number = layout.drive_of_row
    drives = np.unique(np.linspace(0, number.max(), min(int(number.max()) + 1, MOST_PANELS)).round())
    first_rows = [int((number == drive).argmax()) for drive in drives]
    place_m = style.surface_field(device).position_m
    curves = [(place_m, reading_at(device, layout, row, place_m)) for row in first_rows]
    figure, panels = _panels(device, len(curves))
    for k, (axes, row, curve) in enumerate(zip(panels, first_rows, curves, strict=True)):
        read = None if measured is None else measured.part(np.flatnonzero(number == number[row]))
        wrong = np.zeros(0, np.bool_) if is_wrong is None else is_wrong[number == number[row]]
        if style.is_plate(device):
            _draw_map(axes, device, curve[1], read, wrong)
        else:
            _draw(axes, device, curve, read, wrong, is_first=k == 0)
        axes.set_title(textwrap.fill(drive_text(device, layout, row), _TITLE_LETTERS), fontsize="small", loc="left")
    is_simulated = measured is not None and measured.is_simulated
    summaries = [
        {"drive": drive_text(device, layout, row), **_summary_of(*curve)}
        for row, curve in zip(first_rows, curves, strict=True)
    ]
    readings = 0 if measured is None else len(measured)
    where = "over the plate" if style.is_plate(device) else "along the bar"
    return style.finish_picture(
        figure,
        device,
        f"{device.name}: peak acceleration {where}{', SIMULATED points' if is_simulated else ''}",
        "; ".join(f"{drive['drive']} {_words_of(*pair)}" for drive, pair in zip(summaries, curves, strict=True)),
        _columns(device, layout, first_rows, curves) if measured is None else _compared(device, measured),
        {"simulated": is_simulated, "readings": readings, "drives": summaries},
        notes=(),
        origin=_origin(measured),
    )


def reading_at(device: Device, measurements: Measurements, row: int, place_m: Points) -> Array:
    """What a reading at places (place,) would be (place,), m/s^2, driven and loaded as `row`."""
    there = replace(
        lay_out(measurements.frequency_hz[row : row + 1], place_m, float(measurements.sensor_mass_kg[row])),
        amplitude=np.repeat(measurements.amplitude[row : row + 1], len(place_m), axis=0),
        finger_m=np.full(len(place_m), measurements.finger_m[row]),
        force_m=None if measurements.force_m is None else np.full(len(place_m), measurements.force_m[row]),
    )
    return _predicted(device, there)


def find_nodes(position_m: Array, level: Array) -> Array:
    """Places (node,) in metres of the minima of level (place,) that lie below NODE of its maximum, the ends aside."""
    inner = level[1:-1]
    is_node = (inner < level[:-2]) & (inner <= level[2:]) & (inner < NODE * level.max())
    return position_m[1:-1][is_node]


def drive_text(device: Device, measurements: Measurements, row: int) -> str:
    """Drive of a row in words, such as "left 150 Hz, right 130 Hz at 60 %"."""
    if measurements.force_m is not None:
        return measurements.drive_text(row)
    parts = []
    for i, actuator in enumerate(device.actuators):
        size = abs(measurements.amplitude[row, i])
        if size > 0:
            share = "" if size == 1 else f" at {100 * size:.3g} %"
            parts.append(f"{actuator.name} {measurements.frequency_hz[row, i]:g} Hz{share}")
    return ", ".join(parts)


def _origin(measured: Measurements | None) -> str:
    if measured is None:
        return style.COMPUTED
    return "Curves computed, points SIMULATED." if measured.is_simulated else "Curves computed, points measured."


def _predicted(device: Device, measurements: Measurements) -> Array:
    """Shape (row,), m/s^2: the magnitude that each row should read."""
    return np.exp(MeasurementModel(device, measurements, ()).predict(np.zeros(0)).log_acceleration.real)


def _panels(device: Device, count: int) -> tuple[Figure, list[Axes]]:
    """A figure with `count` panels: stacked along one axis for a bar, many in two columns; maps of a plate in pairs."""
    if not style.is_plate(device):
        columns = 1 if count <= _MOST_STACKED else 2
        rows = math.ceil(count / columns)
        figure = Figure(figsize=(9 + 3 * (columns - 1), 1.8 + 2.0 * rows), layout="constrained")
        panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
        for axes in panels[-1]:
            axes.set(xlabel="along the bar (mm)")
        for axes in panels.ravel()[count:]:
            axes.set_visible(False)
        return figure, panels.ravel()[:count].tolist()
    rows = math.ceil(count / _MAPS_A_ROW)
    height = 1.2 + rows * style.map_height(device, _MAP_INCHES)
    figure = Figure(figsize=(_MAPS_A_ROW * (_MAP_INCHES + 1), height), layout="constrained")
    return figure, [figure.add_subplot(rows, _MAPS_A_ROW, k + 1) for k in range(count)]


def _draw_map(axes: Axes, device: Device, level: Array, measured: Measurements | None, wrong: Mask) -> None:
    """The computed acceleration as a map, and on it the readings as discs of the same colours."""
    size = np.zeros(0) if measured is None else np.abs(measured.acceleration)
    greatest = float(np.max([*level, *size]))
    label = "peak (m/s²)" if measured is None else "peak (m/s²); discs: read"
    image = style.draw_map(axes, device, style.surface_field(device), level, label, vmin=0.0, vmax=greatest)
    if measured is not None:
        style.draw_values(axes, image, measured.position_m, size)
        at_mm = 1e3 * measured.position_m[np.flatnonzero(wrong)]
        axes.plot(at_mm.real, at_mm.imag, "o", ms=8, mfc="none", color=style.ORANGE)


def _draw(
    axes: Axes,
    device: Device,
    curve: tuple[Points, Array],
    measured: Measurements | None,
    wrong: Mask,
    *,
    is_first: bool,
) -> None:
    place_m, level = curve[0].real, curve[1]
    label = "computed" if measured is None else "computed, with the sensor at each place"
    axes.plot(1e3 * place_m, level, color=style.BLUE, lw=1.6, label=label)
    nodes_m = find_nodes(place_m, level)
    axes.plot(1e3 * nodes_m, np.interp(nodes_m, place_m, level), "v", ms=6, color=style.VERMILLION, label="node")
    greatest = float(level.max())
    if measured is not None:
        size = np.abs(measured.acceleration)
        name = "SIMULATED points" if measured.is_simulated else "measured"
        axes.plot(1e3 * measured.position_m, size, "o", ms=4.5, mfc="none", color=style.BLACK, label=name)
        place_mm = 1e3 * measured.position_m[np.flatnonzero(wrong)]
        axes.plot(place_mm, size[np.flatnonzero(wrong)], "o", ms=4.5, color=style.ORANGE, label="taken for wrong")
        greatest = max(greatest, float(size.max()))
    axes.set(xlim=(0, 1e3 * device.bar.length_m), ylim=(0, _HEADROOM * greatest), ylabel="peak (m/s²)")
    axes.grid(color=style.GREY, lw=0.3)
    style.draw_gravities(axes)
    style.draw_zone_names(axes, device)
    style.draw_actuators(axes, device)
    if is_first:
        style.draw_scaled(axes.secondary_xaxis, "top", 1 / _MM_PER_INCH).set_xlabel("(inch)", fontsize="small")
        axes.legend(fontsize="x-small", loc="upper right", bbox_to_anchor=(1.0, 0.88))


def _columns(
    device: Device, layout: Measurements, rows: list[int], curves: list[tuple[Points, Array]]
) -> dict[str, Array]:
    named = {f"{drive_text(device, layout, row)} (m/s^2)": level for row, (_, level) in zip(rows, curves, strict=True)}
    return style.position_columns(curves[0][0]) | named


def _compared(device: Device, measured: Measurements) -> dict[str, Array]:
    """A row a reading."""
    names = [actuator.name for actuator in device.actuators]
    return {
        **style.position_columns(measured.position_m),
        **{f"frequency of {name} (Hz)": measured.frequency_hz[:, i] for i, name in enumerate(names)},
        **{f"amplitude of {n} (fraction of full scale)": abs(measured.amplitude[:, i]) for i, n in enumerate(names)},
        "sensor mass (kg)": measured.sensor_mass_kg,
        "read (m/s^2)": np.abs(measured.acceleration),
        "computed (m/s^2)": _predicted(device, measured),
    }


def _summary_of(place_m: Points, level: Array) -> dict[str, object]:
    """The greatest acceleration, where it is, and the nodes of a bar; those of a plate are lines."""
    greatest: dict[str, object] = {"greatest_m_per_s2": float(level.max())}
    greatest |= {"greatest_position_m": json_of(place_m[level.argmax()].item())}
    return greatest if np.iscomplexobj(place_m) else greatest | {"nodes_m": find_nodes(place_m.real, level).tolist()}


def _words_of(place_m: Points, level: Array) -> str:
    if np.iscomplexobj(place_m):
        return f"{level.max():.3g} m/s² at {point_text(place_m[level.argmax()].item(), 3)}"
    nodes_m = find_nodes(place_m.real, level)
    return "no node" if not len(nodes_m) else "nodes at " + ", ".join(f"{1e3 * at:.0f}" for at in nodes_m) + " mm"
