"""Sessions: counterbalanced, drawn by the seed, resumed from their file, adaptive; wrong protocols are refused."""

import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from base.errors import TactableError
from tactable.experiment import quest_plus
from tactable.experiment.observer import Observer, answer_all
from tactable.experiment.protocol import ExperimentError, Kind, parse_protocol, protocol_names, read_protocol
from tactable.experiment.quest_plus import QuestPlus, probability_correct
from tactable.experiment.session import Role, Session, Stimulus, Trial, stimuli_of
from tactable.experiment.trial_files import SessionFiles
from tactable.shipped import find_device

DEVICE = find_device("reference-a")
TEXT = """
name = "x"
seed = 3
[[task]]
name = "a"
kind = "masked"
fingers = ["170 mm", "45 mm"]
base = "12 dB"
levels = ["-12 dB", "12 dB"]
gap = "80 ms"
trials = 10
catch = 4
[[task]]
name = "b"
kind = "which-finger"
fingers = ["45 mm", "170 mm"]
levels = ["-12 dB", "12 dB"]
trials = 10
"""
PROTOCOL = parse_protocol(TEXT, "x.toml", DEVICE)


def all_trials(session: Session, answer: int = 0) -> list[Trial]:
    found = []
    while (trial := session.next_trial()) is not None:
        found.append(trial)
        session.record(trial, answer)
    return found


def test_fingers_and_sides_are_counterbalanced_and_practice_comes_first() -> None:
    trials = all_trials(Session(PROTOCOL, "01"))
    tests = [trial for trial in trials if trial.role is Role.TEST]
    sides = Counter((trial.task.name, trial.finger, trial.side) for trial in tests)
    assert sides == {**{("a", f, s): 5 for f in range(2) for s in range(2)}, ("b", 0, 0): 10, ("b", 1, 1): 10}
    for task in PROTOCOL.tasks:
        roles = [trial.role for trial in trials if trial.task is task]
        assert roles[:4] == [Role.PRACTICE] * 4 and Role.PRACTICE not in roles[4:]
        assert roles.count(Role.CATCH) == 4 and roles[4:8] != [Role.CATCH] * 4


def test_the_order_is_that_of_participant_and_seed() -> None:
    def order(participant: str) -> list[tuple[object, ...]]:
        return [trial[1:5] for trial in all_trials(Session(PROTOCOL, participant))]

    assert order("01") == order("01") != order("02")


def test_a_masked_trial_has_the_masking_click_in_both_intervals_and_its_own_after_it_in_one() -> None:
    task = PROTOCOL.tasks[0]
    assert task.kind is Kind.MASKED and task.position_m == (0.045, 0.17)
    masking = Stimulus(1, 12.0)
    trial = Trial(0, task, Role.TEST, 0, 1, 3.0)
    assert stimuli_of(trial) == [[masking], [masking, Stimulus(0, 3.0, 0.08)]]
    assert stimuli_of(trial._replace(role=Role.CATCH, level_db=None)) == [[masking], [masking]]


def test_a_session_goes_on_from_its_file_wherever_it_was_cut_off(tmp_path: Path) -> None:
    whole = SessionFiles.of(tmp_path / "whole", PROTOCOL, "01")
    whole.begin(PROTOCOL, "01", DEVICE, "", is_simulated=True)
    answer_all(Session(PROTOCOL, "01"), Observer(), keep=whole.append)
    text = whole.path("beh.csv").read_bytes()
    for end in (10, 300, len(text) // 2, len(text) - 1, len(text)):
        cut = SessionFiles.of(tmp_path / str(end), PROTOCOL, "01")
        cut.begin(PROTOCOL, "01", DEVICE, "", is_simulated=True)
        cut.path("beh.csv").write_bytes(text[:end])
        session = Session(PROTOCOL, "01")
        rows, dropped = cut.resume(session)
        assert len(rows) == session.done and bool(dropped) == (text[end - 1 : end] != b"\n")
        answer_all(session, Observer(), keep=cut.append)
        assert cut.path("beh.csv").read_bytes() == text


def test_a_file_of_another_protocol_or_participant_is_refused(tmp_path: Path) -> None:
    files = SessionFiles.of(tmp_path, PROTOCOL, "01")
    files.begin(PROTOCOL, "01", DEVICE, "", is_simulated=True)
    answer_all(Session(PROTOCOL, "01"), Observer(), keep=files.append)
    with pytest.raises(ExperimentError, match="is not trial"):
        files.resume(Session(PROTOCOL, "02"))
    longer = parse_protocol(TEXT.replace("trials = 10", "trials = 12"), "x.toml", DEVICE)
    with pytest.raises(ExperimentError, match=r"Protocol is another one .* --output"):
        files.begin(longer, "01", DEVICE, "", is_simulated=True)
    with pytest.raises(ExperimentError, match="Simulated is another one"):
        files.begin(PROTOCOL, "01", DEVICE, "", is_simulated=False)
    with pytest.raises(ExperimentError, match="and no name"):
        SessionFiles.of(tmp_path, PROTOCOL, "Jane Doe")


@pytest.mark.parametrize(
    ("line", "other", "said"),
    [
        ('kind = "masked"', 'kind = "mask"', r"x.toml: task\[1\].kind: 'mask': expected one of detection"),
        ('gap = "80 ms"', 'gap = "1 ms"', "gap: '1 ms': expected at least 0.03 s"),
        ('base = "12 dB"', 'base = "90 dB"', "base: '90 dB': expected -20 to 80 dB"),
        ('base = "12 dB"', 'base = "12 dB"\nstimulus = "tone"', "a tone would end the click before it"),
        ('"45 mm"]\nbase', '"172 mm"]\nbase', "closer than 8 mm"),
        ('"170 mm", "45 mm"]', '"170 mm"]', "expected two places"),
        ('["-12 dB", "12 dB"]\ngap', '["12 dB", "-12 dB"]\ngap', "the lowest first"),
        ('name = "b"', 'name = "a"', "two tasks have this name"),
        ("seed = 3", "sead = 3", "did you mean 'seed'"),
    ],
)
def test_a_wrong_protocol_is_refused_by_key_and_value(line: str, other: str, said: str) -> None:
    assert TEXT.count(line) == 1
    with pytest.raises(TactableError, match=said):
        parse_protocol(TEXT.replace(line, other), "x.toml", DEVICE)


def test_the_shipped_protocols_are_read_and_an_unknown_one_names_them() -> None:
    assert protocol_names() == ["felt-and-quiet", "threshold-curve"]
    for name in protocol_names():
        assert read_protocol(name, DEVICE).name == name
    with pytest.raises(ExperimentError, match="shipped are felt-and-quiet, threshold-curve"):
        read_protocol("nothing", DEVICE)


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
