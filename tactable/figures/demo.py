"""The picture of the demo: touches, what fingers felt, and the acceleration along the bar, promised and simulated."""

import itertools
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from engine.device import Device
from engine.table import ClickEntry
from engine.touch import ZoneState
from precompute.model.assembly import assemble
from precompute.model.response import solve_response
from tactable.figures.style import BLUE, GREEN, GREY, VERMILLION
from tactable.rig.bar import Felt
from tactable.rig.demo import DemoReport
from tactable.rig.demo_reports import ClickReport, StateReport

_MOST_STATES = 6
_SHOWN_S = 0.1
_STYLES = ("-", "--", "-.")


def draw_demo(report: DemoReport, path: Path) -> None:
    """Write the picture: touches, felt acceleration and drive over time, then up to six states along the bar."""
    states: list[StateReport | ClickReport] = list(report.states)
    states = [*states, *report.clicks][:_MOST_STATES]
    rows = 3 + (len(states) + 1) // 2
    figure = Figure(figsize=(10, 2.4 * rows), layout="constrained")
    grid = figure.add_gridspec(rows, 2)
    figure.suptitle(f"{report.device.name}: touches to felt zones (SIMULATED firmware and bar)")
    touches = figure.add_subplot(grid[0, :])
    _draw_touches(touches, report)
    if report.felt:
        _draw_felt(figure.add_subplot(grid[1, :], sharex=touches), report.felt)
        _draw_drive(figure.add_subplot(grid[2, :], sharex=touches), report.device, report.felt)
    for k, state in enumerate(states):
        axes = figure.add_subplot(grid[3 + k // 2, k % 2])
        if isinstance(state, ClickReport):
            _draw_click(axes, report.device, state)
        else:
            _draw_state(axes, report.device, state, legend=k == 0)
    figure.savefig(path, dpi=110)


def _draw_touches(axes: Axes, report: DemoReport) -> None:
    """Where the fingers are over time, zones as bands."""
    device, trace = report.device, report.run.trace
    for i, zone in enumerate(device.zones):
        axes.axhspan(1e3 * zone.start_m, 1e3 * zone.stop_m, color=GREY, alpha=0.12 if i % 2 else 0.28, lw=0)
        axes.text(0.004, (zone.start_m + zone.stop_m) / 2 / device.bar.length_m, zone.name, transform=axes.transAxes)
    for actuator in device.actuators:
        axes.axhline(1e3 * actuator.position_m, color=GREY, lw=0.8, ls=":")
    for change, after in itertools.pairwise(trace):
        span_s = [(time_ns - trace[0].time_ns) / 1e9 for time_ns in (change.time_ns, after.time_ns)]
        for position_m in change.finger_positions_m:
            axes.plot(span_s, [1e3 * position_m] * 2, color=BLUE, lw=4, solid_capstyle="butt")
    axes.set(ylabel="finger on the bar (mm)", ylim=(0, 1e3 * device.bar.length_m))
    axes.set_title("touches at each change of state; dotted: actuators", fontsize="small", loc="left")


def _draw_felt(axes: Axes, felt: Felt) -> None:
    axes.fill_between(felt.time_s, felt.felt, step="post", color=VERMILLION, lw=0.4, label="to be felt")
    axes.fill_between(felt.time_s, felt.quiet, step="post", color=BLUE, lw=0.4, label="quiet")
    axes.set(ylabel="under a finger (m/s²)", ylim=(0, None))
    title = "peak acceleration under the fingers of the recording: those that are to feel at the moment, and the others"
    axes.set_title(title, fontsize="small", loc="left")
    axes.legend(fontsize="x-small", loc="upper right", ncols=2)


def _draw_drive(axes: Axes, device: Device, felt: Felt) -> None:
    for i, actuator in enumerate(device.actuators):
        colour = (BLUE, GREEN, GREY)[i % 3]
        axes.step(felt.time_s, 100 * felt.drive[:, i], where="post", lw=1.2, color=colour, label=actuator.name)
    axes.set(xlabel="time (s)", ylabel="base (% of full scale)", ylim=(0, 110))
    axes.set_title("displacement that the firmware synthesised", fontsize="small", loc="left")
    axes.legend(fontsize="x-small", loc="upper right", ncols=3)


def _draw_state(axes: Axes, device: Device, state: StateReport, *, legend: bool) -> None:
    entry = state.entry
    for i, zone in enumerate(device.zones):
        colour = {ZoneState.FELT: GREEN, ZoneState.QUIET: BLUE}.get(entry.zones[i].state)
        if colour is not None:
            axes.axvspan(1e3 * zone.start_m, 1e3 * zone.stop_m, color=colour, alpha=0.2, lw=0)
        axes.text(
            1e3 * (zone.start_m + zone.stop_m) / 2,
            0.98,
            zone.name,
            ha="center",
            va="top",
            transform=axes.get_xaxis_transform(),
        )
    position_m = np.linspace(0, device.bar.length_m, 400)
    axes.plot(1e3 * position_m, _envelope(device, state, position_m), color=BLUE, label="promised")
    simulated = state.simulated
    axes.plot(1e3 * simulated.position_m, simulated.acceleration, "o", ms=4, color=VERMILLION, label="simulated")
    at_finger = [zone.acceleration_at_finger_m_per_s2 or np.nan for zone in entry.zones]
    middle_mm = [1e3 * (zone.start_m + zone.stop_m) / 2 for zone in device.zones]
    axes.plot(middle_mm, at_finger, "_", ms=14, color=BLUE)
    axes.plot(middle_mm, simulated.at_finger, "D", ms=5, color=VERMILLION, label="simulated under a finger")
    drive = ", ".join(
        f"{f:g} Hz {100 * a:.0f} %" for f, a in zip(entry.frequencies_hz, entry.amplitudes, strict=True) if a
    )
    factor = f"Λ {entry.localized_factor:.3f} promised, {state.simulated_factor:.3f} simulated"
    title = f"{_fingers(state)}\n{factor}; {drive}"
    axes.set_title(title, fontsize="small", loc="left")
    axes.margins(y=0.15)
    axes.set(xlabel="along the bar (mm)", ylabel="peak (m/s²)", xlim=(0, 1e3 * device.bar.length_m))
    axes.set_ylim(bottom=0)
    if legend:
        axes.legend(fontsize="x-small", loc="upper right", bbox_to_anchor=(1, 0.9))


def _draw_click(axes: Axes, device: Device, found: ClickReport) -> None:
    """Acceleration under each finger, the promised peaks as lines; the bases' displacements in grey."""
    click, simulated = found.click, found.simulated
    shown = simulated.time_s <= _SHOWN_S
    time_ms = 1e3 * simulated.time_s[shown]
    right = axes.twinx()
    right.plot(time_ms, 100 * simulated.drive[shown], color=GREY, lw=0.6)
    right.set(ylim=(-110, 110), ylabel="base (% of full scale)")
    for column, zone in enumerate(found.touched_zones):
        is_felt = click.states[zone] is ZoneState.FELT
        colour, promise = (VERMILLION if is_felt else BLUE), click.zones[zone]
        assert promise is not None
        label = f"{device.zones[zone].name} {'felt' if is_felt else 'quiet'}"
        style = _STYLES[column % len(_STYLES)]
        axes.plot(time_ms, simulated.acceleration[shown, column], style, lw=1.2, color=colour, label=label)
        peak = promise.acceleration_at_finger_m_per_s2
        for sign in (-1, 1):
            axes.axhline(sign * peak, color=colour, lw=0.8, ls=":")
    title = f"{_click_fingers(device, click)}\nclick at {100 * click.amplitude:.0f} %; dotted: promised peaks"
    axes.set_title(title, fontsize="small", loc="left")
    axes.set(xlabel="time (ms)", ylabel="under the finger (m/s²)")
    axes.margins(y=0.2)
    axes.set_zorder(right.get_zorder() + 1)
    axes.patch.set_visible(False)
    axes.legend(fontsize="x-small", loc="upper right", ncols=2)


def _click_fingers(device: Device, click: ClickEntry) -> str:
    """Such as "III felt 20.0 dB, I quiet -4.2 dB"."""
    return ", ".join(
        f"{zone.name} {click.states[i].name.lower()} {promise.level_db:.1f} dB"
        for kind in (ZoneState.FELT, ZoneState.QUIET)
        for i, (zone, promise) in enumerate(zip(device.zones, click.zones, strict=True))
        if promise is not None and click.states[i] is kind
    )


def _fingers(state: StateReport) -> str:
    """Such as "III felt 20.0 dB, I quiet 4.2 dB"."""
    zones = [state.entry.zones[i] for kind in (ZoneState.FELT, ZoneState.QUIET) for i in state.zones_in(kind)]
    return ", ".join(f"{zone.name} {zone.state.name.lower()} {zone.sensation_level_db:.1f} dB" for zone in zones)


def _envelope(device: Device, state: StateReport, position_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Peak steady acceleration of the entry's drive along the bar and its fingers, paper eq. (8)."""
    plant = assemble(device)
    touched = [device.zones[i] for i, zone in enumerate(state.entry.zones) if zone.state is not ZoneState.FREE]
    loaded = plant.with_fingers([(zone.start_m + zone.stop_m) / 2 for zone in touched], device.finger)
    entry = state.entry
    frequency_hz = np.array(entry.frequencies_hz)
    weight = np.array(entry.amplitudes) * np.exp(1j * np.array(entry.phases_rad))
    tones = np.unique(frequency_hz[weight != 0])
    acceleration = solve_response(loaded, tones).acceleration(position_m)
    share = np.where(frequency_hz == tones[:, None], weight, 0)
    return np.asarray(abs(np.einsum("fa,fap->fp", share, acceleration)).sum(axis=0))
