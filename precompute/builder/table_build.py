"""Building a table: responses, modes, sweeps, best rows and clicks of a device, written whole or not at all.

A build writes a new file beside its target and takes over the parts of the earlier table that are still right
(builder.incremental). It solves the others, verifies the file, and only then puts it in the earlier table's place, so
that an engine never opens half a table. Memory is bounded, whatever the grid of the sweep.

Clicks of two fingers take longest, a minute for the thousands of placements at places 3 mm apart. A build may therefore
first put a table with the clicks of one finger in place (`early`), which is playable after seconds: a run solves the
others as fingers ask for them. Then it replaces that table, and a running engine adopts it.

The size of a table, and memory and time of its build, are estimated from the device file before anything is computed.
The sweep of a pair of actuators grows with the square of the number of frequencies and of amplitudes, so a file of a
few lines can ask for a petabyte. A build that cannot end is refused before it begins.
"""

import json
import math
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from threadpoolctl import threadpool_limits

from base.files import written_path
from engine.device import Device
from engine.device.values import restated
from engine.table import ClickEntry, Table, TableError
from engine.table.best_rows import write_best_rows
from engine.table.clicks import Clicks
from engine.table.columns import write_clicks, write_modes
from engine.table.netcdf_file import TableWriter
from engine.touch.placement import Places
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.builder.incremental import BuildOptions, Part, input_fingerprint
from precompute.builder.measured_responses import source_attributes, write_measured
from precompute.clicks import DEFAULT_OPTIONS, ClickOptions
from precompute.clicks.click_basis import lines_for
from precompute.clicks.click_plants import count_modes
from precompute.clicks.tabulated import most_tabulated, tabulate_clicks, tabulated_keys
from precompute.measurements.response_table import MeasuredResponses, measured_plant
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.plant import Plant
from precompute.parallel.pool import remembered_interrupt
from precompute.sampling.steady_modes import steady_basis, steady_modes
from precompute.sweep.best import BestRowSearch
from precompute.sweep.grid import compute_grid_response, zone_points
from precompute.sweep.sweep_kernels import fold_amplitudes
from precompute.sweep.tabulate import write_coherent_sweep, write_pair_sweep, write_responses

MEMORY_BUDGET_BYTES = 64 << 20  # default bound on the buffers of the sweep, whatever its grid
EARLY_IN_PLACE = "early table"  # the step that is told when the table with the clicks of one finger is in place
Progress = Callable[[str, float], None]  # called with what is being done and the fraction done
STEPS = ("responses", "sweep", "clicks")
_FIGURES, _SINGLE, _DOUBLE, _COMPLEX = 3, 4, 8, 16  # figures of a sweep; bytes of a number
_COPIES = 3  # responses are held as solved, by zone, and split into two parts while they are written
_CLICK_S, _PLATE_CLICK_S = 2.3e-3, 4.3e-3
"""Processor time of a click for each actuator: 5.1, 5.2 and 6.3 ms on reference-a, -d and -t, 17 ms on reference-p."""
_SWEPT_BYTES_PER_S = 120e6  # reference-a and -t
_UNITS = ("bytes", "kB", "MB", "GB", "TB", "PB", "EB")


def no_progress(step: str, fraction: float) -> None:
    """Reports nothing."""


@dataclass
class BuildCost:
    """processor_s: by step; a step whose result was taken over takes none. clicks: how many were solved now."""

    processor_s: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STEPS, 0.0))
    clicks: int = 0

    @contextmanager
    def measured(self, step: str) -> Iterator[None]:
        """Add the processor time of this process to a step, and that of the processes that end meanwhile."""
        start_s = _processor_s()
        try:
            yield
        finally:
            self.processor_s[step] += _processor_s() - start_s


def build_table(
    device: Device,
    path: Path | str,
    *,
    created: str | None = None,
    clicks_up_to: int | None = None,
    click_options: ClickOptions = DEFAULT_OPTIONS,
    early: bool = False,
    in_the_end: int | None = None,
    workers: int = 1,
    reuse: bool = True,
    completes: bool = False,
    responses: MeasuredResponses | None = None,
    memory_budget_bytes: int = MEMORY_BUDGET_BYTES,
    progress: Progress = no_progress,
    accept: Callable[[Path], None] = lambda _: None,
) -> BuildCost:
    """Compute, write and verify the table of `device`; only then it takes the place of what was at `path`.

    `created` is the date to note, by default now. `clicks_up_to`: the most fingers that have clicks, at all places of
    the options' pitch: 0, 1 or on a bar 2; more fingers are solved when they come. None: as many as there can be.
    `early`: where no clicks of this device are there yet, a table with those of one finger comes first. `in_the_end`:
    the most fingers of the table that is to follow, which this one notes so that whoever continues knows; None:
    `clicks_up_to`. Clicks are solved by `workers` processes. With `reuse`, parts of a table at `path` are taken over if
    this code made them from inputs that have not changed. The table that was at `path` is kept as the previous one; a
    build that `completes` it keeps the one before. With `responses` the bar moves as it was measured, while the effect
    of fingers, rise times and clicks remain the model's. `accept` gets the complete file before it takes its place, and
    refuses it by an exception. Returns what it took.

    Raises TableError if the table cannot be written or disk or memory have no room for it, and for an unknown number of
    fingers; DeviceError for a device that was changed in what its text, which a table holds, cannot state;
    WorkerError where a worker process was killed.

    >>> cost = build_table(Device.read("my-bar.toml"), "my-bar.nc", clicks_up_to=0)
    """
    path, device = written_path(Path(path)), restated(device)
    sha256 = "" if responses is None else responses.sha256
    click_options = click_options.on(device.surface.corner_m)
    most = most_tabulated(click_options.places(device.surface.corner_m))
    clicks_up_to = most if clicks_up_to is None else clicks_up_to
    options = BuildOptions(code_fingerprint(), clicks_up_to, click_options, sha256)
    if not 0 <= clicks_up_to <= most:
        kind = device.surface.kind
        raise TableError(
            f"clicks of up to {clicks_up_to} fingers: the table of a {kind} holds those of up to {most}; others are "
            "solved when they come"
        )
    check_size(device, path)
    with threadpool_limits(1, "blas"), remembered_interrupt() as check:  # unpinned BLAS: 100 times slower when busy
        checked = _checked(progress, check)
        builder = _Builder(
            device,
            path,
            options,
            workers,
            clicks_up_to if in_the_end is None else in_the_end,
            completes,
            responses,
            memory_budget_bytes,
            checked,
            accept,
        )
        builder.build_steps(created or datetime.now(UTC).isoformat(timespec="seconds"), early, reuse)
    progress("done", 1.0)
    return builder.cost


def _checked(progress: Progress, check: Callable[[], None]) -> Progress:
    def checked(step: str, fraction: float) -> None:
        check()
        progress(step, fraction)

    return checked


def _model_attributes(plant: Plant, options: BuildOptions) -> dict[str, int | float]:
    """Mesh and modes, which follow from the band, as attributes of the table."""
    found = plant.resolution | {"modes": len(compute_basis(plant).square_omega)}
    if options.clicks_up_to:
        found["click_modes"] = count_modes(plant.device, lines_for(plant.device, options.click_options.length_s))
    return found


@contextmanager
def _earlier(path: Path, reuse: bool) -> Iterator[Table | None]:
    """The table at `path`, if it is sound and of this code."""
    try:
        table = Table.open(path, code_fingerprint=code_fingerprint()) if reuse else None
    except TableError:
        table = None
    with table or nullcontext():
        yield table


@dataclass(frozen=True)
class _Builder:
    """One build: the parts of a table, computed or taken over from an earlier one."""

    device: Device
    path: Path
    options: BuildOptions
    workers: int
    in_the_end: int
    completes: bool
    responses: MeasuredResponses | None
    memory_budget_bytes: int
    progress: Progress
    accept: Callable[[Path], None]
    cost: BuildCost = field(default_factory=BuildCost)

    def build_steps(self, created: str, early: bool, reuse: bool) -> None:
        """The table with the clicks of one finger where it is wanted, and then the table that is wanted."""
        builder = self
        if early and self.options.clicks_up_to > 1:
            with _earlier(self.path, reuse) as earlier:
                first = replace(self, options=replace(self.options, clicks_up_to=1))
                if earlier is None or not any(each.has_current_clicks(earlier) for each in (self, first)):
                    first.build(created, earlier)
                    builder, reuse = replace(self, completes=True), True
                    self.progress(EARLY_IN_PLACE, 0.3)
        with _earlier(self.path, reuse) as earlier:
            builder.build(created, earlier)

    def has_current_clicks(self, table: Table) -> bool:
        """Whether a table has the clicks that this build would solve."""
        made = input_fingerprint(Part.CLICKS, self.device, self.options)
        return table.attributes.get(Part.CLICKS.attribute) == made

    def build(self, created: str, earlier: Table | None) -> None:
        """One table, written and put in place."""
        device, options, progress = self.device, self.options, self.progress
        inputs = {part: input_fingerprint(part, device, options) for part in Part}
        known = {part for part in Part if earlier and earlier.attributes.get(part.attribute) == inputs[part]}
        wanted = set(Part) if options.clicks_up_to else {Part.RESPONSES}
        progress("responses", 0.0)
        with self.cost.measured("responses"):
            plant = assemble(device) if self.responses is None else measured_plant(device, self.responses)
        with TableWriter(self.path, self._check, completes=self.completes) as writer:
            writer.describe(
                {
                    "title": f"tactable table of {device.name}",
                    "Conventions": "CF-1.10",
                    "device_name": device.name,
                    "device_description": device.text,
                    "device_fingerprint": device.fingerprint,
                    "code_fingerprint": options.code_fingerprint,
                    "code_version": metadata.version("tactable"),
                    "created": created,
                    "threshold": device.threshold.title,
                    "spread": device.spread_text,
                    "clicks_up_to": self.in_the_end,
                    "click_options": json.dumps(asdict(options.click_options)),
                    **self._click_attributes(),
                    **_model_attributes(plant, options),
                    **source_attributes(self.responses),
                    **{part.attribute: inputs[part] for part in wanted | known},
                }
            )
            if earlier is not None:
                for part in sorted(known & wanted):
                    if earlier.copy_groups(writer, part.groups):
                        progress(f"{part} as before", 0.05)
            if Part.RESPONSES not in known:
                self._write_responses(writer, plant)
            if Part.CLICKS in wanted - known:
                with self.cost.measured("clicks"):
                    write_clicks(writer, Clicks.of(self._places, self._solve_clicks()), device)
            progress("verify", 0.96)

    def _check(self, written: Path) -> None:
        Table.open(written, device=self.device, code_fingerprint=self.options.code_fingerprint, verify=False).close()
        self.accept(written)
        self.progress("put in place", 0.99)

    def _write_responses(self, writer: TableWriter, plant: Plant) -> None:
        with self.cost.measured("responses"):
            grid = compute_grid_response(plant, self.device.sweep.frequency_hz, zone_points(self.device))
            write_responses(writer, plant, grid)
            write_modes(writer, steady_modes(steady_basis(plant)), self.device)
            if self.responses is not None:
                write_measured(writer, self.device, self.responses)
        with self.cost.measured("sweep"):
            best, kept = BestRowSearch(self.device), writer if self.device.sweep.is_stored else None
            self.progress("coherent sweep", 0.05)
            write_coherent_sweep(kept, grid, best)
            for fraction in write_pair_sweep(kept, grid, best, self.memory_budget_bytes):
                self.progress("sweep", 0.05 + 0.15 * fraction)
            if rows := best.best_rows():
                write_best_rows(writer, rows, self.device)

    @property
    def _places(self) -> Places:
        return self.options.click_options.places(self.device.surface.corner_m)

    def _click_attributes(self) -> dict[str, int | float]:
        places = self._places
        tolerance_m = self.options.click_options.at(places, self.device.spread).tolerance_m
        assert tolerance_m is not None  # `at` gives it
        return {"click_pitch_m": places.pitch_m, "click_tolerance_m": tolerance_m}

    def _solve_clicks(self) -> list[ClickEntry]:
        """Every click, in the order of the keys."""
        device, options, places = self.device, self.options.click_options, self._places
        keys = tabulated_keys(places, self.options.clicks_up_to)
        found = list[ClickEntry]()
        for click in tabulate_clicks(device, options, places, keys, self.workers):
            found.append(click)
            self.progress("clicks", 0.3 + 0.65 * len(found) / len(keys))
        self.cost.clicks += len(found)
        return sorted(found, key=lambda click: places.key(click.placement))


def _processor_s() -> float:
    """Processor time of this process and of all its children that have ended, their start and imports included."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


def table_bytes(device: Device) -> int:
    """Bytes of the sweeps and responses of a table; clicks and modes add some MB."""
    rows = _pairs(device) * (_pair_values(device) + _coherent_values(device)) if device.sweep.is_stored else 0
    return _FIGURES * _SINGLE * rows + _responses(device)


def memory_bytes(device: Device) -> int:
    """Bytes that a build holds at once, beside the buffers of the pair sweep, which have a budget of their own."""
    row = _FIGURES * _SINGLE * _pair_values(device) // max(1, len(device.sweep.frequency_hz))
    return max(_FIGURES * _DOUBLE * _coherent_values(device), row) + _COPIES * _responses(device)


def expected_s(device: Device, clicks: int) -> float:
    """Processor time in s that a build with `clicks` clicks takes once its kernels are compiled. ESTIMATE."""
    of_click_s = _PLATE_CLICK_S if device.surface.corner_m.imag else _CLICK_S
    return clicks * len(device.actuators) * of_click_s + table_bytes(device) / _SWEPT_BYTES_PER_S


def check_size(device: Device, path: Path) -> None:
    """Raise TableError for a table that neither the disk of `path` nor the memory of this machine has room for."""
    remedy = "make the sweep coarser (sweep.step, sweep.amplitude_steps, sweep.phase_steps), or drop it (sweep.store)"
    folder = path.absolute().parent
    disk = shutil.disk_usage(folder) if folder.is_dir() else None
    wanted, free = table_bytes(device), math.inf if disk is None or not disk.total else disk.free  # 0: it does not say
    if wanted > free:
        raise TableError(
            f"{path}: a table of {device.name} takes {size_text(wanted)}, and {size_text(free)} are free there: "
            f"{remedy}, make room or choose another output"
        )
    wanted, there = memory_bytes(device), os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if wanted > there:
        raise TableError(
            f"{path}: building a table of {device.name} takes {size_text(wanted)} of memory, and this machine has "
            f"{size_text(there)}: {remedy}"
        )


def _pairs(device: Device) -> int:
    return math.comb(len(device.actuators), 2)


def _pair_values(device: Device) -> int:
    """Values of one figure of one pair over (frequency_1, amplitude_1, amplitude_2, zone, frequency_2)."""
    if len(device.actuators) < 2:
        return 0
    return len(device.sweep.frequency_hz) ** 2 * (device.sweep.amplitude_steps + 1) ** 2 * len(device.zones)


def _coherent_values(device: Device) -> int:
    """Values of one figure of one pair over (frequency, zone, ratio, phase)."""
    if len(device.actuators) < 2:
        return 0
    ratios = len(fold_amplitudes(device.sweep.amplitude_steps).first)
    return len(device.sweep.frequency_hz) * len(device.zones) * ratios * device.sweep.phase_steps


def _responses(device: Device) -> int:
    return _COMPLEX * len(device.sweep.frequency_hz) * len(device.actuators) * zone_points(device).size


def size_text(size: float) -> str:
    """A size in bytes with three digits and its unit."""
    order = min(len(_UNITS) - 1, int(math.log10(max(size, 1)) / 3))
    return f"{size / 1000**order:.3g} {_UNITS[order]}"
