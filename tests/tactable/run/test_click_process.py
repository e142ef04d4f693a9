"""Laws of the process that solves clicks beside a loop: it answers with the table's own words, and may be lost."""

import json
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from engine.device import Device
from engine.table import ClickEntry, Table
from engine.touch import Placement
from firmware_link.protocol.basis import encode_click
from precompute.builder.build import build_table
from precompute.clicks import ClickSolver
from precompute.clicks.columns import ClickTabulator
from tactable.run.click_process import Answers, ClickProcess, Service, question_of
from tests.precompute.builder.test_build_clicks import CHEAP, DEVICE
from tests.tools.child_here import ChildHere, ParentHere


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of a small device, with clicks of one finger."""
    path = tmp_path_factory.mktemp("clicks") / "bar.nc"
    build_table(DEVICE, path, created="", clicks_up_to=1, click_options=CHEAP)
    return path


class FakeParent:
    """Has asked all its questions already, and keeps the answers."""

    def __init__(self, *questions: dict[str, Any]) -> None:
        self._questions: list[dict[str, Any]] = list(questions)
        self.answers: list[dict[str, Any]] = []

    def has_spoken(self) -> bool:
        return bool(self._questions)

    def read(self) -> dict[str, Any] | None:
        return self._questions.pop(0) if self._questions else None

    def say(self, document: dict[str, Any]) -> None:
        self.answers.append(document)


def answers(path: Path, *asked: tuple[Placement, Device]) -> list[tuple[str, ClickEntry]]:
    """What the process answers to questions that wait for it."""
    parent, decoder = FakeParent(*(question_of(*each) for each in asked)), Answers()
    Service(path, parent).run()
    return [found for answer in parent.answers if (found := decoder.decode(json.loads(json.dumps(answer)))) is not None]


def placements(path: Path, count: int) -> Sequence[Placement]:
    """Three fingers at places of the table, of which the last feels."""
    with Table.open(path) as table:
        return [table.places.placement(key) for key in ((0, 2, 5), (0, 2, 7), (0, 4, 7))[:count]]


def test_it_solves_what_is_asked_as_the_table_would_hold_it(path: Path) -> None:
    (placement,) = placements(path, 1)
    ((fingerprint, click),) = answers(path, (placement, DEVICE))
    assert fingerprint == DEVICE.fingerprint and click.placement == placement
    with Table.open(path) as table:
        options = CHEAP.at(table.places).quick
        assert table.clicks.basis is not None and click.basis.hash == table.clicks.basis.hash
        assert click.tolerance_m == table.clicks.tolerance_m
    expected = ClickTabulator(DEVICE, options).tabulate(ClickSolver(DEVICE, options).solve(placement))
    assert encode_click(click.basis, click.basis_set, click.weights.tolist(), click.fraction_bits) == encode_click(
        expected.basis, expected.basis_set, expected.weights.tolist(), expected.fraction_bits
    )
    assert (click.felt, click.quiet) == (expected.felt, expected.quiet)


def test_the_newest_question_is_answered_first(path: Path) -> None:
    first, second, third = placements(path, 3)
    found = answers(path, *((placement, DEVICE) for placement in (first, second, third)))
    assert [click.placement for _, click in found] == [third, second, first]


def test_a_question_for_a_device_that_the_table_is_not_of_is_dropped(path: Path) -> None:
    (placement,) = placements(path, 1)
    other = Device.parse(DEVICE.text.replace("2700 kg", "2701 kg"), "bar")
    assert other.fingerprint != DEVICE.fingerprint
    assert [fingerprint for fingerprint, _ in answers(path, (placement, DEVICE), (placement, other))] == [
        DEVICE.fingerprint
    ]


@pytest.mark.usefixtures("both_ends")
def test_a_run_goes_on_when_it_dies(path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    ours, theirs = socket.socketpair()
    (placement,) = placements(path, 1)
    with theirs, ClickProcess(path, lambda *_, **__: ChildHere(ours)) as process:
        assert not process.poll()
        process.ask_for_click(placement, DEVICE)
        parent = ParentHere(theirs)
        service = Service(path, parent)
        service._answer(parent.read() or {})
        solved = list[tuple[str, ClickEntry]]()
        while not solved:
            solved += process.poll()
        assert [click.placement for _, click in solved] == [placement]
        theirs.close()
        assert not process.poll() and not process.poll()
        process.ask_for_click(placement, DEVICE)
        assert not process.poll()
    assert capfd.readouterr().err.count("are no longer solved: the solving process has ended") == 1
