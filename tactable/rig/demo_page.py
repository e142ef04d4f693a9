"""Prints what the demo found."""

from pathlib import Path

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table as Grid

from engine.loop import Stage
from engine.table.entry import LONGEST_RISE_S
from engine.touch import ZoneState
from tactable.rig.demo import DemoReport
from tactable.rig.demo_reports import AGREEMENT, ClickReport, StateReport
from tactable.rig.rig import Wanted


def print_demo(out: Console, report: DemoReport, figure: Path) -> None:
    """Print touches, commands, latency, promised and simulated figures, and whether they agree."""
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
    if report.clicks:
        out.print(_clicks(report))
    if not report.states and not report.clicks:
        out.print("No finger touched a zone: nothing to render.")
    out.print(
        f"estimates {len(report.device.estimated_values)} values of the device are ESTIMATES (see its file)",
        style="dim",
    )
    out.print(f"picture   {figure}", highlight=False, soft_wrap=True)
    if report.missed:
        missed = ", ".join(map(_name, report.missed))
        out.print(f"[red]MISSED: states {missed} were sent and never applied.[/red]")
    if report.not_rendered:
        late = ", ".join(map(_name, report.not_rendered))
        out.print(f"[yellow]Not rendered, the machine having stalled: states {late}.[/yellow]")
    if not report.states and not report.clicks and not report.missed:
        return
    if report.agrees:
        out.print(f"[green]Promise and simulation agree within {100 * AGREEMENT:.0f} %.[/green]")
    else:
        out.print(f"[red]Promise and simulation DISAGREE by more than {100 * AGREEMENT:.0f} %.[/red]")


def _name(wanted: Wanted) -> str:
    return f"{wanted.state} at {wanted.level_db:g} dB{' (click)' if wanted.is_click else ''}"


def _clicks(report: DemoReport) -> Grid:
    title = "clicks, promised/simulated: the firmware's waveform played from rest, standard fingers in touched zones"
    grid = Grid(title=title, title_justify="left", box=SIMPLE, padding=(0, 1, 0, 0))
    names = ("fingers", "played", "at finger\nm/s²", "\ndB", "sampled\ndB", "felt after\nms", "off\n%", "run*\ndB")
    for name in names:
        grid.add_column(name, no_wrap=True)
    for click in report.clicks:
        grid.add_row(*_click_cells(report, click))
    grid.caption = (
        "peak dB above the detection threshold; sampled: 95 % of sampled plants feel more, or less where quiet; "
        "* greatest in the run, under its own fingers"
    )
    grid.caption_justify = "left"
    return grid


def _click_cells(report: DemoReport, found: ClickReport) -> tuple[str, ...]:
    """A line for each finger, felt ones first."""
    click, felt, quiet = found.click, found.felt_zones, found.zones_in(ZoneState.QUIET)
    order = [*felt, *quiet]
    promised = [zone for i in order if (zone := click.zones[i]) is not None]
    sampled = [f"≥ {click.felt.low_db:.1f}", *[""] * (len(felt) - 1)]
    if click.quiet is not None:
        sampled += [f"≤ {click.quiet.high_db:.1f}", *[""] * (len(quiet) - 1)]
    in_run = [(felt, found.felt_m_per_s2), (quiet, found.quiet_m_per_s2)]
    levels = [found.level_db(zones[0], greatest) if zones else None for zones, greatest in in_run]
    exceeds_s = click.exceeds_at_s()
    return (
        "\n".join(f"{report.device.zones[i].name} {click.states[i].name.lower()}" for i in order),
        f"{1e3 * click.length_s:g} ms {100 * click.amplitude:.0f} %",
        "\n".join(
            f"{zone.acceleration_at_finger_m_per_s2:.2f}/{found.at_finger[i]:.2f}"
            for zone, i in zip(promised, order, strict=True)
        ),
        "\n".join(f"{zone.level_db:.1f}" for zone in promised),
        "\n".join(sampled),
        "-" if exceeds_s is None else f"{1e3 * exceeds_s:.1f}",
        f"{100 * found.disagreement:.2f}",
        "\n".join(
            line
            for (zones, _), level_db in zip(in_run, levels, strict=True)
            for line in ["-" if level_db is None else f"{level_db:.1f}", *[""] * len(zones)][: len(zones)]
        ),
    )


def _states(report: DemoReport) -> Grid:
    title = "promised/simulated: drive held until steady, standard fingers in touched zones"
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
        f"{entry.localized_factor:.3f}/{state.simulated_factor:.3f}",
        "\n".join(
            f"{a:.2f}/{state.simulated.at_finger[i]:.2f}" for a, i in zip(promised, (*felt, *quiet), strict=True)
        ),
        "\n".join(f"{zone.sensation_level_db:.1f}" for zone in zones),
        f"{'>' * (entry.t90_s >= LONGEST_RISE_S)}{1e3 * entry.t90_s:.0f}",
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
