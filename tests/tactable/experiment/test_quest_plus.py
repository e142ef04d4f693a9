"""QUEST+: by hand on a small grid, and its function's laws."""

import math

import numpy as np
import pytest

from tactable.experiment import quest_plus
from tactable.experiment.quest_plus import QuestPlus, probability_correct


def entropy(p: list[float]) -> float:
    return -sum(each * math.log(each) for each in p)


def test_entropy_and_choice_are_those_computed_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two thresholds, 0 and 20 dB, slope 1, no lapses; stimuli at 0 and 10 dB."""
    monkeypatch.setattr(quest_plus, "SLOPES", (1.0,))
    monkeypatch.setattr(quest_plus, "SLOPE_WEIGHTS", (1.0,))
    monkeypatch.setattr(quest_plus, "LAPSES", (0.0,))
    monkeypatch.setattr(quest_plus, "threshold_grid", lambda *_: np.array([0.0, 20.0]))
    track = QuestPlus(np.array([0.0, 10.0]))
    # F = 1 - 2^-(10^((x - t) / 20)); right in F + (1 - F) / 2.
    right = [[0.5 + 0.5 * (1 - 2**-ratio) for ratio in ratios] for ratios in ((1.0, 0.1), (10**0.5, 10**-0.5))]
    assert right[0] == pytest.approx([0.75, 0.5334836], abs=1e-6)
    expected = []
    for one, other in right:
        share = (one + other) / 2
        after_right, after_wrong = one / (one + other), (1 - one) / (2 - one - other)
        hit, miss = entropy([after_right, 1 - after_right]), entropy([after_wrong, 1 - after_wrong])
        expected.append(share * hit + (1 - share) * miss)
    np.testing.assert_allclose(track.expected_entropy(), expected, rtol=1e-9)
    assert track.choose_stimulus() == [0.0, 10.0][expected.index(min(expected))]
    track.update(0.0, is_correct=True)
    np.testing.assert_allclose(track.posterior, [right[0][0] / sum(right[0]), right[0][1] / sum(right[0])])


def test_at_its_threshold_half_is_detected_and_a_lapse_is_a_guess() -> None:
    assert probability_correct(7.0, 7.0, 3.0, 0.0, 0.5) == pytest.approx(0.75)
    assert probability_correct(7.0, 7.0, 3.0, 0.0, 0.0) == pytest.approx(0.5)
    assert probability_correct(80.0, 7.0, 3.0, 0.1, 0.5) == pytest.approx(0.95)
    assert probability_correct(80.0, 7.0, 3.0, 0.1, 0.5, has_stimulus=False) == pytest.approx(0.5)


def test_right_answers_lead_down_and_wrong_ones_up() -> None:
    for is_correct, end in ((True, -10.0), (False, 20.0)):
        track = QuestPlus(np.arange(-10.0, 21.0))
        for _ in range(30):
            track.update(track.choose_stimulus(), is_correct)
        assert abs(track.choose_stimulus() - end) <= 6
