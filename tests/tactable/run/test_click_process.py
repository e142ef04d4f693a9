"""Laws of the process that solves clicks beside a loop: it answers in the table's own words, and may be lost."""

import json
import shutil
import socket
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from base.child import Parent
from engine.device import Device
from engine.table import ClickEntry, Table
from engine.touch import Placement
from firmware_link.protocol.basis import Basis
from precompute.builder.table_build import build_table
from precompute.clicks import ClickOptions, ClickSolver
from precompute.clicks.click_basis import click_basis
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
    parent, decoder = FakeParent(*(question_of(*each) for each in asked)), Answers()
    Service(path, parent).run()
    return [found for answer in parent.answers if (found := decoder.decode(json.loads(json.dumps(answer)))) is not None]


def three_fingers(felt_m: float = 0.201) -> Placement:
    return Placement.on(DEVICE, [felt_m], [0.03, 0.1])


def test_it_solves_the_newest_question_alone_for_the_fingers_where_they_are(path: Path) -> None:
    *older, placement = (three_fingers(felt_m) for felt_m in (0.201, 0.202, 0.203))
    ((fingerprint, click),) = answers(path, *((each, DEVICE) for each in (*older, placement)))
    assert fingerprint == DEVICE.fingerprint and click.placement == placement
    with Table.open(path) as table:
        assert table.clicks.basis is not None and click.basis.hash == table.clicks.basis.hash
    expected = ClickSolver(DEVICE, CHEAP.at_fingers).solve(placement)
    assert (click.weights == expected.weights).all() and click.fraction_bits == expected.fraction_bits
    assert (click.felt, click.quiet, click.tolerance_m) == (expected.felt, expected.quiet, expected.tolerance_m)


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The table as another machine makes it: functions are singular vectors, whose signs differ between processors."""

    def other_signs(device: Device, options: ClickOptions) -> Basis:
        basis = click_basis(device, options)
        functions = basis.sets[0].functions.copy()
        functions[::2] *= -1
        return replace(basis, sets=(replace(basis.sets[0], functions=functions),))

    path = tmp_path_factory.mktemp("elsewhere") / "bar.nc"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("precompute.clicks.click_solver.click_basis", other_signs)
        build_table(DEVICE, path, created="", clicks_up_to=1, click_options=CHEAP)
    return path


def test_its_weights_are_of_the_basis_of_a_table_that_another_machine_made(path: Path, elsewhere: Path) -> None:
    placement = three_fingers()
    ((_, here),), ((_, there),) = answers(path, (placement, DEVICE)), answers(elsewhere, (placement, DEVICE))
    assert there.basis.hash != here.basis.hash and (there.weights != here.weights).any()
    assert there.waveform == pytest.approx(here.waveform, abs=0.01)


def test_a_table_that_takes_the_place_of_another_is_opened(path: Path, elsewhere: Path, tmp_path: Path) -> None:
    mine, placement, parent, decoder = tmp_path / "bar.nc", three_fingers(), FakeParent(), Answers()
    shutil.copy(path, mine)
    service = Service(mine, parent)
    service.run()
    shutil.copy(elsewhere, mine)
    service._answer(question_of(placement, DEVICE))
    *_, (_, click) = filter(None, map(decoder.decode, parent.answers))
    with Table.open(mine, verify=False) as table:
        assert table.clicks.basis is not None and click.basis.hash == table.clicks.basis.hash


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
    assert capfd.readouterr().err.count("are no longer solved: the process has ended") == 1
