"""A device to its table file: responses, sweeps and entries, in bounded memory, complete or not at all."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from importlib import metadata
from pathlib import Path

from threadpoolctl import threadpool_limits

import engine
import precompute
from engine.click_group import write_clicks
from engine.device import Device
from engine.entry_group import write_entries
from engine.table import open_table
from engine.table_file import TableError, TableWriter
from engine.zones import state_index
from precompute.assembly import assemble
from precompute.click import solve_clicks
from precompute.click_options import DEFAULT_OPTIONS, ClickOptions
from precompute.click_store import ClickStore
from precompute.click_table import ClickTabulator
from precompute.entries import solve_entries, tabulated_states
from precompute.grid import compute_grid_response, zone_points
from precompute.interruption import remembered_interrupt
from precompute.objective import DEFAULT_OBJECTIVE, OBJECTIVES
from precompute.promise import touched_zones
from precompute.tabulate import write_coherent_sweep, write_pair_sweep, write_responses

MOST_ZONES_WITH_ALL_CLICKS = 5
MOST_CLICKED_BEYOND = 3
MEMORY_BUDGET_BYTES = 64 << 20
"""Default bound on the buffers of the sweep, whatever its grid."""
Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction done."""


def _no_progress(step: str, fraction: float) -> None:
    """Tell nobody."""


@cache
def code_fingerprint() -> str:
    """SHA-256 (hex) over the sources that decide what is in a table."""
    here, there = Path(precompute.__file__).parent, Path(engine.__file__).parent
    names = (
        "click",
        "click_group",
        "device",
        "device_file",
        "entry",
        "entry_group",
        "quantity",
        "section",
        "table_file",
    )
    sources = sorted(here.glob("*.py")) + [there / f"{name}.py" for name in (*names, "zones")]
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sources)).hexdigest()


def build_table(
    device: Device,
    path: Path,
    *,
    created: str,
    objective: str = DEFAULT_OBJECTIVE,
    clicks_up_to: int | None = None,
    click_options: ClickOptions = DEFAULT_OPTIONS,
    workers: int = 1,
    memory_budget_bytes: int = MEMORY_BUDGET_BYTES,
    progress: Progress = _no_progress,
) -> None:
    """Compute, write and verify the table of `device`; only then it takes the place of what was at `path`.

    `created` is the date to note, `objective` a name of precompute.objective.OBJECTIVES. `clicks_up_to`: states of up
    to so many fingers get clicks, by default all of them for up to five zones, of three fingers beyond; 0 is none.
    They are solved by `workers` processes; what is solved when a build is interrupted is kept beside the table for the
    next. Raises TableError if the table cannot be written, and for another objective.
    """
    wanted = _Wanted(objective, _fingers(device, clicks_up_to), click_options, workers)
    if objective not in OBJECTIVES:
        raise TableError(f"there is no objective {objective!r}; choose one of {', '.join(OBJECTIVES)}")
    with threadpool_limits(1, "blas"), remembered_interrupt() as check:  # unpinned BLAS: 100 times slower when busy
        checked = _checked(progress, check)
        _compute_and_write(device, path, created, wanted, memory_budget_bytes, checked)
    open_table(path, device=device, code_fingerprint=code_fingerprint(), verify=False).close()
    progress("done", 1.0)


def _checked(progress: Progress, check: Callable[[], None]) -> Progress:
    def checked(step: str, fraction: float) -> None:
        check()
        progress(step, fraction)

    return checked


@dataclass(frozen=True)
class _Wanted:
    """What a table is to hold beside responses and sweeps."""

    objective: str
    clicks_up_to: int
    click_options: ClickOptions
    workers: int


def _fingers(device: Device, clicks_up_to: int | None) -> int:
    zones = len(device.zones)
    if clicks_up_to is not None:
        return clicks_up_to
    return zones if zones <= MOST_ZONES_WITH_ALL_CLICKS else MOST_CLICKED_BEYOND


def _compute_and_write(
    device: Device, path: Path, created: str, wanted: _Wanted, memory_budget_bytes: int, progress: Progress
) -> None:
    plant = assemble(device)
    points_m = zone_points(device)
    progress("responses", 0.0)
    grid = compute_grid_response(plant, device.sweep.frequency_hz, points_m)
    with TableWriter(path) as writer:
        writer.describe(
            {
                "title": f"tactable table of {device.name}",
                "Conventions": "CF-1.10",
                "device_name": device.name,
                "device_description": device.text,
                "device_fingerprint": device.fingerprint,
                "code_fingerprint": code_fingerprint(),
                "code_version": metadata.version("tactable"),
                "created": created,
                "objective": wanted.objective,
                "click_options": json.dumps(asdict(wanted.click_options)),
            }
        )
        write_responses(writer, plant, grid)
        for fraction in write_pair_sweep(writer, grid, memory_budget_bytes):
            progress("sweep", 0.05 + 0.15 * fraction)
        progress("coherent sweep", 0.2)
        write_coherent_sweep(writer, grid)
        solved = []
        share = 0.1 if wanted.clicks_up_to else 0.7
        for entries, fraction in solve_entries(plant, wanted.objective):
            solved.append(entries)
            progress("entries", 0.25 + share * fraction)
        solved.sort(key=lambda entries: entries[0].index)
        # Written level by level.
        write_entries(writer, [entry for level in zip(*solved, strict=True) for entry in level], device)
        store = _solve_clicks(device, path, wanted, progress)
        if store.clicks:
            write_clicks(writer, [click for _, click in sorted(store.clicks.items())], device)
    store.path.unlink(missing_ok=True)  # nothing is left to resume


def _solve_clicks(device: Device, path: Path, wanted: _Wanted, progress: Progress) -> ClickStore:
    """The clicks, in a store that holds those of an interrupted build already."""
    belongs_to = f"{device.fingerprint} {code_fingerprint()} {wanted.click_options}"
    with ClickStore(path, belongs_to) as store:
        states = [state for state in tabulated_states(device) if len(touched_zones(state)) <= wanted.clicks_up_to]
        left = [state for state in states if state_index(state) not in store.clicks]
        tabulator = ClickTabulator(device, wanted.click_options.wanted_db)
        for click in solve_clicks(device, wanted.click_options, left, wanted.workers):
            store.add(tabulator.tabulate(click))
            progress("clicks", 0.35 + 0.6 * len(store.clicks) / len(states))
    return store
