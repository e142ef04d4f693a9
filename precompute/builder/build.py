"""Building a table: responses, sweeps, entries and clicks of a device, written whole or not at all, in bounded memory.

A build writes a new file beside its target and takes over the parts of the earlier table that are still right
(builder.incremental). It solves the others, verifies the file, and only then puts it in the earlier table's place, so
that an engine never opens half a table. Clicks take longest: each is kept in a store beside the table once it is solved
(clicks.store), so that an interrupted build loses seconds.
"""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from engine.device import Device
from engine.table import Table, TableError
from engine.table.columns import write_clicks, write_entries
from engine.table.file import TableWriter
from engine.touch import Placement, state_index
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.builder.cost import BuildCost
from precompute.builder.incremental import DEFERRABLE, OUTDATED, BuildOptions, Part, input_fingerprint, is_compatible
from precompute.builder.measured_responses import source_attributes, write_measured
from precompute.clicks import DEFAULT_OPTIONS, ClickOptions, solve_clicks
from precompute.clicks.basis import lines_for
from precompute.clicks.columns import ClickTabulator
from precompute.clicks.plants import count_modes
from precompute.clicks.store import ClickStore
from precompute.entries.objective import DEFAULT_OBJECTIVE, OBJECTIVES
from precompute.entries.prediction import MadeFor, States, touched_zones
from precompute.entries.solver import prepare_entries, solve_entries, tabulated_states
from precompute.measurements.plant import measured_plant
from precompute.measurements.responses import MeasuredResponses
from precompute.model.assembly import Plant, assemble
from precompute.model.modal import compute_basis
from precompute.parallel.interrupt import remembered_interrupt
from precompute.parallel.pool import WorkerPool
from precompute.sampling.bars import sampled_words
from precompute.sweep.grid import compute_grid_response, zone_points
from precompute.sweep.tabulate import write_coherent_sweep, write_pair_sweep, write_responses

MOST_ZONES_WITH_ALL_CLICKS = 5
MOST_CLICKED_BEYOND = 3
"""Fingers of a state that gets a click, by default, on a bar of more zones."""
MEMORY_BUDGET_BYTES = 64 << 20
"""Default bound on the buffers of the sweep, whatever its grid."""
Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction done."""


def _no_progress(step: str, fraction: float) -> None:
    """Reports nothing."""


def build_table(
    device: Device,
    path: Path | str,
    *,
    created: str | None = None,
    objective: str = DEFAULT_OBJECTIVE,
    made_for: MadeFor = MadeFor.MEAN,
    clicks_up_to: int | None = None,
    click_options: ClickOptions = DEFAULT_OPTIONS,
    workers: int = 1,
    pool: WorkerPool | None = None,
    reuse: bool = True,
    clicks_later: bool = False,
    completes: bool = False,
    responses: MeasuredResponses | None = None,
    memory_budget_bytes: int = MEMORY_BUDGET_BYTES,
    progress: Progress = _no_progress,
) -> BuildCost:
    """Compute, write and verify the table of `device`; only then it takes the place of what was at `path`.

    `created` is the date to note, by default now; `objective` a name of precompute.entries.objective.OBJECTIVES.
    `made_for`: entries whose level and contrast hold for the mean, or in all but the worst 5 % of the sampled cases.
    `clicks_up_to`: the most fingers that a state with a click has. By default that is every state of up to five zones,
    and three fingers beyond; 0 makes no clicks. Entries and clicks are solved by `workers` processes, entries by a
    `pool` where one is given. Clicks that were solved when a build is interrupted are kept beside the table for the
    next build. With `reuse`, parts of a table at `path` are taken over if this code made them from inputs that have not
    changed. With `clicks_later` its clicks are taken over whatever has changed, marked as outdated
    (builder.incremental); a build without it makes them. The table that was at `path` is kept as the previous one; a
    build that `completes` it keeps the one before. With `responses` the bar moves as it was measured, while the effect
    of fingers, rise times and clicks remain the model's. Returns what it took; processes of a given `pool` go on, and
    so are not counted.

    Raises TableError if the table cannot be written, for an unknown objective, and for a device whose values are not
    those of its text, since a table holds the text. Raises WorkerError where a worker process was killed.

    >>> cost = build_table(Device.read("my-bar.toml"), "my-bar.nc", clicks_up_to=0)
    """
    path = Path(path)
    if Device.parse(device.text, device.name).fingerprint != device.fingerprint:
        raise TableError(f"{device.name}: was changed after it was read; write the new values to a file and read it")
    sha256 = "" if responses is None else responses.sha256
    most = _most_fingers(device, clicks_up_to)
    options = BuildOptions(code_fingerprint(), objective, most, click_options, sha256, made_for)
    if objective not in OBJECTIVES:
        raise TableError(f"there is no objective {objective!r}; choose one of {', '.join(OBJECTIVES)}")
    with threadpool_limits(1, "blas"), remembered_interrupt() as check:  # unpinned BLAS: 100 times slower when busy
        checked = _checked(progress, check)
        builder = _Builder(
            device, path, options, workers, pool, clicks_later, completes, responses, memory_budget_bytes, checked
        )
        with _earlier(path, reuse) as earlier:
            builder.build(created or datetime.now(UTC).isoformat(timespec="seconds"), earlier)
    progress("done", 1.0)
    return builder.cost


def _checked(progress: Progress, check: Callable[[], None]) -> Progress:
    def checked(step: str, fraction: float) -> None:
        check()
        progress(step, fraction)

    return checked


def _most_fingers(device: Device, clicks_up_to: int | None) -> int:
    zones = len(device.zones)
    if clicks_up_to is not None:
        return clicks_up_to
    return zones if zones <= MOST_ZONES_WITH_ALL_CLICKS else MOST_CLICKED_BEYOND


def _model_attributes(plant: Plant, options: BuildOptions) -> dict[str, int | float]:
    """Mesh and modes, which follow from the band, as attributes of the table."""
    length_m, basis = np.diff(plant.node_m), compute_basis(plant)
    found: dict[str, int | float] = {
        "mesh_elements": len(length_m),
        "mesh_longest_element_m": float(length_m.max()),
        "modes": len(basis.square_omega),
    }
    if options.clicks_up_to:
        found["click_modes"] = count_modes(plant.device, lines_for(plant.device, options.click_options.lengths_s))
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
    pool: WorkerPool | None
    clicks_later: bool
    completes: bool
    responses: MeasuredResponses | None
    memory_budget_bytes: int
    progress: Progress
    cost: BuildCost = field(default_factory=BuildCost)

    def build(self, created: str, earlier: Table | None) -> None:
        device, options, progress = self.device, self.options, self.progress
        inputs = {part: input_fingerprint(part, device, options) for part in Part}
        known = {part for part in Part if earlier and earlier.attributes.get(part.attribute) == inputs[part]}
        wanted = self._wanted()
        later = {part for part in DEFERRABLE if self.clicks_later and part in wanted - known}
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
                    "objective": options.objective,
                    "made_for": options.made_for.value,
                    "clicks_up_to": options.clicks_up_to,
                    "click_options": json.dumps(asdict(options.click_options)),
                    "spread_over": sampled_words(device, is_measured=self.responses is not None),
                    **_model_attributes(plant, options),
                    **source_attributes(self.responses),
                    **{part.attribute: inputs[part] for part in Part if part not in later},
                    **({OUTDATED: " ".join(sorted(later))} if later else {}),
                }
            )
            if earlier is not None:
                for part in sorted(known | {part for part in later if is_compatible(earlier.device, device)}):
                    if earlier.copy_groups(writer, part.groups):
                        progress(f"{part} as before", 0.05)
            with self.cost.with_workers("entries"), self._pool(known) as pool:
                if Part.RESPONSES not in known:
                    self._write_responses(writer, plant)
                if Part.ENTRIES not in known:
                    with self.cost.measured("entries"):
                        self._write_entries(writer, plant, pool)
            with self.cost.with_workers("clicks"), self.cost.measured("clicks"):
                store = self._solve_clicks() if Part.CLICKS in wanted - known - later else None
                if store and store.clicks:
                    write_clicks(writer, [click for _, click in sorted(store.clicks.items())], device)
            progress("verify", 0.96)
        if store:
            store.path.unlink(missing_ok=True)  # nothing is left to resume

    def _wanted(self) -> set[Part]:
        """The parts that the table is to have."""
        return {part for part in Part if part is not Part.CLICKS or self.options.clicks_up_to}

    def _check(self, written: Path) -> None:
        Table.open(written, device=self.device, code_fingerprint=self.options.code_fingerprint, verify=False).close()
        self.progress("put in place", 0.99)

    @contextmanager
    def _pool(self, known: set[Part]) -> Iterator[WorkerPool]:
        if self.pool is not None:
            yield self.pool
            return
        with WorkerPool(0 if Part.ENTRIES in known else self.workers - 1) as pool:
            pool.prepare(prepare_entries)
            yield pool

    def _write_responses(self, writer: TableWriter, plant: Plant) -> None:
        with self.cost.measured("responses"):
            grid = compute_grid_response(plant, self.device.sweep.frequency_hz, zone_points(self.device))
            write_responses(writer, plant, grid)
            if self.responses is not None:
                write_measured(writer, self.device, self.responses)
        with self.cost.measured("sweep"):
            for fraction in write_pair_sweep(writer, grid, self.memory_budget_bytes):
                self.progress("sweep", 0.05 + 0.15 * fraction)
            self.progress("coherent sweep", 0.2)
            write_coherent_sweep(writer, grid)

    def _write_entries(self, writer: TableWriter, plant: Plant, pool: WorkerPool) -> None:
        solved, share = [], 0.1 if self.options.clicks_up_to else 0.7
        for entries, fraction in solve_entries(plant, self.options.objective, pool, self.options.made_for):
            solved.append(entries)
            self.cost.states += 1
            self.progress("entries", 0.25 + share * fraction)
        solved.sort(key=lambda entries: entries[0].index)
        # Written level by level.
        write_entries(writer, [entry for level in zip(*solved, strict=True) for entry in level], self.device)

    def _solve_clicks(self) -> ClickStore:
        """Every click, in a store that may already hold some from an interrupted build."""
        device, click_options = self.device, self.options.click_options
        tabulator = ClickTabulator(device, click_options)
        with ClickStore(self.path, input_fingerprint(Part.CLICKS, device, self.options), tabulator.basis) as store:
            states = self._states(self.options.clicks_up_to)
            left = [state for state in states if state_index(state) not in store.clicks]
            state_of = {Placement.in_zones(device, state): state for state in left}
            for click in solve_clicks(device, click_options, list(state_of), self.workers):
                store.add(tabulator.tabulate(state_of[click.placement], click))
                self.cost.clicks += 1
                self.cost.effort += click.effort
                self.progress("clicks", 0.35 + 0.6 * len(store.clicks) / len(states))
        return store

    def _states(self, fingers: int) -> list[States]:
        """The tabulated states of at most `fingers` fingers."""
        return [state for state in tabulated_states(self.device) if len(touched_zones(state)) <= fingers]
