"""The commands around calibration: measured accelerations to a new device file, and what to measure next."""

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from tactable.shipped import find_device

EXIT_DOUBTFUL = 3

_out = Console()

DeviceName = Annotated[str, typer.Argument(metavar="DEVICE", help="A device file, or a shipped name.")]
Fit = Annotated[
    list[str] | None,
    typer.Option("--fit", metavar="NAME[=LOW..HIGH]", help="Fit this, and no other that is not named. Repeat."),
]
Also = Annotated[
    list[str] | None,
    typer.Option("--also", metavar="NAME[=LOW..HIGH]", help="Fit this besides the usual ones, or bound one. Repeat."),
]
SensorMass = Annotated[str, typer.Option("--sensor-mass", help="Of the accelerometer, where the file has none.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    app.command("calibrate")(calibrate)
    app.command("plan-measurements")(plan_measurements)
    app.command("simulate-measurements")(simulate_measurements)


def calibrate(
    device_name: DeviceName,
    measurements_path: Annotated[
        Path, typer.Argument(metavar="MEASUREMENTS", help="CSV, NetCDF or universal file (tables/MEASUREMENTS.md).")
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="A new folder; default NAME-calibrated here.")
    ] = None,
    fit: Fit = None,
    also: Also = None,
    loss: Annotated[str, typer.Option(help="robust, squares, or l1 as the paper's equation (12).")] = "robust",
    sensor_mass: SensorMass = "0 g",
    starts: Annotated[int, typer.Option(min=1, max=64, help="Places to start from.")] = 5,
    seed: Annotated[int, typer.Option(min=0, help="Of the places to start from.")] = 0,
    accept: Annotated[str, typer.Option(help="A greater typical misfit is exit status 3.")] = "20 %",
    strict: Annotated[bool, typer.Option("--strict", help="So is a parameter not known within a factor of 2.")] = False,
    compare: Annotated[
        bool | None,
        typer.Option(help="Fit the paper's way too: every drive alone, then the average; default: not with --apply."),
    ] = None,
    apply: Annotated[
        Path | None,
        typer.Option(
            metavar="TABLE",
            help="Then build this table anew for the bar that was found and put it in place; a run that plays it "
            "changes over. Asked again after an interruption, it goes on where it was.",
        ),
    ] = None,
    despite_doubts: Annotated[
        bool, typer.Option("--despite-doubts", help="Apply what is doubtful too; without, that leaves the table.")
    ] = False,
    clicks: Annotated[
        bool, typer.Option(help="With --apply: make the clicks anew too, once the rest is in place. Some minutes.")
    ] = True,
    as_json: AsJson = False,
) -> None:
    """Fit a device to measured accelerations; a new folder gets the new device file, the raw data and a report."""
    from precompute.calibration.misfit import Loss
    from tactable.calibration.job import CalibrationJob, calibration_json
    from tactable.calibration.page import print_calibration
    from tactable.cli.calibrate_options import read_choice, read_option, read_parameters

    device = find_device(device_name)
    accepted, chosen = read_option("--accept", accept, ""), read_choice("--loss", loss, Loss)
    names, bounds = read_parameters(device, fit, also)
    job = CalibrationJob(
        device=device,
        measurements=measurements_path,
        folder=output or Path(f"{device.name}-calibrated"),
        names=names,
        bounds=bounds,
        loss=chosen,
        sensor_mass_kg=read_option("--sensor-mass", sensor_mass, "kg"),
        starts=starts,
        seed=seed,
        compares=apply is None if compare is None else compare,
    )

    def doubts_of(report: dict[str, Any]) -> list[str]:
        return _doubts(report, accepted, strict)

    if apply is not None:
        from tactable.calibration.apply import ApplyOptions, apply_calibration

        doubts = apply_calibration(_out, job, doubts_of, ApplyOptions(apply, despite_doubts, clicks, as_json))
    else:
        fitted = job.fit(lambda _step, _fraction: None)
        job.write(fitted)
        report, doubts = fitted.report, doubts_of(fitted.report)
        if as_json:
            _print_json(calibration_json(job, report, doubts))
        else:
            print_calibration(_out, report, str(job.folder), doubts)
    if doubts:
        raise typer.Exit(EXIT_DOUBTFUL)


def _doubts(report: dict[str, Any], accepted: float, strict: bool) -> list[str]:
    """Why the result should not be used unseen."""
    doubts = []
    if report["median_misfit"] > accepted:
        doubts.append(f"the typical misfit, {100 * report['median_misfit']:.3g} %, is above {100 * accepted:g} %")
    if strict:
        unsure = [p["name"] for p in report["parameters"] if p["known"] != "known"]
        doubts += [f"{name} is not known within a factor of 2" for name in unsure]
    return doubts


def plan_measurements(
    device_name: DeviceName,
    measurements_path: Annotated[
        Path | None, typer.Argument(metavar="[MEASUREMENTS]", help="What has been measured; none: nothing yet.")
    ] = None,
    count: Annotated[int, typer.Option(min=1, max=1000, help="Readings to propose.")] = 10,
    criterion: Annotated[
        str, typer.Option(help="D: least volume of what is possible; A: least sum of the variances.")
    ] = "D",
    fit: Fit = None,
    also: Also = None,
    sensor_mass: SensorMass = "0 g",
    noise: Annotated[str, typer.Option(help="Of a reading, relative; where nothing is measured.")] = "2 %",
    floor: Annotated[str, typer.Option(help="Of the sensor at rest.")] = "0.05 m/s^2",
    place: Annotated[str, typer.Option(help="How well the sensor is placed.")] = "0.5 mm",
    as_json: AsJson = False,
) -> None:
    """Propose the readings, frequencies and points, that shrink the uncertainty of the parameters most."""
    from threadpoolctl import threadpool_limits

    from precompute.calibration.calibrate import calibrate as fit_device
    from precompute.calibration.plan import Accuracy, Criterion, plan_after, plan_first
    from precompute.measurements import read_measurements
    from tactable.calibration.page import print_plan
    from tactable.cli.calibrate_options import read_choice, read_option, read_parameters

    device = find_device(device_name)
    accuracy = Accuracy(
        relative=read_option("--noise", noise, ""),
        floor_m_per_s2=read_option("--floor", floor, "m/s^2"),
        place_m=read_option("--place", place, "m"),
    )
    chosen, mass_kg = read_choice("--criterion", criterion, Criterion), read_option("--sensor-mass", sensor_mass, "kg")
    names, bounds = read_parameters(device, fit, also)
    with threadpool_limits(1, "blas"):
        if measurements_path is None:
            plan = plan_first(device, names, bounds, mass_kg, accuracy, count, chosen)
        else:
            measurements = read_measurements(measurements_path, device, mass_kg)
            plan = plan_after(fit_device(device, measurements, names, bounds=bounds), accuracy, count, chosen)
    if as_json:
        _print_json(plan.summary())
    else:
        print_plan(_out, plan.summary())


def simulate_measurements(
    device_name: DeviceName,
    output: Annotated[Path, typer.Option("-o", "--output", help="A new CSV file.")],
    drives: Annotated[
        str, typer.Option(help="Frequencies of the actuators in Hz, drives parted by ;, - for still.")
    ] = "150,130;150,200;150,230",
    points: Annotated[int, typer.Option(min=1, max=1000, help="Even places along the bar.")] = 22,
    change: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="What is different from the device. Repeat.")
    ] = None,
    noise: Annotated[str, typer.Option(help="Relative standard deviation of a reading.")] = "1 %",
    wrong: Annotated[str, typer.Option(help="Share of readings that are wrong by 3, up or down.")] = "0 %",
    sensor_mass: SensorMass = "2 g",
    seed: Annotated[int, typer.Option(min=0, help="Of the noise.")] = 0,
) -> None:
    """Write what measurements of a device would look like, marked SIMULATED: to try a calibration, and to plan one."""
    from precompute.measurements import CalibrationError, lay_out
    from precompute.measurements.csv import write_csv
    from precompute.measurements.parameters import with_changes
    from precompute.measurements.simulate import Flaws, even_places, simulate_measurements
    from tactable.cli.calibrate_options import read_changes, read_drives, read_option

    device = find_device(device_name)
    changes = read_changes(change or [], device)
    flaws = Flaws(read_option("--noise", noise, ""), read_option("--wrong", wrong, ""))
    mass_kg = read_option("--sensor-mass", sensor_mass, "kg")
    layout = lay_out(np.array(read_drives(drives, device)), even_places(device, points), mass_kg)
    measured = simulate_measurements(with_changes(device, changes), layout, flaws, seed)
    what = "; ".join([device.name, *(change or []), f"noise {noise}", f"wrong {wrong}", f"seed {seed}"])
    text = write_csv(measured, device, f"SIMULATED by tactable simulate-measurements: {what}")
    try:
        with output.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise CalibrationError(f"{output}: exists already and is not overwritten; choose another output") from None
    _out.print(f"{output}: {len(measured)} readings, SIMULATED", markup=False, highlight=False, soft_wrap=True)


def _print_json(value: object) -> None:
    print(json.dumps(value, indent=2))  # noqa: T201  # JSON goes out as it is, without a terminal's width
