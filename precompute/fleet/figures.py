"""A verified table to the few figures that tell one unit of a fleet from another."""

import math
import statistics
from collections.abc import Callable

from engine.table import Entry, Table, TableError
from engine.table.entry import DEFAULT_LEVEL_DB
from precompute.entries.solver import tabulated_states


def compute_figures(table: Table) -> dict[str, float | None]:
    """By name, with units; None where no state has such a figure. Raises TableError if a state is missing.

    Contrasts are of the tabulated level next to 20 dB.
    """
    states = len(tabulated_states(table.device))
    for level_db in table.levels_db:
        if len(table.entries_of(level_db)) != states:
            raise TableError(
                f"{table.path}: {len(table.entries_of(level_db))} entries at {level_db:g} dB, not {states}"
            )
    usual = usual_entries(table)
    expected_db = [e.expected_contrast_db for e in usual if e.expected_contrast_db is not None]
    worst_db = [e.worst_case.contrast_db for e in usual if e.worst_case.contrast_db is not None]
    return {
        "worst_expected_contrast_db": _of(min, expected_db),
        "median_expected_contrast_db": _of(statistics.median, expected_db),
        "worst_contrast_db": _of(min, worst_db),
        "least_full_level_db": _of(min, [entry.level_db for entry in table.entries_of(math.inf)]),
        "slowest_t90_s": _of(max, [entry.t90_s for entry in usual]),
        "out_of_reach": sum(not entry.achieved for entry in table.entries),
        "clicks": len(table.clicks),
        "weakest_click_db": _of(min, [click.level_db for click in table.clicks]),
    }


def usual_entries(table: Table) -> tuple[Entry, ...]:
    """Those of the tabulated level next to 20 dB."""
    return table.entries_of(min(table.levels_db, key=lambda level_db: abs(level_db - DEFAULT_LEVEL_DB)))


def _of(pick: Callable[[list[float]], float], values: list[float]) -> float | None:
    picked = pick(values) if values else math.inf
    return picked if math.isfinite(picked) else None
