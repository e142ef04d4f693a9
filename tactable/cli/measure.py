"""Command `measure`: drive the surface along a guided walk of the sensor, and write what it does."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from base.points import point_text
from firmware_link import BIT_RATE_HZ
from tactable.cli import options
from tactable.cli.console import EXIT_DOUBTFUL, note, remark, say, show
from tactable.shipped import find_device

if TYPE_CHECKING:
    from engine.device import Device
    from tactable.measure.apparatus import Apparatus, ApparatusOptions
    from tactable.measure.faults import GravityCheck
    from tactable.measure.sensor import SensorForm
    from tactable.measure.stepped_sine import Reading, SteppedSineOptions
    from tactable.measure.walk import Stop, StopRecord

_MOST_FREQUENCIES = 10_000  # hours of readings: a slip in a step
PortName = Annotated[
    str,
    Option("--port", metavar="PORT", help="The board's port: serial, audio:NAME,... (docs/audio.md) or `simulated`."),
]
SensorPath = Annotated[
    str,
    Option(
        "--sensor",
        metavar="SENSOR",
        help="The board's own: board, or where it is fixed board:35mm, board:35x60mm. Sound card: audio:NAME,... "
        "(docs/audio.md). "
        "Pipe of samples (tables/MEASUREMENTS.md). Or `simulated`.",
    ),
]
FlawsText = Annotated[
    str, Option("--flaws", metavar="SPEC", help="What is wrong with the simulated sensor, as noise=0.05m/s^2,drift=40.")
]
MethodName = Annotated[
    str, Option("--method", help="stepped: one frequency after the other. sweep: all of a band at once, by loopback.")
]
Most = Annotated[str, Option(help="Greatest amplitude; the board is armed for no more.")]
Seed = Annotated[int, Option(min=0, help="Seed of the simulated sensor.")]


def measure(
    context: typer.Context,
    device_name: options.DeviceArgument,
    output: Annotated[list[Path], Option("-o", "--output", help="Complex responses: .csv or .uff. Repeat for more.")],
    sensor_path: SensorPath,
    port_name: PortName = "",
    peaks: Annotated[Path | None, Option("--peaks", help="Also write the magnitudes, as peaks: .csv.")] = None,
    transfer: Annotated[
        Path | None,
        Option("--transfer", help="Also write the device file with the transfer functions found: .toml, new."),
    ] = None,
    places: Annotated[
        int, Option(min=1, max=1000, help="Number of evenly spaced sensor positions; on a plate at most this many.")
    ] = 8,
    frequencies: Annotated[str, Option(help="Hz, between commas, or FROM:TO:STEP; default: 12 beside the mains.")] = "",
    method: MethodName = "stepped",
    planned: Annotated[int, Option(min=0, max=1000, help="Instead: this many readings of plan-measurements.")] = 0,
    least: Annotated[str, Option(help="Amplitude that the walk begins with.")] = "5 %",
    most: Most = "100 %",
    sensor_mass: options.SensorMass = "2 g",
    gravity: Annotated[bool, Option("--gravity", help="First check the sensor by turning it over.")] = False,
    flaws: FlawsText = "",
    change: options.Change = None,
    seed: Seed = 0,
    bit_rate_hz: options.BitRate = BIT_RATE_HZ,
    hammer: Annotated[
        str | None,
        Option(
            metavar="SPEC",
            help="Tap in place of driving, as at=25mm,taps=3,pause=4s: the place of what stays, the sensor or the "
            "reference, taps at each place, and the time for each.",
        ),
    ] = None,
    modes: Annotated[Path | None, Option(help="With --hammer: also write the modes with their shapes: .csv.")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Drive or tap a bar or plate and record its responses, for calibrate and build.

    At each place each actuator plays one frequency after the other, or glides through all of them (--method sweep),
    first at --least and louder only where noise or hum demands it. The samples are kept in the folder OUTPUT.raw, and
    the same command continues after an interruption. Exit status 3: some readings stayed spoiled. It has
    never been run on hardware.
    """
    from threadpoolctl import threadpool_limits

    from base.plain import to_plain
    from precompute.measurements.measurement_file import check_ending
    from tactable.audio.names import is_audio
    from tactable.measure.apparatus import ApparatusOptions, open_apparatus
    from tactable.measure.stepped_sine import SteppedSineOptions
    from tactable.measure.walk import Methods, RawFolder, even_walk, measure_walk, named_method, planned_walk

    device, mass_kg = find_device(device_name), options.read_option("--sensor-mass", sensor_mass, "kg")
    options.need_switch(context, "--hammer", hammer is not None, "modes")
    if hammer is not None:
        from tactable.cli.hammer import tap_surface

        if len(output) > 1 or port_name or peaks or transfer:
            raise options.OptionError(
                "--hammer drives nothing and writes one -o FILE; leave --port and other files out"
            )
        named = ApparatusOptions(sensor_path, sensor_path, 1.0, bit_rate_hz, mass_kg)
        bench = with_simulation(device, named, flaws, change, seed)
        tap_surface(device, output[0], modes, bench, places, hammer, read_grid(frequencies), as_json)
        return
    if not port_name:
        raise options.OptionError("--port is missing: give the board's port or `simulated`, or tap with --hammer")
    for path in [*output, *([peaks] if peaks else [])]:
        check_ending(path)
    if transfer is not None:
        if transfer.suffix != ".toml":
            raise options.OptionError(f"--transfer {transfer}: expected a device file, whose name ends in .toml")
        options.refuse_existing(transfer, "another name")
    stepped = SteppedSineOptions(options.read_option("--least", least, ""), read_most(device, most))
    how = named_method(options.read_choice("--method", method, Methods), stepped)
    walk = planned_walk(device, planned, mass_kg) if planned else even_walk(device, places, read_grid(frequencies))
    walk = at_fixed_place(device, sensor_path, walk)
    named = ApparatusOptions(port_name, sensor_path, stepped.most, bit_rate_hz, mass_kg)
    chosen = with_simulation(device, named, flaws, change, seed)
    if gravity and is_audio(sensor_path):
        raise options.OptionError(
            "--gravity: a sound card passes no direct current, so that gravity does not show; check the sensor by a "
            "vibration calibrator, or leave --gravity out"
        )
    chosen = replace(chosen, flaws=replace(chosen.flaws, has_gravity=gravity))
    checked = None
    # Unlimited BLAS is slower than one thread for windows of this size, and 100 times slower on a busy machine.
    with threadpool_limits(1, "blas"), open_apparatus(device, chosen, ask) as apparatus:
        form = apparatus.sensor.form
        settings = to_plain({"form": form, "method": how, "mass_kg": mass_kg, "flaws": chosen.flaws})
        raw = RawFolder(output[0].with_name(f"{output[0].name}.raw"), device, walk, settings | {"seed": seed})
        if gravity:
            checked = _check_gravity(device, apparatus, stepped)
        records = measure_walk(
            device, walk, apparatus, how, raw, lambda *at: None if as_json else tell_reading(device, *at)
        )
        losses = apparatus.losses
    write_records(device, form, records, mass_kg, output, peaks)
    summary = summary_of(device, records) | {"output": [str(path) for path in output], "raw": str(raw.path)}
    if transfer is not None:
        summary["transfer"] = write_transfers(transfer, device, form, records, mass_kg)
    summary["gravity"] = None if checked is None else {"gain": checked.gain, "offset": checked.offset_m_per_s2}
    summary["lost"] = None if losses is None else {"frames": losses.frames, "samples": losses.samples}
    show(summary, as_json, lambda *_: _print_summary(summary))
    if summary["spoiled"]:
        raise typer.Exit(EXIT_DOUBTFUL)


def with_simulation(
    device: "Device", named: "ApparatusOptions", flaws: str, change: list[str] | None, seed: int
) -> "ApparatusOptions":
    """The options with the flaws, the changes of the surface and the seed of a simulated bench. Raises OptionError."""
    from tactable.measure.simulated_bench import ConverterFlaws

    if named.is_simulated:
        remark(f"{device.name}, SIMULATED: firmware, {device.surface.kind} and sensor, in virtual time")
    elif flaws or change:
        raise options.OptionError("--flaws and --change belong to a simulated bench; leave them out")
    return replace(named, flaws=ConverterFlaws.parse(flaws), changes=options.read_changes(change, device), seed=seed)


def at_fixed_place(device: "Device", sensor: str, walk: "tuple[Stop, ...]") -> "tuple[Stop, ...]":
    """The walk; with an accelerometer that is fixed to the surface all its tones at that one place."""
    from tactable.measure.board_sensor import fixed_position_m
    from tactable.measure.walk import Stop

    position_m = fixed_position_m(sensor, device)
    if position_m is None:
        return walk
    return (Stop(position_m, tuple(sorted({tone for stop in walk for tone in stop.tones}))),)


def _check_gravity(device: "Device", apparatus: "Apparatus", stepped: "SteppedSineOptions") -> "GravityCheck":
    """Read the sensor lying level, and turned over."""
    from tactable.measure.faults import check_gravity
    from tactable.measure.stepped_sine import SteppedSine

    def mean() -> float:
        with apparatus.open_driven() as driven:
            return SteppedSine(device, driven, apparatus.sensor, stepped).listen().mean

    apparatus.guide(device.surface.corner_m / 2)
    level = mean()
    apparatus.turn_over()
    turned = mean()
    apparatus.turn_over()
    checked = check_gravity(level, turned)
    remark(f"gravity: gain {100 * checked.gain:+.2f} %, offset {checked.offset_m_per_s2:+.3f} m/s^2")
    for fault in checked.faults:
        note(fault.value)
    return checked


def write_records(
    device: "Device",
    form: "SensorForm",
    records: "tuple[StopRecord, ...]",
    mass_kg: float,
    output: list[Path],
    peaks: Path | None,
) -> None:
    """Write the responses, or without their phases the peaks, to every output."""
    from precompute.measurements.measurement_file import write_measurements
    from precompute.measurements.types import Kind
    from tactable.measure.walk import measurements_of

    has_phase = all(form.loopback(actuator.name) is not None for actuator in device.actuators)
    if not has_phase:
        note("not every actuator has a loopback channel: phases are not known, and peaks are written")
    kinds = [(path, Kind.RESPONSE if has_phase else Kind.PEAK) for path in output]
    comment = f"{'SIMULATED ' if form.is_simulated else ''}tactable measure {device.name}"
    for path, kind in [*kinds, *([(peaks, Kind.PEAK)] if peaks else [])]:
        found = measurements_of(records, device, mass_kg, kind, is_simulated=form.is_simulated)
        write_measurements(path, found, device, comment)


def write_transfers(
    path: Path, device: "Device", form: "SensorForm", records: "tuple[StopRecord, ...]", mass_kg: float
) -> dict[str, Any]:
    """Write the device file with the transfer functions that the responses show; what was found, by actuator.

    Raises CalibrationError where they show none.
    """
    from base.files import write_text
    from engine.device import Device
    from precompute.calibration.fitted import text_with_transfers
    from precompute.calibration.transfer_fit import find_transfers
    from precompute.measurements.types import Kind
    from tactable.measure.walk import measurements_of

    measurements = measurements_of(records, device, mass_kg, Kind.RESPONSE, is_simulated=form.is_simulated)
    found = find_transfers(device, measurements)
    text = text_with_transfers(device, [each.transfer for each in found])
    if form.is_simulated:
        text = f"# SIMULATED: the transfer functions come from a simulated bench\n{text}"
    Device.parse(text, str(path))  # points that no causal function reaches are refused before anything is written
    write_text(path, text)
    return {
        actuator.name: {
            "points": len(each.frequency_hz),
            "greatest_error": float(each.error.max()),
            "left_out_hz": each.left_out_hz.tolist(),
        }
        for actuator, each in zip(device.actuators, found, strict=True)
    }


def read_most(device: "Device", text: str) -> float:
    """The greatest amplitude, within the device's limit. Raises OptionError."""
    most = options.read_option("--most", text, "")
    limit = device.limits.amplitude
    if not 0 < most <= 1:
        raise options.OptionError(f"--most {text!r}: expected more than 0 and at most 100 %")
    return min(most, limit)


def read_grid(text: str) -> list[float] | None:
    """Frequencies in Hz of a text such as "70,110.5" or "60:300:1"; None for an empty one. Raises OptionError."""
    if not text:
        return None
    if ":" not in text:
        return options.read_numbers("--frequencies", text, "70,110.5")
    parts = options.read_numbers("--frequencies", text, "60:300:1", ":")
    if len(parts) != 3 or not parts[0] < parts[1] or not parts[2] > 0:
        raise options.OptionError(f"--frequencies {text!r}: expected FROM:TO:STEP in Hz, such as 60:300:1")
    first, last, step = parts
    steps = (last - first) / step
    if not steps < _MOST_FREQUENCIES:
        raise options.OptionError(
            f"--frequencies {text!r}: {steps:.3g} frequencies; expected at most {_MOST_FREQUENCIES}"
        )
    return [first + step * i for i in range(round(steps) + 1)]


def summary_of(device: "Device", records: "tuple[StopRecord, ...]") -> dict[str, Any]:
    """Counts, faults by name, and what is known of the converter."""
    from tactable.measure.faults import find_late

    readings = [reading for record in records for reading in record.readings]
    late = [record.latency_s for record in records if record.latency_s is not None]
    faults = [fault.name for reading in readings for fault in reading.faults]
    faults += [fault.name for fault in find_late(late)]
    repeated = [fault.name for reading in readings for fault in reading.earlier]
    return {
        "device": device.name,
        "places": len(records),
        "readings": len(readings),
        "spoiled": sum(reading.is_spoiled for reading in readings),
        "faults": {name: faults.count(name) for name in sorted(set(faults))},
        "repeated": {name: repeated.count(name) for name in sorted(set(repeated))},
        "seconds": sum(reading.seconds for reading in readings),
        "channels": {
            actuator.name: {"gain": each.gain, "delay_s": each.delay_s}
            for actuator, each in zip(device.actuators, records[0].channels, strict=False)
        },
        "drift_ppm": 1e6 * readings[-1].drift,
        "latency_s": [min(late), max(late)] if late else None,
        "noise_m_per_s2": max(record.rest.noise for record in records),
        "hum_m_per_s2": max(record.rest.hum for record in records),
        "greatest_error": max((reading.error for reading in readings if not reading.is_spoiled), default=None),
    }


def ask(text: str) -> None:
    """Tell a person what to do, and wait for Enter."""
    remark(text)
    input()


def tell_reading(device: "Device", stop: "Stop", reading: "Reading") -> None:
    """Print one reading with what spoiled it."""
    named = "".join(f"; {fault.name}" for fault in reading.faults)
    named += f"; repeated for {', '.join(fault.name for fault in reading.earlier)}" if reading.earlier else ""
    at = point_text(stop.position_m, 1, "f")
    say(
        f"{at:>9}  {device.actuators[reading.actuator].name} {reading.frequency_hz:g} Hz at "
        f"{100 * reading.amplitude:.3g} %: {abs(reading.acceleration):.3g} m/s^2, coherence {reading.coherence:.4f}, "
        f"error {100 * reading.error:.2g} %{named}"
    )


def _print_summary(summary: dict[str, Any]) -> None:
    from tactable.measure.faults import Fault

    say(
        f"{summary['device']}: {summary['readings']} readings at {summary['places']} places in "
        f"{summary['seconds']:.0f} s of driving, {summary['spoiled']} spoiled"
    )
    late = summary["latency_s"]
    latency = "not known" if late is None else f"{1e3 * late[0]:.1f} to {1e3 * late[1]:.1f} ms"
    say(
        f"converter: clock {summary['drift_ppm']:+.1f} ppm, latency {latency}; at rest noise "
        f"{summary['noise_m_per_s2']:.2g} m/s^2, hum {summary['hum_m_per_s2']:.2g} m/s^2"
    )
    first, *others = summary["channels"] or [""]
    for name in others:
        late_us, gain = 1e6 * summary["channels"][name]["delay_s"], summary["channels"][name]["gain"]
        say(
            f"channels, by their loopbacks: {name} plays {late_us:+.1f} us after {first}, with {gain:.4f} of its gain; "
            'both are in the responses, and calibrate --also "actuator[...].delay" fits them'
        )
    for name, count in summary["faults"].items():
        of = "" if Fault[name] is Fault.LATENCY else f"{count} readings: "
        say(f"{of}{Fault[name].value}")
    if summary["lost"] is not None and any(summary["lost"].values()):
        lost = summary["lost"]
        say(
            f"accelerometer: {lost['frames']} frames lost by the line, and {lost['samples']} samples by the board: "
            "take a faster line, or see to what keeps the board"
        )
    if summary["repeated"]:
        counts = ", ".join(f"{count} for {name}" for name, count in summary["repeated"].items())
        say(f"repeated readings: {counts}")
    for name, found in summary.get("transfer", {}).items():
        left_out = f", left out {len(found['left_out_hz'])} near resonances or of too few places"
        say(
            f"transfer function of {name}: {found['points']} points, standard error at most "
            f"{100 * found['greatest_error']:.2g} %{left_out if found['left_out_hz'] else ''}"
        )
    say(f"written: {', '.join(summary['output'])}; samples in {summary['raw']}")
