"""Alternatives to an entry: the drives that other objectives choose, evaluated alike, and why each of them lost."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from engine.table import Entry
from engine.table.entry import LEVEL_TOLERANCE_DB
from precompute.entries.found_drive import FoundDrive
from precompute.entries.objective import DEFAULT_OBJECTIVE, OBJECTIVES, Problem, paper
from precompute.entries.prediction import States, touched_zones
from precompute.entries.search import TIE_DB, Search
from precompute.entries.solver import EntrySolver
from precompute.model.assembly import Plant


@dataclass(frozen=True)
class Alternative:
    """A rival: its name and its entry, with the same figures as the winner's; `lost_by` says why it lost."""

    name: str
    entry: Entry
    lost_by: str


def solve_alternatives(plant: Plant, states: States, winner: Entry) -> list[Alternative]:
    """The best single tones and the drives of the other objectives, evaluated as the entry `winner` of `states`."""
    solver = EntrySolver(plant)
    entries = {
        name: solver.evaluate(states, winner.wanted_level_db, drive, name)
        for name, drive in _rivals(solver, states, winner)
    }
    return [Alternative(name, entry, _lost_by(winner, entry)) for name, entry in entries.items()]


def paper_drive(solver: EntrySolver, states: States) -> FoundDrive:
    """The optimum of the published objective (11)."""
    found = Search(paper(solver.forms_of(touched_zones(states)), states), []).best(0.0)
    assert found is not None  # with nothing wanted there is always a drive
    return found.drive


def _rivals(solver: EntrySolver, states: States, winner: Entry) -> Iterator[tuple[str, FoundDrive]]:
    forms = solver.forms_of(touched_zones(states))
    wanted = solver.wanted_power(winner.wanted_level_db)
    own = OBJECTIVES.get(winner.objective, OBJECTIVES[DEFAULT_OBJECTIVE])(forms, states)
    for index, actuator in enumerate(solver.device.actuators):
        yield from _best(f"{actuator.name} alone", _alone(own, index), wanted)
    for name, objective in OBJECTIVES.items():
        if name != winner.objective and objective(forms, states).name == name:
            yield from _best(name, objective(forms, states), wanted)


def _best(name: str, problem: Problem, wanted: float) -> Iterator[tuple[str, FoundDrive]]:
    """The best drive that reaches the wanted power; where none does, the best of all."""
    powers = [wanted] if np.isfinite(wanted) else []
    search = Search(problem, powers)
    found = next((found for power in [*powers, 0.0] if (found := search.best(power))), None)
    if found is not None:
        yield name, found.drive


def _alone(problem: Problem, actuator: int) -> Problem:
    """The problem with only this actuator in its band."""
    only = problem.in_band & (np.arange(problem.in_band.shape[1]) == actuator)
    return replace(problem, in_band=only)


def _lost_by(winner: Entry, rival: Entry) -> str:
    """The first rule of the objective by which the rival is worse."""
    if np.isinf(winner.wanted_level_db) or not winner.achieved:
        short_db = winner.level_db - rival.level_db
        return f"{short_db:.1f} dB less level" if short_db > LEVEL_TOLERANCE_DB else "as loud"
    if not rival.achieved:
        return f"reaches only {rival.level_db:.1f} dB"
    if winner.expected_contrast_db is not None and rival.expected_contrast_db is not None:
        worse_db = winner.expected_contrast_db - rival.expected_contrast_db
        if worse_db > TIE_DB:
            return f"{worse_db:.1f} dB less expected contrast"
    elif winner.localized_factor - rival.localized_factor > 1e-4:
        return f"localized factor {winner.localized_factor - rival.localized_factor:.3f} less"
    slower_s = rival.t90_s - winner.t90_s
    return f"as good, {1e3 * slower_s:.0f} ms slower" if slower_s > 0 else "as good"
