"""The demo's findings to a page that a person understands."""

from pathlib import Path

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table as Grid

from engine.latency import Stage
from engine.zones import ZoneState
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
        missed = ", ".join(f"{state} at {level_db:g} dB" for state, level_db in report.missed)
        out.print(f"[red]MISSED: states {missed} were sent and never applied.[/red]")
    if report.not_rendered:
        late = ", ".join(f"{state} at {level_db:g} dB" for state, level_db in report.not_rendered)
        out.print(f"[yellow]Not rendered, the machine having stalled: states {late}.[/yellow]")
    if not report.states and not report.missed:
        return
    if report.agrees:
        out.print(f"[green]Promised and measured agree within {100 * AGREEMENT:.0f} %.[/green]")
    else:
        out.print(f"[red]Promised and measured DISAGREE by more than {100 * AGREEMENT:.0f} %.[/red]")


def _states(report: DemoReport) -> Grid:
    title = "promised/measured: drive held until steady, standard fingers in touched zones"
    grid = Grid(title=title, title_justify="left", box=SIMPLE, padding=(0, 1, 0, 0))
    names = ("fingers", "drive", "localized\nfactor", "at finger\nm/s²", "\ndB", "t90\nms", "off\n%", "run*\ndB")
    for name in names:
        grid.add_column(name, no_wrap=True)
    for state in report.states:
        grid.add_row(*_cells(state))
    grid.caption = "dB above the detection threshold; * greatest in the run, under its own fingers"
    grid.caption_justify = "left"
    return grid


def _cells(state: StateReport) -> tuple[str, ...]:
    """A line for each finger, felt ones first."""
    entry, felt, quiet = state.entry, state.felt_zones, state.zones_in(ZoneState.QUIET)
    zones = [entry.zones[i] for i in (*felt, *quiet)]
    promised = [zone.acceleration_at_finger_m_per_s2 for zone in zones]
    in_run = [(felt, state.felt_m_per_s2), (quiet, state.quiet_m_per_s2)]
    return (
        "\n".join(f"{zone.name} {zone.state.name.lower()}" for zone in zones),
        _drive(state),
        f"{entry.localized_factor:.3f}/{state.measured_factor:.3f}",
        "\n".join(f"{a:.2f}/{state.measured.at_finger[i]:.2f}" for a, i in zip(promised, (*felt, *quiet), strict=True)),
        "\n".join(f"{zone.sensation_level_db:.1f}" for zone in zones),
        f"{1e3 * entry.t90_s:.0f}",
        f"{100 * state.disagreement:.2f}",
        "\n".join(line for fingers, greatest in in_run for line in _in_run(state, len(fingers), greatest)),
    )


def _in_run(state: StateReport, fingers: int, greatest_m_per_s2: float) -> list[str]:
    """The level on the line of the first finger, the others blank; "-" where nothing was felt."""
    level_db = state.level_db(greatest_m_per_s2)
    return ["-" if level_db is None else f"{level_db:.1f}", *[""] * fingers][:fingers]


def _drive(state: StateReport) -> str:
    """Such as "151.2 Hz 3.6+100 %", or a line for each tone."""
    amplitudes: dict[float, list[str]] = {}
    for hz, amplitude in zip(state.entry.frequencies_hz, state.entry.amplitudes, strict=True):
        percent = 100 * amplitude
        amplitudes.setdefault(hz, []).append(f"{percent:.0f}" if percent >= 10 else f"{percent:.2g}")
    return "\n".join(f"{hz:g} Hz {'+'.join(parts)} %" for hz, parts in amplitudes.items())
