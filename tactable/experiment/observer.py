"""A simulated observer with known thresholds: trials to answers, and how precise a fit to them will be. SIMULATED."""

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from tactable.experiment.analysis import TrackFit, fit_of_rows
from tactable.experiment.protocol import ExperimentError, Kind, Protocol, Task
from tactable.experiment.quest_plus import probability_correct
from tactable.experiment.session import Session, Trial, stimulus_axis
from tactable.experiment.trial_files import COLUMNS, row_of


@dataclass(frozen=True)
class Observer:
    """A person as the psychometric function has one.

    threshold: detected in half of the trials at the start, dB above the device's curve; fatigue: what it rises in 100
    trials, dB. masking: what a click at the other finger adds to it, dB. jnd: the difference that is noticed in half
    of the trials, dB. lapse: share of trials without attention. bias: guesses name the first choice in 0.5 + bias.
    """

    threshold: float = 4.0
    slope: float = 2.4
    lapse: float = 0.02
    fatigue: float = 0.0
    bias: float = 0.0
    masking: float = 5.0
    jnd: float = 2.0
    seed: int = 1

    @classmethod
    def parse(cls, text: str) -> "Observer":
        """Of a text such as "threshold=6,lapse=0.05"; "" is the usual one. Raises ExperimentError."""
        kinds, values = {field.name: int if field.name == "seed" else float for field in fields(cls)}, dict[str, Any]()
        for part in filter(None, (each.strip() for each in text.split(","))):
            name, _, value = part.partition("=")
            try:
                values[name] = kinds[name](value)
            except (KeyError, ValueError):
                known = ", ".join(f"{field.name}={field.default}" for field in fields(cls))
                raise ExperimentError(f"--observer: {part!r}: expected some of {known}") from None
        found = cls(**values)
        if not (0 <= found.lapse < 1 and abs(found.bias) <= 0.5 and found.slope > 0 and found.jnd > 0):
            raise ExperimentError("--observer: expected lapse 0 to 1, bias -0.5 to 0.5, slope and jnd above 0")
        return found

    def threshold_db(self, task: Task, number: float) -> float:
        """The threshold at a trial, on the axis of the psychometric function."""
        if task.kind is Kind.DISCRIMINATION:
            return stimulus_axis(task, self.jnd)
        return self.threshold + self.fatigue * number / 100 + self.masking * (task.kind is Kind.MASKED)

    def answer(self, trial: Trial, quiet_db: float | None) -> int:
        """The answer to a trial; quiet_db: the level at the other finger, None where none rests or it is not known."""
        drawn, task = random.Random(f"{self.seed} {trial.number} {trial.task.name}"), trial.task

        def detects(level_db: float | None) -> bool:
            if level_db is None:
                return False
            at_db = stimulus_axis(task, level_db)
            threshold_db = self.threshold_db(task, trial.number)
            return bool(drawn.random() < probability_correct(at_db, threshold_db, self.slope, self.lapse, 0.0))

        if task.kind is Kind.FELT_AND_QUIET:  # no guess: what is not detected is said so
            felt = {trial.finger: detects(trial.level_db), 1 - trial.finger: detects(quiet_db)}
            return {(True, False): 0, (False, True): 1, (True, True): 2, (False, False): 3}[felt[0], felt[1]]
        return trial.side if detects(trial.level_db) else int(drawn.random() >= 0.5 + self.bias)


TRIALS = (20, 40, 80, 160, 320)
_OBSERVERS = 3
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


def fits_of(task: Task, observer: Observer, participant: str) -> list[TrackFit]:
    """The threshold of each track of a task, fitted to the answers of an observer."""
    protocol = Protocol("simulated", "simulated", observer.seed, False, (task,))
    return fit_of_rows(protocol, answer_all(Session(protocol, participant), observer))[0]


def half_widths(task: Task) -> dict[int, float]:
    """Half of the interval of the threshold (dB; a factor in dB of a discrimination) by trials a track: the median.

    Observers have thresholds spread over the middle half of the levels, and the usual slope and lapses.
    """
    low_db, high_db = task.levels_db[0], task.levels_db[-1]
    spread_db = low_db + (high_db - low_db) * np.linspace(0.25, 0.75, _OBSERVERS)
    found = {}
    for trials in TRIALS:
        asked, widths = replace(task, trials=trials), []
        for number, at_db in enumerate(spread_db.tolist()):
            given = {"jnd": at_db} if task.kind is Kind.DISCRIMINATION else {"threshold": at_db, "masking": 0.0}
            fits = fits_of(asked, Observer(**given, seed=number), str(number))
            widths += [(fit.threshold.high - fit.threshold.low) / 2 for fit in fits]
        found[trials] = float(np.median(widths))
    return found
