"""Units to their outcomes: those complete from an earlier run are kept, the others are run where they are to be."""

from collections.abc import Sequence
from pathlib import Path

from precompute.fleet.pool import Pool
from precompute.fleet.units import Job, Outcome, Recipe, Unit, make_job
from precompute.fleet.work import Progress, describe_error, kept_outcome, no_progress


def run_fleet(
    units: Sequence[Unit],
    recipe: Recipe,
    out: Path,
    pool: Pool,
    *,
    created: str,
    progress: Progress = no_progress,
) -> list[Outcome]:
    """The outcome of every unit, in their order; results are in `out`, a folder each. `created` is noted in tables.

    What is interrupted goes on where it was: a unit is complete or is run again.
    """
    outcomes: dict[str, Outcome] = {}
    jobs = list[Job]()
    for unit in units:
        try:
            job = make_job(unit, recipe, out, created)
        except OSError as error:
            outcomes[unit.name] = Outcome(unit.name, "", error=describe_error(error))
            continue
        if kept := kept_outcome(job):
            outcomes[unit.name] = kept
        else:
            jobs.append(job)
    before, total = len(outcomes), len(units)

    def told(step: str, fraction: float) -> None:
        progress(step, (before + fraction * len(jobs)) / total)

    if jobs:
        for outcome in pool(jobs, told):
            outcomes[outcome.name] = outcome
            progress(outcome.name, len(outcomes) / total)
    return [outcomes[unit.name] for unit in units]
