"""The picture of the demo: touches, what fingers felt, and accelerations of the surface, promised and simulated."""

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from base.files import replace_file
from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.response import peak_along
from tactable.explain.words import finger_roles
from tactable.figures import style
from tactable.rig.demo_run import ClickReport, DemoReport, DriveReport
from tactable.rig.simulated_surface import Felt, is_felt

_MOST_DRAWN = 6  # three rows of two
_CLICK_ROOM = -1.2, 1.9  # ends of the vertical axis of a click, in peaks: the legend lies above the curves
_SHOWN_S = 0.1  # a click and its ring-down
_STYLES = ("-", "--", "-.")


def draw_demo(report: DemoReport, path: Path) -> None:
    """Write the picture: touches, felt acceleration and drive over time, then up to six drives and clicks."""
    held, room = report.drives, max(_MOST_DRAWN - len(report.clicks), 1)
    drawn: list[DriveReport | ClickReport] = [
        held[round(k)] for k in np.linspace(0, len(held) - 1, min(len(held), room))
    ]
    drawn = [*drawn, *report.clicks][:_MOST_DRAWN]
    device, sides = report.device, style.sides_of(report.device)
    above = len(sides) + 2
    rows = above + (len(drawn) + 1) // 2
    figure = Figure(figsize=(10, 2.4 * rows), layout="constrained")
    grid = figure.add_gridspec(rows, 2)
    figure.suptitle(f"{device.name}: touches to felt fingers (SIMULATED firmware and {device.surface.kind})")
    first: Axes | None = None
    for row, (name, mm) in enumerate(sides.items()):
        axes = figure.add_subplot(grid[row, :], sharex=first)
        _draw_touches(axes, report, name, mm)
        first = first or axes
    if report.felt:
        _draw_felt(figure.add_subplot(grid[above - 2, :], sharex=first), report.felt)
        _draw_drive(figure.add_subplot(grid[above - 1, :], sharex=first), device, report.felt)
    for k, command in enumerate(drawn):
        axes = figure.add_subplot(grid[above + k // 2, k % 2])
        if isinstance(command, ClickReport):
            _draw_click(axes, device, command)
        else:
            _draw_held(axes, device, command, legend=k == 0)
    with replace_file(path) as made:
        figure.savefig(made, format=path.suffix[1:].lower(), dpi=110)


def _draw_touches(axes: Axes, report: DemoReport, side: str, mm: Callable[[complex], float]) -> None:
    """Positions of the fingers along one side over time by role; zones as bands."""
    device, moments, length_mm = report.device, report.run.moments, mm(report.device.surface.corner_m)
    names = dict[tuple[float, float], list[str]]()
    for zone in device.zones:
        names.setdefault((mm(zone.start_m), mm(zone.stop_m)), []).append(zone.name)
    for i, ((start_mm, stop_mm), named) in enumerate(names.items()):
        axes.axhspan(start_mm, stop_mm, color=style.GREY, alpha=0.12 if i % 2 else 0.28, lw=0)
        axes.text(0.004, (start_mm + stop_mm) / 2 / length_mm, ", ".join(named), transform=axes.transAxes)
    for actuator in device.actuators:
        axes.axhline(mm(actuator.position_m), color=style.GREY, lw=0.8, ls=":")
    lines: dict[str, list[list[tuple[float, float]]]] = {style.BLUE: [], style.VERMILLION: []}
    for moment, after in itertools.pairwise(moments):
        start_s, stop_s = ((each.time_ns - moments[0].time_ns) / 1e9 for each in (moment, after))
        for touch in moment.touches:
            colour = style.VERMILLION if is_felt(touch, moment) else style.BLUE
            lines[colour].append([(start_s, mm(touch.position_m)), (stop_s, mm(touch.position_m))])
    for colour, segments in lines.items():
        axes.add_collection(LineCollection(segments, colors=colour, linewidths=4, capstyle="butt"))
    axes.set(ylabel=f"finger {side} (mm)", ylim=(0, length_mm))
    title = "fingers as the digitizer has them, red while they are to feel; dotted: actuators"
    axes.set_title(title, fontsize="small", loc="left")


def _draw_felt(axes: Axes, felt: Felt) -> None:
    axes.fill_between(felt.time_s, felt.felt, step="post", color=style.VERMILLION, lw=0.4, label="to be felt")
    axes.fill_between(felt.time_s, felt.quiet, step="post", color=style.BLUE, lw=0.4, label="quiet")
    axes.set(ylabel="under a finger (m/s²)", ylim=(0, None))
    title = "peak acceleration under the fingers of the recording: those that are to feel at the moment, and the others"
    axes.set_title(title, fontsize="small", loc="left")
    axes.legend(fontsize="x-small", loc="upper right", ncols=2)


def _draw_drive(axes: Axes, device: Device, felt: Felt) -> None:
    for i, actuator in enumerate(device.actuators):
        colour, ls = style.CURVES[i % len(style.CURVES)]
        axes.step(felt.time_s, 100 * felt.drive[:, i], ls=ls, where="post", lw=1.2, color=colour, label=actuator.name)
    axes.set(xlabel="time (s)", ylabel="base (% of full scale)", ylim=(0, 110))
    axes.set_title("displacement that the firmware synthesised", fontsize="small", loc="left")
    axes.legend(fontsize="x-small", loc="upper right", ncols=3)


def _draw_held(axes: Axes, device: Device, report: DriveReport, *, legend: bool) -> None:
    simulated, placement, drive = report.simulated, report.placement, report.drive
    field = style.surface_field(device)
    loaded = assemble(device).with_fingers(placement.position_m, device.finger)
    peak = peak_along(loaded, np.array(drive.frequencies_hz), drive.complex_amplitudes, field.position_m)
    parts = "+".join(f"{100 * amplitude:.3g}" for amplitude in drive.amplitudes)
    factor = f"Λ {report.promised_factor:.3f} promised, {report.simulated_factor:.3f} simulated"
    words = f"{factor}; {report.frequency_text} {parts} %"
    title = words if style.is_plate(device) else f"{_fingers_text(device, report)}\n{words}"
    axes.set_title(title, fontsize="small", loc="left")
    if style.is_plate(device):
        image = style.draw_map(axes, device, field, peak, "peak, promised (m/s²)\nin circles: simulated")
        style.draw_values(axes, image, simulated.position_m, simulated.acceleration)
        style.draw_fingers(axes, placement, [f"{level_db:z.1f} dB" for level_db in report.promise.level_db])
        return
    style.draw_zone_names(axes, device)
    axes.plot(1e3 * field.position_m, peak, color=style.BLUE, label="promised")
    axes.plot(1e3 * simulated.position_m, simulated.acceleration, "o", ms=4, color=style.VERMILLION, label="simulated")
    finger_mm = 1e3 * np.array(placement.position_m)
    axes.plot(finger_mm, report.promise.acceleration_m_per_s2, "_", ms=14, color=style.BLUE)
    for finger, is_felt_here in enumerate(placement.is_felt):
        colour, label = (
            (style.GREEN, "simulated, felt finger") if is_felt_here else (style.GREY, "simulated, quiet finger")
        )
        axes.plot(finger_mm[finger], simulated.at_finger[finger], "D", ms=6, color=colour, label=label)
    axes.margins(y=0.15)
    axes.set(xlabel="along the bar (mm)", ylabel="peak (m/s²)", xlim=(0, 1e3 * device.surface.length_m))
    axes.set_ylim(bottom=0)
    if legend:
        axes.legend(fontsize="x-small", loc="upper right", bbox_to_anchor=(1, 0.9))


def _draw_click(axes: Axes, device: Device, found: ClickReport) -> None:
    """Acceleration under each finger, the promised peaks as lines; the bases' displacements in grey."""
    click, simulated, placement = found.click, found.simulated, found.placement
    shown = simulated.time_s <= _SHOWN_S
    time_ms = 1e3 * simulated.time_s[shown]
    right = axes.twinx()
    right.plot(time_ms, 100 * simulated.drive[shown], color=style.GREY, lw=0.6)
    most = max(abs(simulated.acceleration[shown]).max(), *found.promise.acceleration_m_per_s2)
    low, high = _CLICK_ROOM
    right.set(ylim=(100 * low, 100 * high), yticks=range(-100, 101, 50), ylabel="base (% of full scale)")
    for finger, name in enumerate(finger_roles(device, placement)):
        colour, line = style.VERMILLION if placement.is_felt[finger] else style.BLUE, _STYLES[finger % len(_STYLES)]
        axes.plot(time_ms, simulated.acceleration[shown, finger], line, lw=1.2, color=colour, label=name)
        peak = found.promise.acceleration_m_per_s2[finger]
        for sign in (-1, 1):
            axes.axhline(sign * peak, color=colour, lw=0.8, ls=":")
    title = f"{_fingers_text(device, found)}\nclick at {100 * click.amplitude:.0f} %; dotted: promised peaks"
    axes.set_title(title, fontsize="small", loc="left")
    axes.set(xlabel="time (ms)", ylabel="under the finger (m/s²)", ylim=(low * most, high * most))
    axes.set_zorder(right.get_zorder() + 1)
    axes.patch.set_visible(False)
    axes.legend(fontsize="x-small", loc="upper right", ncols=2)


def _fingers_text(device: Device, report: DriveReport | ClickReport) -> str:
    """The fingers in words, such as "140 mm (III) felt 20.0 dB, 28 mm (I) quiet -4.2 dB"."""
    placement, names = report.placement, finger_roles(device, report.placement)
    fingers = (*placement.felt, *placement.quiet)
    return ", ".join(f"{names[finger]} {report.promise.level_db[finger]:z.1f} dB" for finger in fingers)
