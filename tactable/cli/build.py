"""The commands `build` and `rollback`: a device's table made, made again whenever its description changes, put back."""

import json
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from engine.device import Device, DeviceError
from engine.table import Table, TableError
from engine.table.history import previous_of, roll_back
from precompute.entries.prediction import MadeFor
from precompute.measurements import CalibrationError
from tactable.progress import shown_progress
from tactable.shipped import find_device, find_device_file

LOOK_S = 0.5
"""A watched description is looked at this often."""
_out = Console()
_errors = Console(stderr=True)


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""

    @app.command("build")
    def build_command(
        device_name: Annotated[str, typer.Argument(metavar="DEVICE", help="A device file, or a shipped name.")],
        output: Annotated[Path | None, typer.Option("-o", "--output", help="The table; default NAME.nc here.")] = None,
        objective: Annotated[
            str, typer.Option(help="contrast, standard contrast, localized factor, fair share or paper.")
        ] = "contrast",
        made_for: Annotated[
            MadeFor,
            typer.Option(
                help="What level and contrast of an entry hold for: the mean, or all but the worst 5 % of the cases "
                "that calibration and fingers leave possible. That takes half as long again."
            ),
        ] = MadeFor.MEAN,
        clicks_up_to: Annotated[
            int | None,
            typer.Option(min=0, help="Clicks for states of so many fingers; default: all, or 3 beyond five zones."),
        ] = None,
        workers: Annotated[int | None, typer.Option(min=1, help="Processes for clicks; default: one a core.")] = None,
        reuse: Annotated[
            bool, typer.Option(help="Take over what the table that is there has and no change of the device affects.")
        ] = True,
        responses: Annotated[
            Path | None,
            typer.Option(metavar="FILE", help="Measured responses instead of the model's (tables/MEASUREMENTS.md)."),
        ] = None,
        sensor_mass: Annotated[str, typer.Option(help="Of the accelerometer, where that file has none.")] = "0 g",
        memory_mib: Annotated[int, typer.Option(min=1, help="Memory for the buffers of the sweep, in MiB.")] = 64,
        watch: Annotated[
            bool, typer.Option("--watch", help="Build again whenever the device file changes, until Ctrl-C.")
        ] = False,
        as_json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
    ) -> None:
        """Build the table of a device; an interrupted build goes on where its clicks were."""
        from tactable.cli.calibrate_options import read_option

        mass_kg = read_option("--sensor-mass", sensor_mass, "kg")
        job = BuildJob(
            output,
            objective,
            made_for,
            clicks_up_to,
            workers,
            reuse,
            responses,
            mass_kg,
            memory_mib,
            as_json,
        )
        if not watch:
            job.run(find_device(device_name))
            return
        with suppress(KeyboardInterrupt):
            watch_device(find_device_file(device_name), job.run)

    @app.command("rollback")
    def rollback_command(
        table_path: Annotated[Path, typer.Argument(metavar="TABLE", help="A table that was built in another's place.")],
        as_json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
    ) -> None:
        """Put the table back that was there before; once more is as it was. A run that plays it takes it at once."""
        previous = previous_of(table_path)
        if previous.is_file():
            Table.open(previous).close()  # verified before it takes a place
        roll_back(table_path)
        with Table.open(table_path) as table:
            summary = {"table": str(table_path), "created": table.attributes["created"], "device": table.device.name}
        if as_json:
            print(json.dumps(summary, indent=2))  # noqa: T201  # JSON goes out as it is, without a terminal's width
        else:
            _out.print(f"{table_path}: back to the table of {summary['created']}, for {summary['device']}")


@dataclass(frozen=True)
class BuildJob:
    """What the command was asked for, whatever the device."""

    output: Path | None
    objective: str
    made_for: MadeFor
    clicks_up_to: int | None
    workers: int | None
    reuse: bool
    responses: Path | None
    """Measured; None: the model's."""
    sensor_mass_kg: float
    memory_mib: int
    as_json: bool

    def run(self, device: Device) -> None:
        """Build and say what came of it. Raises TableError."""
        from precompute.builder.build import build_table
        from precompute.measurements.responses import read_responses
        from precompute.parallel.pool import available_cores

        path = self.output or Path(f"{device.name}.nc")
        measured = None if self.responses is None else read_responses(self.responses, device, self.sensor_mass_kg)
        with shown_progress(self.as_json) as progress:
            build_table(
                device,
                path,
                created=datetime.now(UTC).isoformat(timespec="seconds"),
                objective=self.objective,
                made_for=self.made_for,
                # Clicks are of the model in time: with measured responses only those that are asked for.
                clicks_up_to=0 if measured and self.clicks_up_to is None else self.clicks_up_to,
                workers=self.workers or available_cores(),
                reuse=self.reuse,
                responses=measured,
                memory_budget_bytes=self.memory_mib << 20,
                progress=progress,
            )
        self._tell(device, path)

    def _tell(self, device: Device, path: Path) -> None:
        from precompute.builder.measured_responses import interpolation_errors_of

        with Table.open(path, verify=False) as table:
            summary: dict[str, Any] = {
                "table": str(path),
                "device": device.name,
                "fingerprint": device.fingerprint,
                "entries": len(table.entries),
                "clicks": len(table.clicks),
                "bytes": path.stat().st_size,
                "source": str(table.attributes["source"]),
                **({} if self.responses is None else interpolation_errors_of(table)),
            }
        if self.as_json:
            print(json.dumps(summary, indent=2), flush=True)  # noqa: T201  # as above
            return
        counts = f"{summary['entries']} entries, {summary['clicks']} clicks"
        _out.print(f"{path}: {counts}, {path.stat().st_size / 1e6:.0f} MB, for {device.name}")
        _out.print(f"fingerprint {device.fingerprint[:16]}; {len(device.inferred)} values of the device are estimates")
        if self.responses is not None:
            _out.print(f"built from {summary['source']} in {self.responses}; {_doubts_text(summary)}", soft_wrap=True)


def _doubts_text(summary: Mapping[str, Any]) -> str:
    model, hz, places = (
        f"{100 * max(summary[key].values()):.2g} %"
        for key in ("model_disagreement", "between_frequencies_error", "between_places_error")
    )
    clicks = "there are no clicks" if summary["clicks"] == 0 else "clicks are the model's too"
    return (
        f"ESTIMATE: what fingers do and rise times are the model's, which is {model} off the measured responses; "
        f"{clicks}. Read between frequencies up to {hz} wrong, between places up to {places}"
    )


def watch_device(path: Path, build: Callable[[Device], None]) -> None:
    """Build whenever the description at `path` has changed; one that is wrong is told, and waited for its mending."""
    seen: bytes | None = None
    while True:
        try:
            found = path.read_bytes()
        except OSError:
            found = seen if seen is not None else b""  # an editor may take it away for a moment
        if found != seen:
            seen = found
            try:
                build(find_device(str(path)))
            except (CalibrationError, DeviceError, TableError) as error:
                _errors.print(f"tactable: {error}", style="red", markup=False, highlight=False, soft_wrap=True)
            _errors.print(f"{path}: waiting for a change; Ctrl-C ends", style="dim", markup=False, soft_wrap=True)
        time.sleep(LOOK_S)
