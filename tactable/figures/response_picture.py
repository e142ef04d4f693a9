"""Acceleration along the bar, with measured points (paper's Figures 6 and 7), and the reading that any place gives."""

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from base.arrays import Array, Points
from engine.device import Device
from precompute.measurements.model import MeasurementModel
from precompute.measurements.types import Measurements, lay_out
from tactable.figures import style
from tactable.figures.picture_file import Picture

PLACES = 401  # less than a millimetre apart on 300 mm
MOST_PANELS = 12  # a page's worth
NODE = 0.1
"""A minimum below this fraction of the greatest acceleration is marked: a dead spot of this drive."""
_MM_PER_INCH = 25.4  # by definition
_HEADROOM = 1.18  # above the greatest value: the names of the zones


def plot_response(device: Device, layout: Measurements, *, has_readings: bool) -> Picture:
    """Picture of the first MOST_PANELS drives of `layout`, a panel each; with the readings, if it has any.

    The curve is what the sensor would read. Fields of one frequency add, of several magnitudes (paper eq. (8)).
    """
    measured = layout if has_readings else None
    number = layout.drive_of_row
    first_rows = [int((number == drive).argmax()) for drive in range(min(int(number.max()) + 1, MOST_PANELS))]
    place_m = np.linspace(0.0, device.bar.length_m, PLACES)
    curves = [(place_m, reading_at(device, layout, row, place_m)) for row in first_rows]
    figure = Figure(figsize=(9, 1.8 + 2.0 * len(curves)), layout="constrained")
    panels = figure.subplots(len(curves), 1, sharex=True, squeeze=False)[:, 0]
    for k, (axes, row, curve) in enumerate(zip(panels, first_rows, curves, strict=True)):
        rows = np.flatnonzero(number == number[row])
        _draw(axes, device, curve, None if measured is None else measured.part(rows), is_first=k == 0)
        axes.set_title(drive_text(device, layout, row), fontsize="small", loc="left")
    panels[-1].set(xlabel="along the bar (mm)")
    is_simulated = measured is not None and measured.is_simulated
    drives = [_summary_of(device, layout, *pair) for pair in zip(first_rows, curves, strict=True)]
    readings = 0 if measured is None else len(measured)
    return style.finish_picture(
        figure,
        device,
        f"{device.name}: peak acceleration along the bar{', SIMULATED points' if is_simulated else ''}",
        "; ".join(f"{drive['drive']} {_node_text(drive)}" for drive in drives),
        _columns(device, layout, first_rows, curves) if measured is None else _compared(device, measured),
        {"simulated": is_simulated, "readings": readings, "drives": drives},
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
    nodes_m: Array = position_m[1:-1][is_node]
    return nodes_m


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
    size: Array = np.exp(MeasurementModel(device, measurements, ()).predict(np.zeros(0)).log_acceleration.real)
    return size


def _draw(
    axes: Axes, device: Device, curve: tuple[Array, Array], measured: Measurements | None, *, is_first: bool
) -> None:
    place_m, level = curve
    label = "computed" if measured is None else "computed, with the sensor at each place"
    axes.plot(1e3 * place_m, level, color=style.BLUE, lw=1.6, label=label)
    nodes_m = find_nodes(place_m, level)
    axes.plot(1e3 * nodes_m, np.interp(nodes_m, place_m, level), "v", ms=6, color=style.VERMILLION, label="node")
    greatest = float(level.max())
    if measured is not None:
        size = np.abs(measured.acceleration)
        name = "SIMULATED points" if measured.is_simulated else "measured"
        axes.plot(1e3 * measured.position_m, size, "o", ms=4.5, mfc="none", color=style.BLACK, label=name)
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
    device: Device, layout: Measurements, rows: list[int], curves: list[tuple[Array, Array]]
) -> dict[str, Array]:
    named = {f"{drive_text(device, layout, row)} (m/s^2)": level for row, (_, level) in zip(rows, curves, strict=True)}
    return {"position (m)": curves[0][0], **named}


def _compared(device: Device, measured: Measurements) -> dict[str, Array]:
    """A row a reading."""
    names = [actuator.name for actuator in device.actuators]
    return {
        "position (m)": measured.position_m.real,
        **{f"frequency of {name} (Hz)": measured.frequency_hz[:, i] for i, name in enumerate(names)},
        **{f"amplitude of {n} (fraction of full scale)": abs(measured.amplitude[:, i]) for i, n in enumerate(names)},
        "sensor mass (kg)": measured.sensor_mass_kg,
        "read (m/s^2)": np.abs(measured.acceleration),
        "computed (m/s^2)": _predicted(device, measured),
    }


def _summary_of(device: Device, layout: Measurements, row: int, curve: tuple[Array, Array]) -> dict[str, object]:
    place_m, level = curve
    return {
        "drive": drive_text(device, layout, row),
        "greatest_m_per_s2": float(level.max()),
        "nodes_m": find_nodes(place_m, level).tolist(),
    }


def _node_text(drive: dict[str, object]) -> str:
    nodes_m = drive["nodes_m"]
    assert isinstance(nodes_m, list)
    return "no node" if not nodes_m else "nodes at " + ", ".join(f"{1e3 * at:.0f}" for at in nodes_m) + " mm"
