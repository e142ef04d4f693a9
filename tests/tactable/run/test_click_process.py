"""Laws of the process that solves clicks beside a loop: it answers with the table's own words, and may be lost."""

import os
import select
import signal
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from engine.device import Device
from engine.table import ClickEntry, Table
from engine.touch import Placement
from firmware_link.protocol.basis import encode_click
from precompute.builder.build import build_table
from precompute.clicks import ClickSolver
from precompute.clicks.columns import ClickTabulator
from tactable.run.click_process import ClickProcess
from tests.precompute.builder.test_build_clicks import CHEAP, DEVICE

pytestmark = pytest.mark.machine

PATIENCE_S = 120.0


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of a small device, with clicks of one finger."""
    path = tmp_path_factory.mktemp("clicks") / "bar.nc"
    build_table(DEVICE, path, created="", clicks_up_to=1, click_options=CHEAP)
    return path


@pytest.fixture(scope="module")
def process(path: Path) -> Iterator[ClickProcess]:
    with ClickProcess(path) as process:
        yield process


def answers(process: ClickProcess, count: int = 1) -> list[tuple[str, ClickEntry]]:
    found, end_s = list[tuple[str, ClickEntry]](), time.monotonic() + PATIENCE_S
    while len(found) < count and time.monotonic() < end_s:
        select.select([process], [], [], 1.0)
        found += process.poll()
    return found


def placements(path: Path, count: int) -> Sequence[Placement]:
    """Three fingers at places of the table, of which the last feels."""
    with Table.open(path) as table:
        return [table.places.placement(key) for key in ((0, 2, 5), (0, 2, 7), (0, 4, 7))[:count]]


def test_it_solves_what_is_asked_as_the_table_would_hold_it(path: Path, process: ClickProcess) -> None:
    (placement,) = placements(path, 1)
    process.ask(placement, DEVICE)
    ((fingerprint, click),) = answers(process)
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


def test_the_newest_question_is_answered_first(path: Path, process: ClickProcess) -> None:
    first, second, third = placements(path, 3)
    os.kill(process.process_id, signal.SIGSTOP)  # it finds all three questions at once, however busy the machine is
    for placement in (first, second, third):
        process.ask(placement, DEVICE)
    os.kill(process.process_id, signal.SIGCONT)
    assert [click.placement for _, click in answers(process, 3)] == [third, second, first]


def test_a_question_for_a_device_that_the_table_is_not_of_is_dropped(path: Path, process: ClickProcess) -> None:
    (placement,) = placements(path, 1)
    process.ask(placement, Device.parse(DEVICE.text.replace("phase_steps = 12", "phase_steps = 24"), "bar"))
    process.ask(placement, DEVICE)
    assert [fingerprint for fingerprint, _ in answers(process)] == [DEVICE.fingerprint]
    assert not process.poll()


def test_a_run_goes_on_when_it_dies(path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with ClickProcess(path) as process:
        (placement,) = placements(path, 1)
        process.ask(placement, DEVICE)
        assert answers(process)
        os.kill(process.process_id, signal.SIGKILL)
        select.select([process], [], [], PATIENCE_S)
        assert not process.poll() and not process.poll()
        process.ask(placement, DEVICE)
        assert not process.poll()
    assert "are no longer solved: the solving process has ended" in capfd.readouterr().err
