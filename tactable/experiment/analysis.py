"""Trials to what they show: thresholds with credible intervals, and the share of touches kept felt and not felt.

The fit has the likelihood of `quest_plus` on a finer grid, and two parameters more, so that neither makes an interval
too narrow: a bias of guesses to one side, and a drift of the threshold over the trials (fatigue, practice). The
threshold is that at the middle of the trials; intervals are of 95 %, from the posterior with all else summed out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from base.arrays import Array
from tactable.experiment.protocol import Kind, Protocol, Task
from tactable.experiment.quest_plus import SLOPE_WEIGHTS, SLOPES, probability_correct, threshold_grid
from tactable.experiment.session import Role, stimulus_axis, track_of

Row = Mapping[str, str]
_STEP_DB = 0.5
_SLOPES = np.array(SLOPES)
_LAPSES = np.array([0.0, 0.02, 0.05, 0.1])
_BIASES = np.linspace(-0.3, 0.3, 7)
_DRIFTS_DB = np.linspace(-3.0, 3.0, 7)  # in 100 trials
_BIAS_SPREAD, _DRIFT_SPREAD_DB = 0.15, 1.5  # of the normal distributions that they are drawn from beforehand: ESTIMATES
_INTERVAL = (0.025, 0.5, 0.975)
_LEAST_AT_EDGE = 0.05  # a posterior with more at an end of the thresholds is cut off there: no interval is shown
NEAR_CHANCE = 0.1  # share of trials in which a stimulus is detected: of two answers 55 % are right


class Estimate(NamedTuple):
    """Ends of an interval of 95 % and the median."""

    low: float
    middle: float
    high: float


@dataclass(frozen=True)
class TrackFit:
    """What one track shows: level or difference in dB that is detected in half of the trials, and the rest.

    near_chance: the level at which NEAR_CHANCE of the stimuli are detected. is_shown: whether the threshold lies within
    what the task asked. stimuli (stimulus, 3): level, number of answers, share of right ones. frequency_hz: of a tone,
    None of which-finger, whose fingers differ. quiet_db: what the other finger is predicted to feel less (median).
    """

    task: Task
    finger: int
    trials: int
    threshold: Estimate
    near_chance: Estimate
    slope: float
    lapse: float
    bias: float
    drift_db: float
    is_shown: bool
    stimuli: Array
    frequency_hz: float | None
    quiet_db: float | None


@dataclass(frozen=True)
class ShareFit:
    """How many touches of a felt-and-quiet task kept both: exactly the finger that was to feel it said so.

    share: with the interval of 95 % after Jeffreys. confused: the number of each other answer, by "felt left, answered
    both". false_alarms: catch trials in which something was felt, of `catch`. promise: what the table promises in 95 %
    of the sampled plants, "felt at least" and "quiet at most", dB; the least favourable of the trials.
    """

    task: Task
    kept: int
    trials: int
    share: Estimate
    confused: Mapping[str, int]
    false_alarms: int
    catch: int
    felt_low_db: float | None
    quiet_high_db: float | None


class Answers(NamedTuple):
    """Answers of one track (trial,): stimulus on the function's axis, whether there was one, number, side, right."""

    x_db: Array
    has_stimulus: Array
    number: Array
    side: Array
    is_right: Array


def fit_track(answers: Answers, x_db: Array) -> tuple[Array, dict[str, Array]]:
    """The posterior (threshold, slope) of some answers, and the marginals of the other parameters, by name.

    x_db (stimulus,): what the track had to choose from.
    """
    threshold_db = threshold_grid(x_db, _STEP_DB)
    t, drift = threshold_db[:, None, None], _DRIFTS_DB[:, None]
    log_p = -0.5 * ((_DRIFTS_DB / _DRIFT_SPREAD_DB) ** 2)[None, :, None, None, None]
    log_p = log_p - 0.5 * (_BIASES / _BIAS_SPREAD) ** 2 + np.log(SLOPE_WEIGHTS)[:, None, None]
    log_p = np.broadcast_to(
        log_p, (len(threshold_db), len(_DRIFTS_DB), len(_SLOPES), len(_LAPSES), len(_BIASES))
    ).copy()
    apart = (answers.number - answers.number.mean()) / 100
    columns = zip(answers.x_db, answers.has_stimulus, apart, answers.side, answers.is_right, strict=True)
    for at_db, has_stimulus, late, side, is_right in columns:
        function = probability_correct(at_db, t + drift * late, _SLOPES, 0.0, 0.0, has_stimulus=has_stimulus)
        detected = function[..., None] * (1 - _LAPSES)
        guess = 0.5 + (_BIASES if side == 0 else -_BIASES)
        correct = detected[..., None] + (1 - detected[..., None]) * guess
        log_p += np.log(np.maximum(correct if is_right else 1 - correct, 1e-300))
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    others = {"drift": p.sum((0, 2, 3, 4)), "lapse": p.sum((0, 1, 2, 4)), "bias": p.sum((0, 1, 2, 3))}
    return p.sum((1, 3, 4)), others


def estimate_level(posterior: Array, x_db: Array, share: float) -> Estimate:
    """The stimulus that is detected in a share of the trials, of a posterior (threshold, slope)."""
    off_db = 20 / _SLOPES * np.log10(np.log2(1 / (1 - share)))
    values, weights = (threshold_grid(x_db, _STEP_DB)[:, None] + off_db).ravel(), posterior.ravel()
    order = np.argsort(values)
    values, weights = values[order], weights[order]
    # Each grid point stands for the thresholds around it: the distribution rises linearly through the middles.
    middles = np.cumsum(weights) - weights / 2
    return Estimate(*np.interp(_INTERVAL, middles, values).tolist())


def fit_of_rows(protocol: Protocol, rows: Sequence[Row]) -> tuple[list[TrackFit], list[ShareFit]]:
    """All that the rows of a session's file show, task by task."""
    tracks, shares = [], []
    for task in protocol.tasks:
        own = [row for row in rows if row["task"] == task.name and row["role"] != Role.PRACTICE]
        if task.kind is Kind.FELT_AND_QUIET:
            if any(row["role"] == Role.TEST for row in own):
                shares.append(_share_of(task, own))
            continue
        for finger in sorted({track_of(task, finger)[1] for finger in range(len(task.position_m))}):
            mine = [row for row in own if track_of(task, int(row["finger"]))[1] == finger]
            if any(row["role"] == Role.TEST for row in mine):
                tracks.append(_track_fit(task, finger, mine))
    return tracks, shares


def _track_fit(task: Task, finger: int, rows: Sequence[Row]) -> TrackFit:
    x_db = np.array([stimulus_axis(task, level_db) for level_db in task.levels_db])
    tests = [row for row in rows if row["role"] == Role.TEST]
    answers = Answers(
        np.array([stimulus_axis(task, float(row["level_db"])) if row["level_db"] else 0.0 for row in rows]),
        np.array([bool(row["level_db"]) for row in rows]),
        np.array([float(row["trial"]) for row in rows]),
        np.array([int(row["side"]) for row in rows]),
        np.array([row["correct"] == "1" for row in rows]),
    )
    posterior, others = fit_track(answers, x_db)
    ends = posterior.sum(axis=1)[[0, -1]]
    levels_db = sorted({float(row["level_db"]) for row in tests})
    of_level = [
        [row["correct"] == "1" for row in tests if float(row["level_db"]) == level_db] for level_db in levels_db
    ]

    tones_hz = [float(row["frequency_hz"]) for row in tests if row["frequency_hz"]]
    below_db = [float(row["felt_db"]) - float(row["quiet_db"]) for row in tests if row["felt_db"] and row["quiet_db"]]

    def plain(found: Estimate) -> Estimate:
        """Differences as such."""
        return Estimate(*(10 ** (each / 20) for each in found)) if task.kind is Kind.DISCRIMINATION else found

    return TrackFit(
        task,
        finger,
        len(tests),
        plain(estimate_level(posterior, x_db, 0.5)),
        plain(estimate_level(posterior, x_db, NEAR_CHANCE)),
        float(posterior.sum(axis=0) @ _SLOPES),
        float(others["lapse"] @ _LAPSES),
        float(others["bias"] @ _BIASES),
        float(others["drift"] @ _DRIFTS_DB),
        bool((ends < _LEAST_AT_EDGE).all()),
        np.array([[db, len(each), np.mean(each)] for db, each in zip(levels_db, of_level, strict=True)]),
        None if task.kind is Kind.WHICH_FINGER else _median(tones_hz),
        _median(below_db),
    )


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _share_of(task: Task, rows: Sequence[Row]) -> ShareFit:
    from scipy.stats import beta

    tests, catch = ([row for row in rows if row["role"] == role] for role in (Role.TEST, Role.CATCH))
    kept = sum(row["correct"] == "1" for row in tests)
    wrong = [
        f"felt {task.choices[int(row['side'])]}, answered {row['answer']}" for row in tests if row["correct"] != "1"
    ]
    low, middle, high = (float(beta.ppf(each, kept + 0.5, len(tests) - kept + 0.5)) for each in _INTERVAL)
    promised = [[float(row[name]) for row in tests if row[name]] for name in ("felt_low_db", "quiet_high_db")]
    return ShareFit(
        task,
        kept,
        len(tests),
        Estimate(low if kept else 0.0, middle, high if kept < len(tests) else 1.0),
        {each: wrong.count(each) for each in sorted(set(wrong))},
        sum(row["correct"] != "1" for row in catch),
        len(catch),
        min(promised[0], default=None),
        max(promised[1], default=None),
    )
