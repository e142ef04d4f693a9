"""The runner of mutants: what it names is there, and a fault is killed."""

from pathlib import Path

import pytest

from tests.firmware_link.firmware.compiled_core import need
from tests.studies.trust.mutants import mutants_of
from tests.studies.trust.mutation import ROOT, TESTS, equivalents, run, summary


@pytest.mark.parametrize("path", TESTS)
def test_every_module_and_its_tests_are_there_and_no_name_stands_for_two_mutants(path: str) -> None:
    mutants = mutants_of(path, (ROOT / path).read_text(encoding="utf-8"))
    assert len({mutant.name for mutant in mutants}) == len(mutants) > 10
    assert all((ROOT / test).is_file() for test in TESTS[path])


def test_what_was_found_equivalent_is_still_there() -> None:
    names = {m.name for path in TESTS for m in mutants_of(path, (ROOT / path).read_text(encoding="utf-8"))}
    assert equivalents().keys() <= names


@pytest.mark.machine(stall_s=None)
def test_a_fault_is_killed_and_a_run_goes_on_where_it_was(tmp_path: Path) -> None:
    need("git")
    path = "engine/touch/placement.py"
    mutants = mutants_of(path, (ROOT / path).read_text(encoding="utf-8"))
    fault = next(mutant for mutant in mutants if "CLOSEST_M = 8e-3 [" in mutant.name and mutant.after == "0.0")
    results = tmp_path / "results.jsonl"
    assert run([fault], results, workers=1) == {fault.name: "killed"}
    before = results.read_text(encoding="utf-8")
    outcomes = run([fault], results, workers=1)
    assert results.read_text(encoding="utf-8") == before
    assert summary([fault], outcomes)["killed_of_those_not_equivalent"] == 1.0
