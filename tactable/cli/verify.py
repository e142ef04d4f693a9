"""Command `verify`: play what a table holds, and compare what a sensor reads with what the table promises."""

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from base.points import json_of, point_of_json, point_text
from firmware_link import BIT_RATE_HZ
from tactable.cli import options
from tactable.cli.console import EXIT_DOUBTFUL, OUT, note, say, show
from tactable.cli.measure import FlawsText, PortName, Seed, SensorPath, ask, with_simulation

if TYPE_CHECKING:
    from engine.table import Table
    from tactable.figures.picture_file import Outputs
    from tactable.measure.verification import Point


_FIGURES = ("read", "promised", "low", "high", "error")
_VERDICTS = {
    "kept": "the {0} keeps the promise",
    "broken": "the {0} does not keep the promise",
    "in part": "too few readings show whether the {0} keeps the promise; those that do, say so",
    "not shown": "no reading shows whether the {0} keeps the promise",
}
_REMEDIES = {
    "broken": "measure the {0} and calibrate: it, the sensor or its scale is not what the table was made for",
    "in part": "see to the faults, take a quieter sensor, or play louder by --level",
}
_REMEDIES["not shown"] = _REMEDIES["in part"]


def verify(
    table_path: options.TableArgument,
    port_name: PortName,
    sensor_path: SensorPath,
    places: Annotated[
        int, Option(min=1, max=100, help="Number of evenly spaced sensor positions; on a plate at most this many.")
    ] = 4,
    placements: Annotated[int, Option(min=1, max=100, help="Random placements of two fingers.")] = 5,
    level: options.Level = "20",
    drives: options.DrivesOf = None,
    sensor_mass: options.SensorMass = "2 g",
    output: options.PictureOutputs = None,
    flaws: FlawsText = "",
    change: options.Change = None,
    seed: Seed = 0,
    bit_rate_hz: options.BitRate = BIT_RATE_HZ,
    as_json: options.AsJson = False,
) -> None:
    """Play drives and clicks of a table, and compare a sensor with the promise.

    Steady drives and clicks of random placements, or with --drives zones the rows of the sweep for their zones, are
    played on the untouched surface, and read point by point. Of a table that has clicks of one finger alone, as of a
    plate, these are played. The promise is an interval over the surfaces that the
    table holds for possible, and only a reading that could have shown it broken keeps it. Exit status 3: more than a
    tenth of the points are beyond it, or more than a tenth of the readings stayed spoiled or are too noisy to show it.
    It has never been run on hardware.
    """
    from threadpoolctl import threadpool_limits

    from engine.table import Table
    from precompute.measurements.model import even_places
    from precompute.sampling.placements import Anywhere, random_placements
    from tactable.figures.picture_file import outputs_of
    from tactable.measure.apparatus import ApparatusOptions, open_apparatus
    from tactable.measure.board_sensor import fixed_places
    from tactable.measure.verification import plan_played, verify_table

    outputs = outputs_of(output or [])
    mass_kg, level_db = options.read_option("--sensor-mass", sensor_mass, "kg"), options.read_level(level)
    with Table.open(table_path) as table, threadpool_limits(1, "blas"):
        device = table.device
        most, basis = device.limits.amplitude, table.clicks.basis if table.clicks else None
        named = ApparatusOptions(port_name, sensor_path, most, bit_rate_hz, mass_kg, clicks=basis)
        chosen = with_simulation(device, named, flaws, change, seed)
        asked = random_placements(device, Anywhere(placements=placements, seed=seed + 1))
        played = plan_played(table, asked, level_db, options.read_drives_of(drives))
        with open_apparatus(device, chosen, ask) as apparatus:
            where = fixed_places(device, sensor_path, even_places(device, places).tolist())
            points = verify_table(table, played, where, apparatus, mass_kg)
            is_simulated = apparatus.sensor.form.is_simulated
    summary = summary_of(table, points, is_simulated)
    if outputs.paths:
        _draw(summary, outputs)
    show(summary, as_json, lambda *_: _print(summary))
    if summary["verdict"] != "kept":
        raise typer.Exit(EXIT_DOUBTFUL)


def summary_of(table: "Table", points: "tuple[Point, ...]", is_simulated: bool) -> dict[str, Any]:
    """Every point, how many have each outcome, and the verdict."""
    from tactable.measure.verification import Judgement

    judgement, faults = Judgement.of(points), [fault.name for point in points for fault in point.faults]
    return {
        "table": str(table.path),
        "device": table.device.name,
        "surface": table.device.surface.kind,
        "simulated": is_simulated,
        **asdict(judgement),
        "verdict": judgement.verdict.value,
        "judgement": str(judgement),
        "faults": {name: faults.count(name) for name in sorted(set(faults))},
        "points": [
            {
                "kind": point.played.kind,
                "finger_m": [*map(json_of, point.played.placement.position_m)],
                "is_felt": list(point.played.placement.is_felt),
                "position_m": json_of(point.position_m),
                **{f"{key}_m_per_s2": getattr(point, f"{key}_m_per_s2") for key in _FIGURES},
                "difference_db": 20 * math.log10(max(point.read_m_per_s2, 1e-300) / point.promised_m_per_s2),
                "outcome": point.outcome.value,
                "faults": [fault.name for fault in point.faults],
            }
            for point in points
        ],
    }


def _print(summary: dict[str, Any]) -> None:
    from rich.table import Table as Grid

    from precompute.calibration.calibration_report import place_text
    from tactable.measure.faults import Fault

    grid = Grid("played", "sensor", "read", "promised", "interval", "")
    for point in summary["points"]:
        points = map(point_of_json, point["finger_m"])
        fingers = ", ".join(point_text(at_m, 0, "f").removesuffix(" mm") for at_m in points)
        grid.add_row(
            f"{point['kind']} for {fingers} mm",
            place_text(point["position_m"]),
            f"{point['read_m_per_s2']:.3g} ± {point['error_m_per_s2']:.2g} m/s^2",
            f"{point['promised_m_per_s2']:.3g}",
            f"{point['low_m_per_s2']:.3g} to {point['high_m_per_s2']:.3g}",
            ", ".join([point["outcome"]] * (point["outcome"] != "kept") + point["faults"]),
        )
    OUT.print(grid)
    marked = " SIMULATED" if summary["simulated"] else ""
    verdict = _VERDICTS[summary["verdict"]].format(summary["surface"])
    say(f"{summary['device']}{marked}: {summary['judgement']}: {verdict}")
    for name, count in summary["faults"].items():
        say(f"{count} readings: {Fault[name].value}")
    if summary["verdict"] in _REMEDIES:
        note(_REMEDIES[summary["verdict"]].format(summary["surface"]))


def _draw(summary: dict[str, Any], outputs: "Outputs") -> None:
    from tactable.figures.calibration import plot_verification
    from tactable.figures.picture_file import write_outputs

    marked = " SIMULATED" if summary["simulated"] else ""
    shown = [point for point in summary["points"] if point["read_m_per_s2"] > 0]
    picture = plot_verification(f"{summary['device']}{marked}: {summary['judgement']}", shown)
    write_outputs(picture, outputs)
