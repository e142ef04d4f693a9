"""Source of clicks: the table's own click of a state, or one that is solved now with the table's options."""

import json
from dataclasses import fields
from functools import cached_property
from math import inf
from typing import Any

from engine.table import ClickEntry, Entry, Table, TableError
from engine.table.click import played_at
from engine.touch import Placement, ZoneState, state_index
from precompute.clicks import DEFAULT_OPTIONS, Click, ClickOptions, ClickSolver
from precompute.clicks.baselines import GATED_DRIVE, solve_baseline
from precompute.clicks.columns import ClickTabulator
from precompute.entries.prediction import States
from precompute.entries.solver import EntrySolver
from precompute.model.assembly import assemble


class ClickSource:
    """Clicks of a table's device, and the solver that evaluates them as the table's were evaluated."""

    def __init__(self, table: Table) -> None:
        self.table = table
        self.options = read_click_options(table)
        """Options of the table's clicks; the defaults where it has no clicks."""

    @cached_property
    def solver(self) -> ClickSolver:
        """Solver for the table's device and options; its plants take a second."""
        return ClickSolver(self.table.device, self.options)

    def holds(self, states: States) -> bool:
        """Whether the table has the click of a state; otherwise `solve_click` takes seconds."""
        return self.table.click_at(state_index(states), inf) is not None

    def solve_click(self, states: States) -> ClickEntry:
        """The click of any state at full strength. Raises TableError where no finger is felt."""
        if ZoneState.FELT not in states:
            raise TableError(f"{self.table.path}: a click is for felt fingers: name at least one, such as --felt I")
        own = self.table.click_at(state_index(states), inf)
        if own is not None:
            return own
        solved = self.solver.solve(Placement.in_zones(self.table.device, states))
        return played_at(ClickTabulator(self.table.device, self.options).tabulate(states, solved), inf)

    def solve_baseline(self, states: States, name: str, length_s: float) -> Click:
        """A baseline of that length for a state, evaluated as the table's clicks."""
        device, entries = self.table.device, list[Entry]()
        if name == GATED_DRIVE:
            entries = EntrySolver(assemble(device)).solve(states)
        return solve_baseline(self.solver, Placement.in_zones(device, states), entries, name, length_s)


def read_click_options(table: Table) -> ClickOptions:
    """Read the attribute `click_options`. Raises TableError for options that this program does not know."""
    text = table.attributes.get("click_options")
    if text is None:
        return DEFAULT_OPTIONS
    values: dict[str, Any] = json.loads(str(text))
    unknown = sorted(set(values) - {field.name for field in fields(ClickOptions)})
    if unknown:
        raise TableError(
            f"{table.path}: its clicks were made with options unknown here: {', '.join(unknown)}; build it again"
        )
    known: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
    return ClickOptions(**known)
