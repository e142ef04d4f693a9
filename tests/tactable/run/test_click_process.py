"""Laws of the process that solves clicks beside a loop: it answers in the table's own words, and may be lost."""

import json
import socket
from pathlib import Path
from typing import Any

import pytest

from base.child import Parent
from engine.device import Device
from engine.table import ClickEntry, Table
from engine.touch import Placement
from precompute.builder.table_build import build_table
from precompute.clicks import ClickSolver
from tactable.run.click_process import Answers, ClickProcess, Service, question_of
from tests.small_device import small_text
from tests.tactable.click_table import CHEAP
from tests.tools.child_here import ChildHere, ParentHere

DEVICE = Device.parse(small_text(), "bar")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of a small device, with clicks of one finger."""
    path = tmp_path_factory.mktemp("clicks") / "bar.nc"
    build_table(DEVICE, path, created="", clicks_up_to=1, click_options=CHEAP)
    return path


class FakeParent(Parent):
    """Has asked all its questions already, and keeps the answers."""

    def __init__(self, *questions: dict[str, Any]) -> None:
        self._questions: list[dict[str, Any]] = list(questions)
        self.answers: list[dict[str, Any]] = []

    def has_spoken(self, timeout_s: float = 0.0) -> bool:  # noqa: ARG002  # a Parent
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


def three_fingers(felt_m: float = 0.201) -> Placement:
    """Fingers between places of the table."""
    return Placement.on(DEVICE, [felt_m], [0.03, 0.1])


def test_it_solves_the_newest_question_alone_for_the_fingers_where_they_are(path: Path) -> None:
    *older, placement = (three_fingers(felt_m) for felt_m in (0.201, 0.202, 0.203))
    ((fingerprint, click),) = answers(path, *((each, DEVICE) for each in (*older, placement)))
    assert fingerprint == DEVICE.fingerprint and click.placement == placement
    with Table.open(path) as table:
        assert table.clicks.basis is not None and click.basis.hash == table.clicks.basis.hash
    expected = ClickSolver(DEVICE, CHEAP.at_fingers).solve_entry(placement)
    assert (click.weights == expected.weights).all() and click.fraction_bits == expected.fraction_bits
    assert (click.felt, click.quiet, click.tolerance_m) == (expected.felt, expected.quiet, expected.tolerance_m)


def test_a_question_for_a_device_that_the_table_is_not_of_is_dropped(path: Path) -> None:
    other = Device.parse(DEVICE.text.replace("2700 kg", "2701 kg"), "bar")
    assert other.fingerprint != DEVICE.fingerprint
    assert not answers(path, (three_fingers(), other))


@pytest.mark.usefixtures("both_ends")
def test_a_run_goes_on_when_it_dies(path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    ours, theirs = socket.socketpair()
    placement = three_fingers()
    with theirs, ClickProcess(path, lambda *_, **__: ChildHere(ours)) as process:
        parent = ParentHere(theirs)
        assert not process.poll() and not process.is_there  # it loads its kernels
        parent.say({"is_ready": True})
        process.wait_until_ready()
        assert process.is_there
        process.ask_for_click(placement, DEVICE)
        service = Service(path, parent)
        service._answer(parent.read() or {})
        solved = list[tuple[str, ClickEntry]]()
        while not solved:
            solved += process.poll()
        assert [click.placement for _, click in solved] == [placement]
        theirs.close()
        assert not process.poll() and not process.poll() and not process.is_there
        process.wait_until_ready()  # not for ever
        process.ask_for_click(placement, DEVICE)
        assert not process.poll()
    assert capfd.readouterr().err.count("are no longer solved: the solving process has ended") == 1
