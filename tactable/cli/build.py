"""Commands `build`, `rollback` and `fleet`: make the table of a device, put the previous one back, make many."""

import json
from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table as Grid
from rich.text import Text
from typer import Argument, Option

from engine.device import Device
from engine.table import Table
from engine.table.history import previous_of, roll_back
from tactable.cli import options
from tactable.cli.console import EXIT_DOUBTFUL, OUT, print_json, remark, say, show, shown_progress
from tactable.kernel_cache import compile_steady_solver
from tactable.shipped import find_device

if TYPE_CHECKING:
    from precompute.builder.table_build import BuildCost
    from precompute.fleet.summary import Summary
    from precompute.fleet.verdict import Limits

_MANY_CLICKS = 5000  # half a minute
_SHOWN = 20  # a screen's worth; the summary file has all


def build(
    context: typer.Context,
    device_name: options.DeviceArgument,
    output: Annotated[Path | None, Option("-o", "--output", help="The table; default NAME.nc here.")] = None,
    clicks_up_to: options.ClicksUpTo = None,
    pitch: options.Pitch = None,
    threshold: options.ThresholdCurve = None,
    workers: options.Workers = None,
    reuse: Annotated[bool, Option(help="Take from the table that is there what the changes do not affect.")] = True,
    responses: Annotated[
        Path | None, Option(metavar="FILE", help="Measured responses in place of the model's (tables/MEASUREMENTS.md).")
    ] = None,
    force_of_actuators: Annotated[
        bool,
        Option(
            "--force-of-actuators",
            help="FILE is per newton, of forces where the actuators are: scale it by each one's force at full scale.",
        ),
    ] = False,
    sensor_mass: options.SensorMass = "0 g",
    as_json: options.AsJson = False,
) -> None:
    """Build the table of a device.

    A table that is there is replaced when the new one is whole; `tactable rollback` puts it back. Where it has no
    clicks of this device, a table with those of one finger comes first, after seconds: a run may play it at once, and
    solves the others.
    """
    from precompute.builder.table_build import EARLY_IN_PLACE, build_table
    from precompute.clicks import ClickOptions
    from precompute.measurements.response_table import read_responses
    from precompute.parallel.pool import available_cores

    options.need_switch(context, "--responses", responses is not None, "sensor_mass", "force_of_actuators")
    device = options.with_threshold(find_device(device_name), threshold)
    path, pitch_m = output or Path(f"{device.name}.nc"), options.read_pitch(pitch)
    mass_kg, measured = options.read_option("--sensor-mass", sensor_mass, "kg"), None
    if responses is not None:
        measured = read_responses(responses, device, mass_kg, scales_forces=force_of_actuators)
    # Clicks are computed by the model in time: with measured responses only where they are asked for.
    fingers = clicks_up_to if clicks_up_to is not None else 0 if measured else None
    expected = [] if as_json else [f"{path}: {_expected_text(device, fingers, pitch_m)}"]
    with shown_progress(as_json) as show:

        def progress(step: str, fraction: float) -> None:
            show(step, fraction)
            if fraction and expected:  # nothing refuses the build any more
                remark(expected.pop())
            if step == EARLY_IN_PLACE and not as_json:
                remark(f"{path}: usable, with the clicks of one finger; those of two follow")

        cost = build_table(
            device,
            path,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            clicks_up_to=fingers,
            click_options=ClickOptions(pitch_m=pitch_m),
            early=True,
            workers=workers or available_cores(),
            reuse=reuse,
            responses=measured,
            progress=progress,
        )
    compile_steady_solver(remark)  # for the run that follows
    _print_built(path, device, responses, cost, as_json)


def _expected_text(device: Device, fingers: int | None, pitch_m: float | None) -> str:
    """What a build takes, where nothing of an earlier table can be reused."""
    from precompute.builder.table_build import expected_s, size_text, table_bytes
    from precompute.clicks import ClickOptions
    from precompute.clicks.tabulated import most_tabulated, tabulated_keys

    places = ClickOptions(pitch_m=pitch_m).places(device.surface.corner_m)
    clicks = len(tabulated_keys(places, most_tabulated(places) if fingers is None else fingers))
    takes = f"{clicks} clicks and a sweep of {size_text(table_bytes(device))}"
    coarser = f"; with --pitch {2e3 * places.pitch_m:.2g}mm clicks are fewer" if clicks > _MANY_CLICKS else ""
    return f"{takes}, ESTIMATE {expected_s(device, clicks):.0f} s of processor time{coarser}"


def rollback(table_path: options.TableArgument, as_json: options.AsJson = False) -> None:
    """Put the previous table back; a second rollback undoes the first.

    A run that plays the table changes over at once.
    """
    previous = previous_of(table_path)
    if previous.is_file():
        Table.open(previous).close()  # verified before it takes a place
    roll_back(table_path)
    with Table.open(table_path) as table:
        summary = {"table": str(table_path), "created": table.attributes["created"], "device": table.device.name}
    told = f"{table_path}: back to the table of {summary['created']}, for {summary['device']}"
    show(summary, as_json, lambda *_: say(told))


def _print_built(path: Path, device: Device, responses: Path | None, cost: "BuildCost", as_json: bool) -> None:
    from precompute.builder.measured_responses import interpolation_errors_of
    from tactable.explain.words import model_figures, model_text

    with Table.open(path, verify=False) as table:
        summary: dict[str, Any] = {
            "table": str(path),
            "device": device.name,
            "fingerprint": device.fingerprint,
            "best_rows": len(table.best_rows),
            "clicks": len(table.clicks),
            "click_pitch_m": table.places.pitch_m,
            "bytes": path.stat().st_size,
            "source": str(table.attributes["source"]),
            "modelled": str(table.attributes.get("modelled", "")),
            "processor_s": cost.processor_s,
            "clicks_solved": cost.clicks,
            "estimates": len(device.estimated_values),
            "model": model_figures(table),
            **({} if responses is None else interpolation_errors_of(table)),
        }
        model = model_text(table)
    if as_json:
        print_json(summary)
        return
    apart = f" at places {1e3 * summary['click_pitch_m']:.3g} mm apart" if summary["clicks"] else ""
    counts = f"best rows of {summary['best_rows']} zone combinations, {summary['clicks']} clicks{apart}"
    say(f"{path}: {counts}, {summary['bytes'] / 1e6:.0f} MB, for {device.name}")
    times = ", ".join(f"{step} {taken_s:.1f} s" for step, taken_s in cost.processor_s.items())
    say(f"processor time: {times}; {cost.clicks} clicks solved")
    say(f"fingerprint {device.fingerprint[:16]}; {len(device.estimated_values)} values of the device are estimates")
    say(model)
    if responses is not None:
        say(f"built from {summary['source']} in {responses}; {_doubts_text(summary)}")


def _doubts_text(summary: Mapping[str, Any]) -> str:
    model, hz, places = (
        f"{100 * max(summary[key].values()):.2g} %"
        for key in ("model_disagreement", "between_frequencies_error", "between_places_error")
    )
    clicks = "there are no clicks" if summary["clicks"] == 0 else "clicks are the model's too"
    force = " Levels rest on the full scale of the device file." if "full scale" in summary["modelled"] else ""
    return (
        f"ESTIMATE: the fingers' effect and rise times are the model's, which is {model} off the measured responses; "
        f"{clicks}.{force} Interpolation errs by up to {hz} between frequencies and {places} between places"
    )


def fleet(
    source: Annotated[Path, Argument(metavar="DIR|MANIFEST", help="Folders, or a .csv (docs/fleet.md).")],
    output: Annotated[Path, Option("-o", "--output", help="Folder of the results; complete ones are kept.")],
    scheduler: Annotated[str | None, Option(metavar="ADDRESS", help="A Dask scheduler, as tcp://host:8786.")] = None,
    workers: Annotated[
        int | None, Option(min=1, help="Processes of this machine; default: one unit after another in this one.")
    ] = None,
    clicks_up_to: options.ClicksUpTo = None,
    pitch: options.Pitch = None,
    fit: options.Fit = None,
    also: options.Also = None,
    sensor_mass: options.SensorMass = "0 g",
    as_json: options.AsJson = False,
) -> None:
    """Calibrate, build and verify many devices; an interrupted run continues.

    Each measured unit gets a verdict (PASS, RETEST or REJECT) and a page, report.md. Exit status 3: one failed or did
    not pass.
    """
    from precompute.fleet.fleet_run import run_fleet, run_here, run_on_processes, run_on_scheduler
    from precompute.fleet.summary import summarise, summary_json
    from precompute.fleet.units import FleetOptions, plan_fleet
    from precompute.fleet.verdict import read_limits

    if scheduler is not None and workers is not None:
        raise options.OptionError("--workers and --scheduler: give one of them; a scheduler has its own workers")
    fleet_options = FleetOptions(
        clicks_up_to=clicks_up_to,
        pitch_m=options.read_pitch(pitch),
        parameters=tuple(fit) if fit else None,
        also=tuple(also or ()),
        sensor_mass_kg=options.read_option("--sensor-mass", sensor_mass, "kg"),
    )
    units, limits = plan_fleet(source), read_limits(source)
    if output.exists() and source.is_dir() and output.resolve() == source.resolve():
        raise options.OptionError(
            f"--output {output}: is the folder of the units; choose another folder for the results"
        )
    output.mkdir(parents=True, exist_ok=True)
    for path in _summary_paths(output):
        path.unlink(missing_ok=True)  # a summary means that the run was completed
    pool = run_on_scheduler(scheduler) if scheduler else run_on_processes(workers) if workers else run_here
    created = datetime.now(UTC).isoformat(timespec="seconds")
    with shown_progress(as_json) as progress:
        outcomes = run_fleet(units, fleet_options, output, pool, created=created, progress=progress)
    summary = summarise(units, outcomes, limits)
    _write_summary(summary, output, limits)
    show(summary_json(summary), as_json, lambda *_: print_fleet(summary, _summary_paths(output)[0]))
    if not summary.is_passed:
        raise typer.Exit(EXIT_DOUBTFUL)


def _summary_paths(output: Path) -> tuple[Path, Path]:
    return output / "summary.csv", output / "summary.json"


def _write_summary(summary: "Summary", output: Path, limits: "Limits") -> None:
    """Write the page of each measured unit, and last the summary."""
    from base.files import write_text
    from precompute.fleet.summary import REPORT, summary_csv, summary_json, unit_report

    judged = [outcome for outcome in summary.outcomes if outcome.name in summary.verdicts]
    texts = {output / each.name / REPORT: unit_report(each, summary, limits) for each in judged}
    of_lot = (summary_csv(summary), json.dumps(summary_json(summary), indent=1))
    texts |= zip(_summary_paths(output), of_lot, strict=True)
    for path, text in texts.items():
        path.parent.mkdir(exist_ok=True)  # of a unit that failed there may be none
        write_text(path, text)


def print_fleet(summary: "Summary", path: Path) -> None:
    """Print what became of the units and why, what varies and who stands out; `path` has the complete summary."""
    from precompute.fleet.summary import OUTLYING, status_of
    from precompute.fleet.verdict import FEWEST

    counts = Counter(status_of(outcome) for outcome in summary.outcomes)
    parts = (f"{counts['built']} built", f"{counts['kept']} complete already", f"{counts['failed']} failed")
    say(f"{len(summary.outcomes)} units: {', '.join(parts)}")
    for outcome in summary.failed:
        say(f"FAILED {outcome.name}: {outcome.error}")
    _print_verdicts(summary)
    if summary.columns:
        drifts = ["drift"] if any(column.drift is not None for column in summary.columns) else []
        grid = Grid("what varies", "median", "spread", *drifts, "least", "greatest")
        for column in summary.columns:
            if column.name.startswith("uncertainty."):
                continue
            ends = ((column.least, column.least_unit), (column.greatest, column.greatest_unit))
            cells = (Text(f"{value:.5g} ({unit})") for value, unit in ends)
            drift = ["" if column.drift is None else f"{column.drift:+.2g}"] if drifts else []
            grid.add_row(Text(column.name), f"{column.median:.5g}", f"{column.spread:.2g}", *drift, *cells)
        OUT.print(grid)
    rejected = [name for name, each in summary.verdicts.items() if each.judgement.value == "REJECT"]
    medians = {column.name: column.median for column in summary.columns}
    lines = [
        f"stands out {outlier.unit}: {outlier.column} is {outlier.value:.5g}, "
        f"where the others' median is {medians[outlier.column]:.5g}"
        for outlier in summary.outliers
        if outlier.unit not in rejected
    ]
    for line in lines[:_SHOWN]:
        say(line)
    if len(lines) > _SHOWN:
        say(f"  and {len(lines) - _SHOWN} more")
    if not summary.outliers:
        say(f"no unit stands out by more than {OUTLYING} spreads; of fewer than {FEWEST} none ever does")
    say(f"complete summary: {path}")


def _print_verdicts(summary: "Summary") -> None:
    """Print who did not pass and why, and the figures of the line."""
    measured = sum(summary.counts.values())
    if not measured:
        return
    for name, verdict in summary.verdicts.items():
        if verdict.reasons and name not in {outcome.name for outcome in summary.failed}:
            first, *rest = verdict.reasons
            more = f" (and {len(rest)} more in its report)" if rest else ""
            say(f"{verdict.judgement.value} {name}: {first}{more}")
    counts = ", ".join(f"{count} {word}" for word, count in summary.counts.items())
    takt = "" if summary.takt_s is None else f"; {summary.takt_s:.3g} s a bar on this machine"
    say(f"{counts}: {100 * summary.counts['PASS'] / measured:.0f} % passed{takt}")
