"""A quick run of every fuzzer; `python -m tests.studies.trust.fuzz WHAT --seconds 180` is the long one."""

import os
import random
import time
from pathlib import Path

import pytest

from engine.device import DeviceError
from tests.studies.trust.fuzz import FUZZED, Fuzzed, fuzz, outcome_of

CASES = {"table": 20, "device": 100, "rules": 200, "measurements": 40, "uff": 40, "page": 300}


# pyuff leaves the binary files that it writes open.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("what", CASES)
def test_whatever_others_write_is_taken_or_refused_by_its_family(what: str, tmp_path: Path) -> None:
    outcomes = [outcome_of(FUZZED[what], 1, number, tmp_path) for number in range(CASES[what])]
    assert set(outcomes) <= {"taken", "refused"} and "refused" in outcomes


def _fail(rng: random.Random, _folder: Path) -> None:
    kind = rng.randrange(4)
    if kind == 0:
        raise DeviceError("refused")
    if kind == 1:
        raise KeyError("a fault")
    if kind == 2:
        os._exit(11)
    if kind == 3:
        while time.monotonic():
            pass


@pytest.mark.machine(stall_s=None)
def test_wrong_errors_crashes_and_hangs_are_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    outcomes, faults = fuzz("uff", seed=1, first=2, count=3)
    assert not faults and outcomes["refused"] > 0 and outcomes.total() == 3
    monkeypatch.setitem(FUZZED, "device", Fuzzed(_fail, (DeviceError,)))
    monkeypatch.setattr("tests.studies.trust.fuzz.PATIENCE_S", 0.05)
    outcomes, faults = fuzz("device", seed=2, first=0, count=20)
    assert outcomes.total() == 20 and outcomes["fault"] == len(faults) == 20 - outcomes["refused"] > 0
    words = " ".join(faults.values())
    assert "KeyError: 'a fault'" in words and "exit status 11" in words and "TimeoutError" in words
