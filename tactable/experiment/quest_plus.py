"""QUEST+: answers to a posterior of a psychometric function, and to the stimulus that tells most about it next.

Theory of operation
-------------------
Watson 2017, J. Vision 17(3):10. The parameters lie on a grid, and every answer multiplies the probability of each grid
point by that of the answer there (Bayes). The next stimulus is the one with the least expected entropy of the posterior
after its answer. Parameters are the threshold, the slope, and the share of trials in which the person does not attend.

The function is a Weibull in dB, stated by the threshold t at which the stimulus is detected in half of the trials:
F(x) = 1 - 2^(-10^(slope (x - t) / 20)). Who detects it is right, who does not guesses, and is right in `guess` of the
trials: of two choices an unbiased person is right in 75 % of the trials at the threshold. (With the usual form,
whose threshold has F = 1 - 1/e, threshold and slope depend on each other more.)
"""

from typing import Any

import numpy as np

from base.arrays import Array

SLOPES = (1.2, 1.7, 2.4, 3.4, 4.8)
SLOPE_WEIGHTS = (0.13, 0.6, 1.0, 0.6, 0.13)
"""How likely the slopes are before the first answer. ESTIMATES: about 2.4, within a factor of 1.4 in two of three."""
LAPSES = (0.0, 0.03, 0.08)
_STEP_DB, _GUESS = 1.0, 0.5  # between thresholds; share of right answers of who detects nothing, of two choices
BEYOND_DB = 6.0  # by which thresholds are looked for on either side of the stimuli


def probability_correct(
    x_db: Any, threshold_db: Any, slope: Any, lapse: Any, guess: Any, *, has_stimulus: Any = True
) -> Any:
    """Share of right answers to a stimulus, of arrays that fit together. lapse: share of trials without attention."""
    detected = has_stimulus * (1 - lapse) * (1 - 0.5 ** (10 ** (slope * (x_db - threshold_db) / 20)))
    return detected + (1 - detected) * guess


def threshold_grid(x_db: Array, step_db: float) -> Array:
    """The thresholds that are held for possible with stimuli x_db (stimulus,), rising."""
    return np.arange(x_db[0] - BEYOND_DB, x_db[-1] + BEYOND_DB + step_db / 2, step_db)


class QuestPlus:
    """One adaptive track: `choose_stimulus`, ask, `update`. x_db (stimulus,): the stimuli on offer, rising."""

    def __init__(self, x_db: Array) -> None:
        self.x_db = np.asarray(x_db, dtype=float)
        axes = np.meshgrid(threshold_grid(self.x_db, _STEP_DB), SLOPES, LAPSES, indexing="ij")
        threshold_db, slope, lapse = (axis.ravel() for axis in axes)
        # (stimulus, grid point)
        self._correct = probability_correct(self.x_db[:, None], threshold_db, slope, lapse, _GUESS)
        weights = np.tile(np.repeat(SLOPE_WEIGHTS, len(LAPSES)), len(axes[0]))
        self.posterior = weights / weights.sum()

    def choose_stimulus(self) -> float:
        """The stimulus of least expected entropy; of equal ones the weakest."""
        return float(self.x_db[int(np.argmin(np.round(self.expected_entropy(), 9)))])

    def expected_entropy(self) -> Array:
        """Entropy of the posterior after the answer to each stimulus (stimulus,), in nats, a mean over the answers."""
        entropy = np.zeros(len(self.x_db))
        for likelihood in (self._correct, 1 - self._correct):
            joint = self.posterior * likelihood
            share = joint.sum(axis=1)
            # Of p = joint / share the entropy is log(share) - sum(joint log joint) / share.
            logs = np.log(joint, out=np.zeros_like(joint), where=joint > 0)
            entropy += share * np.log(np.maximum(share, 1e-300)) - (joint * logs).sum(axis=1)
        return entropy

    def update(self, x_db: float, is_correct: bool) -> None:
        """Take an answer to one of the stimuli."""
        likelihood = self._correct[int(np.argmin(abs(self.x_db - x_db)))]
        joint = self.posterior * (likelihood if is_correct else 1 - likelihood)
        self.posterior = joint / joint.sum()
