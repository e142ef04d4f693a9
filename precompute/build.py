"""A device to its table file: responses, sweeps and entries, in bounded memory, complete or not at all."""

import hashlib
from collections.abc import Callable
from functools import cache
from importlib import metadata
from pathlib import Path

from threadpoolctl import threadpool_limits

import engine
import precompute
from engine.device import Device
from engine.table import TableError, TableWriter, open_table, write_entries
from precompute.assembly import assemble
from precompute.entries import solve_entries
from precompute.grid import compute_grid_response, zone_points
from precompute.interruption import remembered_interrupt
from precompute.objective import DEFAULT_OBJECTIVE, OBJECTIVES
from precompute.tabulate import write_coherent_sweep, write_pair_sweep, write_responses

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
    names = ("device.py", "device_file.py", "entry.py", "quantity.py", "section.py", "table.py", "zones.py")
    sources = sorted(here.glob("*.py")) + [there / name for name in names]
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sources)).hexdigest()


def build_table(
    device: Device,
    path: Path,
    *,
    created: str,
    objective: str = DEFAULT_OBJECTIVE,
    memory_budget_bytes: int = MEMORY_BUDGET_BYTES,
    progress: Progress = _no_progress,
) -> None:
    """Compute, write and verify the table of `device`; only then it takes the place of what was at `path`.

    `created` is the date to note, `objective` a name of precompute.objective.OBJECTIVES. Raises TableError if it cannot
    be written, and for another objective.
    """
    if objective not in OBJECTIVES:
        raise TableError(f"there is no objective {objective!r}; choose one of {', '.join(OBJECTIVES)}")
    with threadpool_limits(1, "blas"), remembered_interrupt() as check:  # unpinned BLAS: 100 times slower when busy
        checked = _checked(progress, check)
        _compute_and_write(device, path, created, objective, memory_budget_bytes, checked)
    open_table(path, device=device, code_fingerprint=code_fingerprint(), verify=False).close()
    progress("done", 1.0)


def _checked(progress: Progress, check: Callable[[], None]) -> Progress:
    def checked(step: str, fraction: float) -> None:
        check()
        progress(step, fraction)

    return checked


def _compute_and_write(
    device: Device, path: Path, created: str, objective: str, memory_budget_bytes: int, progress: Progress
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
                "objective": objective,
            }
        )
        write_responses(writer, plant, grid)
        for fraction in write_pair_sweep(writer, grid, memory_budget_bytes):
            progress("sweep", 0.05 + 0.15 * fraction)
        progress("coherent sweep", 0.2)
        write_coherent_sweep(writer, grid)
        solved = []
        for entries, fraction in solve_entries(plant, objective):
            solved.append(entries)
            progress("entries", 0.25 + 0.7 * fraction)
        solved.sort(key=lambda entries: entries[0].index)
        # Written level by level.
        write_entries(writer, [entry for level in zip(*solved, strict=True) for entry in level], device)
