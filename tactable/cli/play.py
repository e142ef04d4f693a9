"""Command `play`: hold one drive by hand, each actuator with its frequency, amplitude and phase."""

import math
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from base.plain import to_plain
from base.points import point_of_json, point_text
from firmware_link import BIT_RATE_HZ
from tactable.cli.console import OUT, note, remark, show
from tactable.cli.options import AsJson, BitRate, DeviceArgument, OptionError, PortName, read_option
from tactable.shipped import find_device

if TYPE_CHECKING:
    from engine.device import Device
    from tactable.measure.driven_device import AskedDrive

_STEP_NS = 100_000_000  # a signal is noticed within it; the link renews its lease by itself
_NS_PER_S = 1_000_000_000
_POINTS = 11  # each tenth of a bar, or nine of a plate: a row of text each
_EACH = "One value for all actuators, or one for each, between commas"


def play(
    device_name: DeviceArgument,
    port_name: PortName,
    frequency: Annotated[str, Option(help=f"{_EACH}, such as 150 or 150,130 Hz; - for a still actuator.")],
    amplitude: Annotated[str, Option(help=f"Of full scale. {_EACH}, such as '20 %' or '20 %,5 %'.")],
    phase: Annotated[str, Option(help=f"{_EACH}, such as 0deg,90deg or 1.57rad.")] = "0deg",
    seconds: Annotated[str, Option("--for", metavar="TIME", help="End after this time, such as 2s.")] = "",
    bit_rate_hz: BitRate = BIT_RATE_HZ,
    as_json: AsJson = False,
) -> None:
    """Hold one drive by hand: a frequency, amplitude and phase for each actuator.

    It ends with Ctrl-C or after `--for`, and stays within the limits of the device. The board is armed for this
    amplitude and no more, and falls silent when the command ends. With an emulated firmware the levels of the
    untouched surface follow, SIMULATED. It has never been run on hardware.
    """
    from engine.loop.loop import SystemClock
    from tactable.audio.port import open_port
    from tactable.digitizers.record import stop_at_signal
    from tactable.measure.driven_device import DrivenDevice, check_drive

    device = find_device(device_name)
    asked = read_asked_drive(device, frequency, amplitude, phase)
    drive = check_drive(asked, device)
    duration_s = read_option("--for", seconds, "s") if seconds else math.inf
    clock, played_s = SystemClock(), 0.0
    with (
        stop_at_signal() as stop,
        open_port(port_name, bit_rate_hz) as port,
        DrivenDevice(device, port, clock, [max(asked.amplitudes)] * len(device.actuators), port.bit_rate_hz) as driven,
    ):
        simulated = ", SIMULATED firmware" if driven.is_simulated else ""
        remark(f"{_drive_text(device, asked)} to {port.path}{simulated}; Ctrl-C ends")
        for text in (*port.notes, *driven.fit.notes):
            note(text)
        start_ns = clock.now_ns()
        driven.play(drive)
        while not stop.is_set() and played_s < duration_s:
            left_ns = (duration_s - played_s) * _NS_PER_S
            driven.wait(clock.now_ns() + math.ceil(min(_STEP_NS, left_ns)))
            played_s = (clock.now_ns() - start_ns) / _NS_PER_S
        is_simulated = driven.is_simulated
    show(_summary(device, asked, played_s, is_simulated), as_json, lambda _, summary: _print_summary(device, summary))


def read_asked_drive(device: "Device", frequency: str, amplitude: str, phase: str) -> "AskedDrive":
    """The drive of --frequency, --amplitude and --phase. Raises OptionError where one of them cannot be read."""
    from tactable.measure.driven_device import AskedDrive

    frequencies = _each(device, "--frequency", frequency)
    is_still = [text == "-" for text in frequencies]
    frequencies_hz = [
        0.0 if still else _read_frequency(text) for text, still in zip(frequencies, is_still, strict=True)
    ]
    amplitudes = [read_option("--amplitude", text, "") for text in _each(device, "--amplitude", amplitude)]
    amplitudes = [0.0 if still else value for value, still in zip(amplitudes, is_still, strict=True)]
    if not any(amplitudes):
        raise OptionError("--amplitude: no actuator moves; give at least one frequency and an amplitude above 0 %")
    phases_rad = [_read_angle(text) for text in _each(device, "--phase", phase)]
    return AskedDrive(tuple(frequencies_hz), tuple(amplitudes), tuple(phases_rad))


def _each(device: "Device", option: str, text: str) -> list[str]:
    """The text of each actuator."""
    parts, count = [part.strip() for part in text.split(",")], len(device.actuators)
    if len(parts) == 1:
        return parts * count
    if len(parts) != count:
        names = ",".join(actuator.name for actuator in device.actuators)
        raise OptionError(f"{option} {text!r}: expected one value for all, or one for each of {names}")
    return parts


def _read_frequency(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return read_option("--frequency", text, "Hz")


def _read_angle(text: str) -> float:
    from engine.device.quantity import QuantityError, read_angle_rad

    try:
        return read_angle_rad(text)
    except QuantityError as error:
        raise OptionError(f"--phase: {error}") from None


def _drive_text(device: "Device", asked: "AskedDrive") -> str:
    channels = zip(device.actuators, asked.frequencies_hz, asked.amplitudes, asked.phases_rad, strict=True)
    return ", ".join(
        f"{actuator.name} {hz:g} Hz {100 * amplitude:g} % {math.degrees(phase_rad):g} deg"
        if amplitude
        else f"{actuator.name} still"
        for actuator, hz, amplitude, phase_rad in channels
    )


def _summary(device: "Device", asked: "AskedDrive", played_s: float, is_simulated: bool) -> dict[str, Any]:
    summary: dict[str, Any] = {
        "device": device.name,
        "frequencies_hz": list(asked.frequencies_hz),
        "amplitudes": list(asked.amplitudes),
        "phases_rad": list(asked.phases_rad),
        "duration_s": played_s,
        "simulated_firmware": is_simulated,
        "simulated_bar": None,
    }
    if is_simulated:
        from base.arrays import Field
        from tactable.measure.driven_device import simulate_levels

        position_m = Field.of(device.surface.corner_m, _POINTS).position_m
        peak_m_per_s2, level_db = simulate_levels(device, asked, position_m)
        summary["simulated_bar"] = {
            "position_m": to_plain(position_m),
            "peak_m_per_s2": peak_m_per_s2.tolist(),
            "level_db": level_db.tolist(),
            "threshold": device.threshold.title,
        }
    return summary


def _print_summary(device: "Device", summary: dict[str, Any]) -> None:
    OUT.print(f"{device.name}: played for {summary['duration_s']:.1f} s, then silent", highlight=False)
    bar = summary["simulated_bar"]
    if bar is None:
        return
    from rich.table import Table as Grid

    title = f"SIMULATED, untouched {device.surface.kind}, steady"
    grid = Grid("place", "peak", f"level {device.threshold.above}", title=title, title_justify="left")
    for at, peak, level_db in zip(bar["position_m"], bar["peak_m_per_s2"], bar["level_db"], strict=True):
        grid.add_row(point_text(point_of_json(at), 4), f"{peak:.3g} m/s^2", f"{level_db:.1f} dB")
    OUT.print(grid)
