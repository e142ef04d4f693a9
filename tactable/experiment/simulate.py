"""A protocol run by the simulated observer, without an engine, and how precise its thresholds will be. SIMULATED."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tactable.experiment.analysis import TrackFit, fit_of_rows
from tactable.experiment.observer import Observer
from tactable.experiment.protocol import Kind, Protocol, Task
from tactable.experiment.session import Session, Trial
from tactable.experiment.trial_files import COLUMNS, row_of

TRIALS = (20, 40, 80, 160, 320)
_OBSERVERS = 6
Columns = Callable[[Trial], Mapping[str, Any]]


def answer_all(
    session: Session, observer: Observer, columns: Columns = lambda _: {}, keep: Callable[[Any], None] = lambda _: None
) -> list[dict[str, str]]:
    """Answer what is left of a session; its rows as texts. `columns`: what would be played; `keep` gets each row."""
    rows = []
    while (trial := session.next_trial()) is not None:
        more = columns(trial)
        answer = observer.answer(trial, more.get("quiet_db"))
        row = row_of(trial, answer, session.record(trial, answer), more)
        keep(row)
        rows.append({name: "" if row.get(name) is None else str(row[name]) for name in COLUMNS})
    return rows


def fit_of(task: Task, observer: Observer, participant: str) -> TrackFit:
    """One finger's threshold in a task, fitted to the answers of an observer."""
    protocol = Protocol("simulated", "simulated", observer.seed, False, (task,))
    return fit_of_rows(protocol, answer_all(Session(protocol, participant), observer))[0][0]


def half_widths(task: Task) -> dict[int, float]:
    """Half of the interval of the threshold (dB; a factor in dB of a discrimination) by trials a finger: the median.

    Observers have thresholds spread over the middle half of the levels, and the usual slope and lapses.
    """
    low_db, high_db = task.levels_db[0], task.levels_db[-1]
    spread_db = low_db + (high_db - low_db) * np.linspace(0.25, 0.75, _OBSERVERS)
    found = {}
    for trials in TRIALS:
        asked, widths = replace(task, trials=trials), []
        for number, at_db in enumerate(spread_db.tolist()):
            given = {"jnd": at_db} if task.kind is Kind.DISCRIMINATION else {"threshold": at_db, "masking": 0.0}
            fit = fit_of(asked, Observer(**given, seed=number), str(number))
            widths.append((fit.threshold.high - fit.threshold.low) / 2)
        found[trials] = float(np.median(widths))
    return found
