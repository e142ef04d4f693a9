"""Prints what the demo found."""

from collections.abc import Sequence
from pathlib import Path

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table as Grid

from engine.device import Device
from engine.loop.observer import Stage
from engine.table.best_rows import BestRow
from tactable.explain.words import finger_names, placement_text
from tactable.rig.demo_run import AGREEMENT, ClickReport, DemoReport, DriveReport
from tactable.rig.rig import Wanted


def print_demo(out: Console, report: DemoReport, figure: Path) -> None:
    """Print touches, commands, latency, promised and simulated figures, and whether they agree."""
    run, counters = report.run, report.run.counters
    pace = "real pace" if report.speed == 1 else f"{report.speed:.1f} times real pace"
    device = report.device
    out.print(f"{device.name}: touches to felt fingers. SIMULATED: firmware and {device.surface.kind}.", style="bold")
    out.print(f"touches   {report.recording.name}, at {pace}", highlight=False)
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
    if report.drives:
        out.print(_drives(report))
    if report.clicks:
        out.print(_clicks(report))
    if not report.drives and not report.clicks:
        out.print("No finger was to feel: nothing to render.")
    out.print(
        f"estimates {len(report.device.estimated_values)} values of the device are ESTIMATES (see its file)",
        style="dim",
    )
    out.print(f"picture   {figure}", highlight=False, soft_wrap=True)
    if report.missed:
        missed = "; ".join(_name(report.device, wanted) for wanted in report.missed)
        out.print(f"MISSED: {missed} were sent and never applied.", style="red")
    if report.not_rendered:
        late = "; ".join(_name(report.device, wanted) for wanted in report.not_rendered)
        out.print(f"Not rendered, the machine having stalled: {late}.", style="yellow")
    if not report.drives and not report.clicks and not report.missed:
        return
    if report.agrees:
        out.print(f"Promise and simulation agree within {100 * AGREEMENT:.0f} %.", style="green")
    else:
        out.print(f"Promise and simulation DISAGREE by more than {100 * AGREEMENT:.0f} %.", style="red")


def _name(device: Device, wanted: Wanted) -> str:
    return (
        f"{placement_text(device, wanted.placement)} at {wanted.level_db:g} dB{' (click)' if wanted.is_click else ''}"
    )


def _grid(title: str, names: Sequence[str], caption: str) -> Grid:
    grid = Grid(title=title, title_justify="left", box=SIMPLE, padding=(0, 1, 0, 0))
    for name in names:
        grid.add_column(name, no_wrap=True)
    grid.caption, grid.caption_justify = caption, "left"
    return grid


def _clicks(report: DemoReport) -> Grid:
    grid = _grid(
        "clicks, promised/simulated: the firmware's waveform played from rest, standard fingers at their positions",
        ("fingers", "played", "at finger\nm/s²", "\ndB", "sampled\ndB", "felt after\nms", "off\n%"),
        f"peak dB {report.device.threshold.above}; sampled: 95 % of sampled plants feel more, or less where quiet",
    )
    for click in report.clicks:
        grid.add_row(*_click_cells(report.device, click))
    return grid


def _click_cells(device: Device, report: ClickReport) -> tuple[str, ...]:
    """A line for each finger, felt ones first."""
    click, placement = report.click, report.placement
    sampled = [f"≥ {click.felt.low_db:.1f}", *[""] * (len(placement.felt) - 1)]
    if click.quiet is not None:
        sampled += [f"≤ {click.quiet.high_db:.1f}", *[""] * (len(placement.quiet) - 1)]
    exceeds_s = click.exceeds_at_s()
    return (
        _fingers(device, report),
        f"{1e3 * click.length_s:g} ms {100 * click.amplitude:.0f} %",
        _accelerations(report),
        _levels(report),
        "\n".join(sampled),
        "-" if exceeds_s is None else f"{1e3 * exceeds_s:.1f}",
        f"{100 * report.disagreement:.2f}",
    )


def _drives(report: DemoReport) -> Grid:
    number = len(report.drives)
    some = "" if number == report.drives_applied else f" ({number} of {report.drives_applied}, evenly over the run)"
    grid = _grid(
        f"steady drives{some}, promised/simulated: held until steady, standard fingers at their positions",
        ("fingers", "drive", "localized\nfactor", "at finger\nm/s²", "\ndB", "off\n%"),
        f"dB {report.device.threshold.above}",
    )
    for drive in report.drives:
        grid.add_row(
            _fingers(report.device, drive),
            _drive(drive),
            f"{drive.promised_factor:.3f}/{drive.simulated_factor:.3f}",
            _accelerations(drive),
            _levels(drive),
            f"{100 * drive.disagreement:.2f}",
        )
    return grid


def _felt_first(report: DriveReport | ClickReport) -> list[int]:
    return [*report.placement.felt, *report.placement.quiet]


def _fingers(device: Device, report: DriveReport | ClickReport) -> str:
    names, is_felt = finger_names(device, report.placement), report.placement.is_felt
    return "\n".join(f"{names[i]} {'felt' if is_felt[i] else 'quiet'}" for i in _felt_first(report))


def _accelerations(report: DriveReport | ClickReport) -> str:
    promised, simulated = report.promise.acceleration_m_per_s2, report.simulated.at_finger
    return "\n".join(f"{promised[i]:.2f}/{simulated[i]:.2f}" for i in _felt_first(report))


def _levels(report: DriveReport | ClickReport) -> str:
    return "\n".join(f"{report.promise.level_db[i]:.1f}" for i in _felt_first(report))


def _drive(report: DriveReport) -> str:
    """A drive in words, such as "151.2 Hz 3.6+100 %"."""
    percents = [100 * amplitude for amplitude in report.drive.amplitudes]
    parts = "+".join(f"{percent:.0f}" if percent >= 10 else f"{percent:.2g}" for percent in percents)
    row = f"\nrow: {report.drive.localized_factor:.3f} untouched" if isinstance(report.drive, BestRow) else ""
    return f"{report.frequency_text} {parts} %{row}"
