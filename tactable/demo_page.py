"""The demo's findings to a page that a person understands."""

from pathlib import Path

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table as Grid

from engine.latency import Stage
from tactable.demo import AGREEMENT, DemoReport, StateReport


def print_demo(out: Console, report: DemoReport, figure: Path) -> None:
    """Touches, commands, promised against measured, latency, verdict."""
    run, counters = report.run, report.run.counters
    pace = "real pace" if report.speed == 1 else f"{report.speed:.1f} times real pace"
    out.print(f"[bold]{report.device.name}[/bold]: touches to felt zones. SIMULATED: firmware and bar.")
    out.print(f"touches   {report.recording.name}, at {pace}", markup=False, highlight=False)
    out.print(
        f"          {counters.reports} reports, {counters.frames} frames, {counters.state_changes} changes of state"
    )
    applied = sum(run.applied(change) is not None for change in run.trace)
    greeted = f"; {counters.reconnects} reconnects" if counters.reconnects else ""
    frames = f"{run.frames_sent} frames with renewals"
    out.print(f"commands  {counters.commands} sent, {applied} applied by the firmware, {frames}{greeted}")
    if latency := run.latency.summarise(Stage.AVAILABLE, Stage.WRITTEN):
        figures = f"median {latency.p50_ns / 1e6:.2f} ms, greatest {latency.max_ns / 1e6:.2f} ms of {latency.count}"
        out.print(f"latency   report due to command written: {figures} (a pseudo-terminal; see README)")
    if report.states:
        out.print(_states(report))
    else:
        out.print("No finger touched a zone: nothing to render.")
    out.print(f"estimates {len(report.device.inferred)} values of the device are ESTIMATES (see its file)", style="dim")
    out.print(f"picture   {figure}", highlight=False, soft_wrap=True)
    if report.missed:
        out.print(f"[red]MISSED: states {list(report.missed)} were sent and never applied.[/red]")
    if not report.states and not report.missed:
        return
    if report.agrees:
        out.print(f"[green]Promised and measured agree within {100 * AGREEMENT:.0f} %.[/green]")
    else:
        out.print(f"[red]Promised and measured DISAGREE by more than {100 * AGREEMENT:.0f} %.[/red]")


def _states(report: DemoReport) -> Grid:
    title = "promised/measured on the simulated bar: drive held until steady, bar untouched"
    grid = Grid(title=title, title_justify="left", box=SIMPLE, padding=(0, 1, 0, 0))
    for name in ("felt", "drive", "localized\nfactor", "peaks of felt\nzones, m/s²", "t90\nms", "differ", "in\nrun*"):
        grid.add_column(name, no_wrap=name != "felt")
    for state in report.states:
        grid.add_row(*_cells(state))
    grid.caption = "* greatest m/s² under a finger during the run, fingers loading the bar"
    grid.caption_justify = "left"
    return grid


def _cells(state: StateReport) -> tuple[str, ...]:
    entry, zones = state.entry, state.felt_zones
    peaks = [f"{entry.zones[i].peak_acceleration_m_per_s2:.2f}/{state.measured.peak[i]:.2f}" for i in zones]
    return (
        ", ".join(entry.zones[i].name for i in zones),
        _drive(state),
        f"{entry.localized_factor:.3f}/{state.measured_factor:.3f}",
        "\n".join(peaks),
        f"{1e3 * entry.t90_s:.0f}",
        f"{100 * state.disagreement:.2f} %",
        f"{state.felt_m_per_s2:.2f}",
    )


def _drive(state: StateReport) -> str:
    """Such as "151.2 Hz 36+100 %", or a line for each tone."""
    amplitudes: dict[float, list[str]] = {}
    for hz, amplitude in zip(state.entry.frequencies_hz, state.entry.amplitudes, strict=True):
        amplitudes.setdefault(hz, []).append(f"{100 * amplitude:.3g}")
    return "\n".join(f"{hz:g} Hz {'+'.join(parts)} %" for hz, parts in amplitudes.items())
