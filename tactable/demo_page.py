"""The demo's findings to a page that a person understands."""

from pathlib import Path

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
        f"          {counters.reports} reports, {counters.frames} touch frames, {counters.state_changes} changes of state"
    )
    applied = sum(run.applied(change) is not None for change in run.trace)
    greeted = f"; {counters.reconnects} reconnects after stalls" if counters.reconnects else ""
    out.print(
        f"commands  {counters.commands} sent, {applied} applied by the firmware, {run.frames_sent} frames with renewals{greeted}"
    )
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
    if report.agrees:
        out.print(f"[green]Promised and measured agree within {100 * AGREEMENT:.0f} %.[/green]")
    else:
        out.print(f"[red]Promised and measured DISAGREE by more than {100 * AGREEMENT:.0f} %.[/red]")


def _states(report: DemoReport) -> Grid:
    grid = Grid(title="promised / measured in the time-domain bar, drive held, bar untouched", title_justify="left")
    for name in ("felt", "drive (left, right …)", "localized factor", "peak in the felt zones, m/s²", "t90", "differ"):
        grid.add_column(name)
    grid.add_column("in the run, under\na finger, m/s²", justify="right")
    for state in report.states:
        grid.add_row(*_cells(state))
    return grid


def _cells(state: StateReport) -> tuple[str, ...]:
    entry, zones = state.entry, state.felt_zones
    drives = zip(entry.frequencies_hz, entry.amplitudes, strict=True)
    peaks = [f"{entry.zones[i].peak_acceleration_m_per_s2:.2f}/{state.measured.peak[i]:.2f}" for i in zones]
    return (
        ", ".join(entry.zones[i].name for i in zones),
        "  ".join(f"{hz:g} Hz {100 * a:.0f} %" if a else "still" for hz, a in drives),
        f"{entry.localized_factor:.3f} / {state.measured_factor:.3f}",
        "  ".join(peaks),
        f"{1e3 * entry.t90_s:.0f} ms",
        f"{100 * state.disagreement:.2f} %",
        f"{state.felt_m_per_s2:.2f}",
    )
