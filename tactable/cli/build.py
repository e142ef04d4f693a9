"""Commands `build` and `rollback`: make a table, remake it whenever its device changes, put the previous one back."""

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from engine.device import Device
from engine.plain import to_plain
from engine.table import Table
from engine.table.history import previous_of, roll_back
from firmware_link.protocol.errors import TactableError
from precompute.entries.prediction import MadeFor
from tactable.cli.console import print_error, print_json, remark, say, shown_progress
from tactable.cli.options import (
    AsJson,
    ClicksUpTo,
    DeviceArgument,
    Objective,
    SensorMass,
    TableArgument,
    Workers,
    read_option,
)
from tactable.shipped import find_device, find_device_file

if TYPE_CHECKING:
    from precompute.builder.cost import BuildCost

LOOK_S = 0.5
"""Time between two looks at a watched description."""


def build(
    device_name: DeviceArgument,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="The table; default NAME.nc here.")] = None,
    objective: Objective = "contrast",
    made_for: Annotated[
        MadeFor,
        typer.Option(
            help="What level and contrast of an entry hold for: the mean, or all but the worst 5 % of the cases "
            "that calibration and fingers leave possible. The latter takes half as long again."
        ),
    ] = MadeFor.MEAN,
    clicks_up_to: ClicksUpTo = None,
    workers: Workers = None,
    reuse: Annotated[
        bool, typer.Option(help="Take from the table that is there whatever the device's changes do not affect.")
    ] = True,
    responses: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Measured responses in place of the model's (tables/MEASUREMENTS.md)."),
    ] = None,
    sensor_mass: SensorMass = "0 g",
    memory_mib: Annotated[int, typer.Option(min=1, help="Memory for the buffers of the sweep, in MiB.")] = 64,
    watch: Annotated[
        bool, typer.Option("--watch", help="Build again whenever the device file changes, until Ctrl-C.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Build the table of a device; an interrupted build continues.

    A table that is there is replaced when the new one is whole; `tactable rollback` puts it back.
    """
    from precompute.builder.build import build_table
    from precompute.measurements.responses import read_responses
    from precompute.parallel.pool import available_cores

    mass_kg = read_option("--sensor-mass", sensor_mass, "kg")

    def build_device(device: Device) -> None:
        path = output or Path(f"{device.name}.nc")
        measured = None if responses is None else read_responses(responses, device, mass_kg)
        with shown_progress(as_json) as progress:
            cost = build_table(
                device,
                path,
                created=datetime.now(UTC).isoformat(timespec="seconds"),
                objective=objective,
                made_for=made_for,
                # Clicks are computed by the model in time: with measured responses only where they are asked for.
                clicks_up_to=0 if measured and clicks_up_to is None else clicks_up_to,
                workers=workers or available_cores(),
                reuse=reuse,
                responses=measured,
                memory_budget_bytes=memory_mib << 20,
                progress=progress,
            )
        _print_built(path, device, responses, cost, as_json)

    if not watch:
        build_device(find_device(device_name))
        return
    with suppress(KeyboardInterrupt):
        watch_device(find_device_file(device_name), build_device)


def rollback(table_path: TableArgument, as_json: AsJson = False) -> None:
    """Put the previous table back; a second rollback undoes the first.

    A run that plays the table changes over at once.
    """
    previous = previous_of(table_path)
    if previous.is_file():
        Table.open(previous).close()  # verified before it takes a place
    roll_back(table_path)
    with Table.open(table_path) as table:
        summary = {"table": str(table_path), "created": table.attributes["created"], "device": table.device.name}
    if as_json:
        print_json(summary)
    else:
        say(f"{table_path}: back to the table of {summary['created']}, for {summary['device']}")


def _print_built(path: Path, device: Device, responses: Path | None, cost: "BuildCost", as_json: bool) -> None:
    from precompute.builder.measured_responses import interpolation_errors_of
    from tactable.explain.words import model_figures, model_text

    with Table.open(path, verify=False) as table:
        summary: dict[str, Any] = {
            "table": str(path),
            "device": device.name,
            "fingerprint": device.fingerprint,
            "entries": len(table.entries),
            "clicks": len(table.clicks),
            "bytes": path.stat().st_size,
            "source": str(table.attributes["source"]),
            "processor_s": cost.processor_s,
            "solved": {"states": cost.states, "clicks": cost.clicks, **to_plain(cost.effort)},
            "estimates": len(device.estimated_values),
            "model": model_figures(table),
            **({} if responses is None else interpolation_errors_of(table)),
        }
        model = model_text(table)
    if as_json:
        print_json(summary)
        return
    counts = f"{summary['entries']} entries, {summary['clicks']} clicks"
    say(f"{path}: {counts}, {summary['bytes'] / 1e6:.0f} MB, for {device.name}")
    say(_cost_text(cost))
    say(f"fingerprint {device.fingerprint[:16]}; {len(device.estimated_values)} values of the device are estimates")
    say(model)
    if responses is not None:
        say(f"built from {summary['source']} in {responses}; {_doubts_text(summary)}")


def _cost_text(cost: "BuildCost") -> str:
    times = ", ".join(f"{step} {taken_s:.1f} s" for step, taken_s in cost.processor_s.items())
    effort = cost.effort
    solved = f"{cost.states} states; {cost.clicks} clicks from {effort.plants} plants, {effort.programs} programs"
    return f"processor time: {times}; solved {solved}, {effort.pivots} pivots, {effort.fallbacks} fallbacks"


def _doubts_text(summary: Mapping[str, Any]) -> str:
    model, hz, places = (
        f"{100 * max(summary[key].values()):.2g} %"
        for key in ("model_disagreement", "between_frequencies_error", "between_places_error")
    )
    clicks = "there are no clicks" if summary["clicks"] == 0 else "clicks are the model's too"
    return (
        f"ESTIMATE: the fingers' effect and rise times are the model's, which is {model} off the measured responses; "
        f"{clicks}. Interpolation errs by up to {hz} between frequencies and {places} between places"
    )


def watch_device(path: Path, build_device: Callable[[Device], None]) -> None:
    """Build at every change of the description at `path`, for ever; errors are printed, and the next change awaited."""
    seen: bytes | None = None
    while True:
        try:
            found = path.read_bytes()
        except OSError:
            found = seen if seen is not None else b""  # an editor may take it away for a moment
        if found != seen:
            seen = found
            try:
                build_device(find_device(str(path)))
            except TactableError as error:
                print_error(error)
            remark(f"{path}: waiting for a change; Ctrl-C ends", "dim")
        time.sleep(LOOK_S)
