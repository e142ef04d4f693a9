"""Commands around calibration: plan and simulate measurements, fit a device to them, apply the fit to a table."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from typer import Argument, Option

from base.files import write_text
from engine.table.history import previous_of
from firmware_link import BIT_RATE_HZ
from tactable.cli import measure, options
from tactable.cli.console import EXIT_DOUBTFUL, OUT, note, print_json, say, show, shown_progress
from tactable.shipped import find_device

if TYPE_CHECKING:
    from engine.device import Device
    from tactable.calibration.apply import Verify
    from tactable.calibration.job import CalibrationJob
    from tactable.measure.apparatus import ApparatusOptions
    from tactable.measure.verification import Circle

_MEASUREMENTS = "CSV or universal file (tables/MEASUREMENTS.md)"
AppliedTable = Annotated[
    Path | None,
    Option(
        metavar="TABLE",
        help="Then rebuild this table for the calibrated device and put it in place; a run that plays it changes over. "
        "The same command continues after an interruption.",
    ),
]


def calibrate(
    context: typer.Context,
    device_name: options.DeviceArgument,
    measurements_path: Annotated[Path, Argument(metavar="MEASUREMENTS", help=f"{_MEASUREMENTS}.")],
    output: Annotated[Path | None, Option("-o", "--output", help="A new folder; default NAME-calibrated here.")] = None,
    fit: options.Fit = None,
    also: options.Also = None,
    sensor_mass: Annotated[
        str,
        Option(
            "--sensor-mass",
            help="Mass of the accelerometer where the file states none; default: 0 g, and with --measure 2 g.",
        ),
    ] = "",
    starts: Annotated[int, Option(min=1, max=64, help="Points that the search starts from.")] = 5,
    seed: Annotated[int, Option(min=0, help="Seed of these points.")] = 0,
    accept: Annotated[str, Option(help="Greatest typical misfit; a fit above it is doubtful.")] = "5 %",
    strict: Annotated[bool, Option("--strict", help="A parameter not known within a factor of 2 is doubtful.")] = False,
    apply: AppliedTable = None,
    despite_doubts: Annotated[bool, Option("--despite-doubts", help="With --apply: apply a doubtful fit too.")] = False,
    clicks: Annotated[
        bool, Option(help="With --apply: remake the clicks once the rest is in place. Takes about a minute.")
    ] = True,
    measures: Annotated[
        bool,
        Option("--measure", help="First measure into MEASUREMENTS; with --apply verify the table before it counts."),
    ] = False,
    port_name: measure.PortName = "",
    sensor_path: measure.SensorPath = "",
    places: Annotated[int, Option(min=2, max=1000, help="With --measure: places of the sensor.")] = 8,
    method: measure.MethodName = "stepped",
    most: measure.Most = "100 %",
    flaws: measure.FlawsText = "",
    change: options.Change = None,
    bit_rate_hz: options.BitRate = BIT_RATE_HZ,
    modes: Annotated[bool, Option("--modes", help="MEASUREMENTS are natural frequencies and damping ratios.")] = False,
    pick_modes: Annotated[
        Path | None,
        Option(metavar="FILE", help="First pick the modes of the responses into this new CSV file; fit these."),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Fit a device to measured accelerations or modes, measured first if asked to.

    A new folder gets the new device file, the raw data and a report. Exit status 3: the result is doubtful, and a table
    to which it should be applied is left as it was. Readings of --measure that stay spoiled are told and left out.
    """
    from tactable.calibration.job import CalibrationJob

    device = find_device(device_name)
    of_measure = ("port_name", "sensor_path", "places", "method", "most", "flaws", "change", "bit_rate_hz")
    options.need_switch(context, "--measure", measures, *of_measure)
    options.need_switch(context, "--apply", apply is not None, "despite_doubts", "clicks")
    accepted = options.read_option("--accept", accept, "")
    mass_kg = options.read_option("--sensor-mass", sensor_mass or ("2 g" if measures else "0 g"), "kg")
    usual = None
    if modes or pick_modes:
        if measures:
            raise options.OptionError("--measure reads accelerations: fit modes in a second command, without it")
        measurements_path, usual = _modes(device, measurements_path, pick_modes, mass_kg)
    names, bounds = options.read_parameters(device, fit, also, usual)
    job = CalibrationJob(
        device=device,
        measurements=measurements_path,
        folder=output or Path(f"{device.name}-calibrated"),
        names=names,
        bounds=bounds,
        sensor_mass_kg=mass_kg,
        starts=starts,
        seed=seed,
        accepted_misfit=accepted,
        is_strict=strict,
        is_modes=usual is not None,
    )
    with ExitStack() as stack:
        circle = None
        if measures:
            named = _apparatus(device, apply, port_name, sensor_path, measure.read_most(device, most), bit_rate_hz)
            named = replace(named, sensor_mass_kg=job.sensor_mass_kg)
            bench = measure.with_simulation(device, named, flaws, change, seed)
            circle = stack.enter_context(_at_the_bar(device, bench, places, method))
            spoiled, readings = circle.measure(
                measurements_path, lambda *at: None if as_json else measure.tell_reading(device, *at)
            )
            if spoiled:
                note(f"{spoiled} of {readings} readings stayed spoiled and are left out of {measurements_path}")
        if apply is None:
            doubts = _fit(job, as_json)
        else:
            doubts = _apply(job, apply, despite_doubts, clicks, as_json, None if circle is None else circle.verify)
    if doubts:
        raise typer.Exit(EXIT_DOUBTFUL)


def _modes(device: "Device", path: Path, picked: Path | None, mass_kg: float) -> tuple[Path, tuple[str, ...]]:
    """The file of modes, which is written first where they are `picked` from responses, and the usual parameters."""
    from precompute.calibration.modal_fit import modal_names
    from precompute.measurements.measured_modes import read_modes
    from precompute.measurements.measurement_file import read_measurements
    from precompute.measurements.pick import pick_modes, write_modes

    if picked is not None:
        options.refuse_existing(picked)
        responses = read_measurements(path, device, mass_kg)
        write_text(picked, write_modes(pick_modes(responses, str(path)), responses, str(path)))
        path = picked
    return path, modal_names(device, read_modes(path, device, mass_kg))


def _apparatus(
    device: "Device", table: Path | None, port: str, sensor: str, most: float, bit_rate_hz: int
) -> "ApparatusOptions":
    """The apparatus, with the clicks of the table that will be verified. Raises OptionError, TableError."""
    from engine.table import Table
    from tactable.calibration.apply import TableTarget
    from tactable.measure.apparatus import ApparatusOptions

    if not port or not sensor:
        raise options.OptionError("--measure needs --port and --sensor, each a name or `simulated`")
    basis = None
    if table is not None:
        TableTarget(table, device)  # one that cannot be rebuilt is refused before anybody walks along the bar
        with Table.open(table, verify=False) as opened:
            basis = opened.clicks.basis if opened.clicks else None
    return ApparatusOptions(port, sensor, most, bit_rate_hz, clicks=basis)


@contextmanager
def _at_the_bar(device: "Device", named: "ApparatusOptions", places: int, method: str) -> Iterator["Circle"]:
    """The circle of a calibration, its apparatus open."""
    from tactable.measure.apparatus import open_apparatus
    from tactable.measure.stepped_sine import SteppedSineOptions
    from tactable.measure.verification import Circle
    from tactable.measure.walk import Methods, even_walk, named_method

    with open_apparatus(device, named, measure.ask) as apparatus:
        how = named_method(options.read_choice("--method", method, Methods), SteppedSineOptions(most=named.most))
        yield Circle(device, apparatus, named, even_walk(device, places), how)


def _fit(job: "CalibrationJob", as_json: bool) -> list[str]:
    """Fit, write the folder, and print the report; the doubts."""
    from tactable.calibration.job import calibration_json, print_calibration

    fitted = job.fit(lambda _step, _fraction: None)
    job.write(fitted)
    doubts = job.doubts_of(fitted.report)
    document = calibration_json(job, fitted.report, doubts)
    show(document, as_json, lambda out, _: print_calibration(out, fitted.report, str(job.folder), doubts))
    return doubts


def _apply(
    job: "CalibrationJob", table: Path, despite_doubts: bool, with_clicks: bool, as_json: bool, verify: "Verify | None"
) -> list[str]:
    """Apply the calibration to a table, and print it; the doubts for which the table was left as it was."""
    from tactable.calibration.apply import PromiseError, apply_fit
    from tactable.calibration.job import calibration_json, print_applied, print_calibration, print_clicks
    from tactable.explain.diff_words import print_short_diff, short_diff_json

    with shown_progress(as_json) as progress:
        applied = apply_fit(job, table, despite_doubts, progress, verify)
    document = calibration_json(job, applied.report, applied.doubts) | {"applied": {"table": str(table)}}
    if not as_json:
        print_calibration(OUT, applied.report, str(job.folder), applied.doubts)
        print_applied(OUT, table, applied)
    if not applied.is_refused:
        target, diff = applied.target, applied.target.diff()
        is_complete, clicks_s = target.is_complete(applied.device), None
        if diff is not None and not as_json:
            print_short_diff(OUT, diff)
            say(f"complete comparison: tactable diff {previous_of(table)} {table}")
        if with_clicks and not is_complete:
            with shown_progress(as_json) as progress:
                try:
                    clicks_s = target.complete(applied.device, progress, verify)
                except PromiseError as refused:
                    doubt = f"clicks: {refused}; the table has the clicks of one finger, and a run solves the others"
                    applied.doubts.append(doubt)
        if applied.doubts and not as_json and not despite_doubts:
            say(f"DOUBTFUL: {applied.doubts[-1]}")
        if not as_json:
            print_clicks(OUT, table, is_complete, clicks_s)
        document["applied"] |= {
            "in_place_after_s": applied.in_place_after_s,
            "seconds": applied.seconds,
            "clicks_s": clicks_s,
            "has_all_clicks": is_complete or clicks_s is not None,
            "diff": None if diff is None else short_diff_json(diff),
        }
    if as_json:
        print_json(document)
    return applied.doubts if not despite_doubts else []


def plan_measurements(
    device_name: options.DeviceArgument,
    measurements_path: Annotated[
        Path | None, Argument(metavar="[MEASUREMENTS]", help=f"Measurements so far: {_MEASUREMENTS}.")
    ] = None,
    count: Annotated[int, Option(min=1, max=1000, help="Readings to propose.")] = 10,
    fit: options.Fit = None,
    also: options.Also = None,
    sensor_mass: options.SensorMass = "0 g",
    noise: Annotated[str, Option(help="Relative standard deviation of a reading, without measurements.")] = "2 %",
    floor: Annotated[str, Option(help="Noise of the sensor at rest.")] = "0.05 m/s^2",
    place: Annotated[str, Option(help="Standard deviation of the sensor's position.")] = "0.5 mm",
    as_json: options.AsJson = False,
) -> None:
    """Propose the readings that tell most.

    A reading is a frequency for each actuator and a point of the surface; the proposed ones reduce the uncertainty of
    the parameters most.
    """
    from threadpoolctl import threadpool_limits

    from precompute.calibration.calibrate import calibrate as fit_device
    from precompute.calibration.calibrate import names_told
    from precompute.calibration.measuring_plan import Accuracy, plan_after, plan_first
    from precompute.measurements.measurement_file import read_measurements
    from tactable.calibration.job import print_plan

    device = find_device(device_name)
    accuracy = Accuracy(
        relative=options.read_option("--noise", noise, ""),
        floor_m_per_s2=options.read_option("--floor", floor, "m/s^2"),
        place_m=options.read_option("--place", place, "m"),
    )
    mass_kg = options.read_option("--sensor-mass", sensor_mass, "kg")
    names, bounds = options.read_parameters(device, fit, also)
    with threadpool_limits(1, "blas"):
        if measurements_path is None:
            plan = plan_first(device, names, bounds, mass_kg, accuracy, count)
        else:
            measurements = read_measurements(measurements_path, device, mass_kg)
            told = names_told(measurements, names)
            plan = plan_after(fit_device(device, measurements, told, bounds=bounds), accuracy, count)
    show(plan.summary(), as_json, print_plan)


def simulate_measurements(
    device_name: options.DeviceArgument,
    output: Annotated[Path, Option("-o", "--output", help="A new CSV file.")],
    drives: options.Frequencies = "150,130;150,200;150,230",
    points: Annotated[int, Option(min=1, max=1000, help="Evenly spaced points; on a plate at most this many.")] = 22,
    change: options.Change = None,
    noise: Annotated[str, Option(help="Relative standard deviation of a reading.")] = "1 %",
    wrong: Annotated[str, Option(help="Share of readings that are wrong by a factor of 3.")] = "0 %",
    sensor_mass: options.SensorMass = "2 g",
    seed: Annotated[int, Option(min=0, help="Seed of the noise.")] = 0,
) -> None:
    """Write measurements, SIMULATED.

    They are what a device would give, to try a calibration or to plan one; the file says that it is simulated.
    """
    from precompute.measurements.csv import write_csv
    from precompute.measurements.model import Flaws, even_places
    from precompute.measurements.model import simulate_measurements as simulate
    from precompute.measurements.parameters import with_changes
    from precompute.measurements.types import lay_out

    device = find_device(device_name)
    flaws = Flaws(options.read_option("--noise", noise, ""), options.read_option("--wrong", wrong, ""))
    mass_kg = options.read_option("--sensor-mass", sensor_mass, "kg")
    layout = lay_out(np.array(options.read_drives(drives, device)), even_places(device, points), mass_kg)
    measured = simulate(with_changes(device, options.read_changes(change, device)), layout, flaws, seed)
    what = "; ".join([device.name, *(change or []), f"noise {noise}", f"wrong {wrong}", f"seed {seed}"])
    text = write_csv(measured, device, f"SIMULATED by tactable simulate-measurements: {what}")
    options.refuse_existing(output)
    write_text(output, text)
    say(f"{output}: {len(measured)} readings, SIMULATED")
