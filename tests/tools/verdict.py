"""A pytest plugin: a test of the real machine holds, is broken, or is not shown.

A law with a real clock may fail because the machine stood still, which says nothing of the law. While a test marked
`machine` runs, a thread looks for evidence of that: the thread itself came late though its process did not compute, or
a process that the test started was stopped, or waited for a processor, longer than the test tolerates (`STALL_S`, or
`@pytest.mark.machine(stall_s=0.02)`). What the test itself stops is no evidence. A law that speaks of no time, such as
what a document or a command prints, is marked `@pytest.mark.machine(stall_s=None)`: no stall excuses its failure.

A test that fails without evidence is broken: the fault was seen on a machine that ran. One that fails with evidence
runs again, with fresh fixtures, up to three times. Where none of the three was quiet, its law is *not shown*: that does
not fail the check, and is listed at its end with how it failed last and what stood still. A law that is not shown in
three checks in a row is a fault of the test, and fails: the counts are in `~/.local/state/tactable/not_shown.json`
(`XDG_STATE_HOME`).
"""

import contextlib
import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest
from _pytest.runner import runtestprotocol

from tests.tools.stalls import STALL_S, hear_of_stops, watched

ATTEMPTS = 3
CHECKS_IN_A_ROW = 3


def pytest_configure(config: pytest.Config) -> None:
    """Name the marker, and hear of stops once a process: an audit hook cannot be taken back."""
    config.addinivalue_line(
        "markers",
        "machine(stall_s): a process, port, signal, browser, guest or real time; `-n 0 -m machine` runs these, "
        "and a longer stall excuses a failure; with stall_s=None, of a law that speaks of no time, none does",
    )
    if not hasattr(sys, "_tactable_hears_stops"):
        sys._tactable_hears_stops = True  # type: ignore[attr-defined]
        sys.addaudithook(hear_of_stops)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a test of the real machine until an attempt counts."""
    marker = item.get_closest_marker("machine")
    if marker is None:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for report in _judged(item, nextitem, marker.kwargs.get("stall_s", STALL_S)):
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _judged(item: pytest.Item, nextitem: pytest.Item | None, limit_s: float | None) -> list[pytest.TestReport]:
    if limit_s is None:
        return runtestprotocol(item, log=False, nextitem=nextitem)
    told = list[str]()
    for _ in range(ATTEMPTS):
        if told:  # what a stall broke is made again, the fixtures of the module too
            with contextlib.suppress(Exception):
                item.session._setupstate.teardown_exact(None)
        with watched(limit_s) as evidence:
            reports = runtestprotocol(item, log=False, nextitem=nextitem)
        if not any(report.failed for report in reports) or not evidence:
            count_not_shown(item.nodeid, is_not_shown=False)
            return reports
        told.append(f"{_failure_of(reports)}; {evidence}")
    if count_not_shown(item.nodeid, is_not_shown=True) >= CHECKS_IN_A_ROW:
        text = f"not shown in {CHECKS_IN_A_ROW} checks in a row, which is a fault of the test: {told[-1]}"
        reports[-1].sections.append(("Verdict", text))
        return reports
    report = reports[-1]
    report.outcome, report.longrepr = "passed", None
    report.not_shown = told[-1]  # type: ignore[attr-defined]
    return [report]


def _failure_of(reports: list[pytest.TestReport]) -> str:
    """Where and how an attempt failed, in a line."""
    crash = next((getattr(report.longrepr, "reprcrash", None) for report in reports if report.failed), None)
    return "failed" if crash is None else f"{Path(crash.path).name}:{crash.lineno}: {crash.message.splitlines()[0]}"


def count_not_shown(test: str, *, is_not_shown: bool) -> int:
    """In how many checks in a row, this one with them, a law was not shown."""
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "tactable" / "not_shown.json"
    counts: dict[str, int] = json.loads(state.read_text(encoding="utf-8")) if state.exists() else {}
    before = counts.pop(test, 0)
    if is_not_shown:
        counts[test] = before + 1
    if is_not_shown or before:
        state.parent.mkdir(parents=True, exist_ok=True)
        state.write_text(json.dumps(counts, indent=1), encoding="utf-8")
    return counts.get(test, 0)


def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, str] | None:
    """The third verdict has a letter and a count of its own."""
    return ("not shown", "N", "NOT SHOWN") if getattr(report, "not_shown", "") else None


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """What is not shown, with its evidence, and how many laws of the real machine have which verdict."""

    def tests(*categories: str) -> list[Any]:
        reports = [report for name in categories for report in terminalreporter.stats.get(name, [])]
        return [report for report in reports if "machine" in getattr(report, "keywords", ())]

    not_shown, holds, broken = tests("not shown"), tests("passed"), tests("failed", "error")
    for report in not_shown:
        terminalreporter.write_line(f"NOT SHOWN {report.nodeid} - {report.not_shown}")
    if not_shown or holds or broken:
        terminalreporter.write_line(
            f"real machine: {len(holds)} holds, {len(not_shown)} not shown, {len(broken)} broken"
        )
