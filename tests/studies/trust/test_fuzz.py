"""A quick run of every fuzzer; `python -m tests.studies.trust.fuzz WHAT --seconds 180` is the long one."""

import os
import random
import time
from pathlib import Path

import pytest

from engine.device import DeviceError
from tests.studies.trust.fuzz import FUZZED, Fuzzed, fuzz

# A NetCDF file is read in a process of its own, which takes half a second to start: with the long tests. Quick is
# tests/precompute/measurements/test_netcdf.py.
CASES = {"table": 20, "device": 100, "rules": 200, "measurements": 40, "netcdf": 8, "uff": 40, "page": 300}


@pytest.mark.machine
@pytest.mark.parametrize(
    "what", [pytest.param(each, marks=[pytest.mark.long] if each == "netcdf" else []) for each in FUZZED]
)
def test_whatever_others_write_is_taken_or_refused_by_its_family(what: str) -> None:
    outcomes, faults = fuzz(what, seed=1, first=0, count=CASES[what])
    assert not faults
    assert outcomes["refused"] > 0 and outcomes.total() == CASES[what]


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


@pytest.mark.machine
def test_wrong_errors_crashes_and_hangs_are_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(FUZZED, "device", Fuzzed(_fail, (DeviceError,)))
    monkeypatch.setattr("tests.studies.trust.fuzz.PATIENCE_S", 0.05)
    outcomes, faults = fuzz("device", seed=2, first=0, count=20)
    assert outcomes.total() == 20 and outcomes["fault"] == len(faults) == 20 - outcomes["refused"] > 0
    words = " ".join(faults.values())
    assert "KeyError: 'a fault'" in words and "exit status 11" in words and "TimeoutError" in words
