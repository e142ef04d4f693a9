"""Solves clicks that no table holds, in a child process beside a running loop.

A click takes some milliseconds, which the loop must not spend, and a grid of places for three fingers would be too
coarse to be felt. So the loop asks the child for the fingers where they are and goes on. The child solves the newest
question and drops the older ones, whose touches wait no more. A table that was replaced meanwhile is opened again; a
question for a device that the file does not hold is dropped. If the child dies, the run goes on without it.
"""

import base64
import contextlib
import os
import pickle
import select
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from base.child import Child, ChildError, Parent, decode_line
from base.files import identity_of
from base.points import json_of, point_of_json
from base.printable import write_note
from engine.device import Device
from engine.table import ClickEntry, Table, TableError
from engine.touch import Placement
from firmware_link.protocol.basis import Basis
from tactable.run.beside_loop import BesideLoop

if TYPE_CHECKING:  # its kernels belong to the child alone
    from precompute.clicks import ClickSolver

_NAME = "the solver of clicks"


class ClickProcess(BesideLoop):
    """The child, as the loop asks it (engine.loop.beside.ClickSolving)."""

    def __init__(self, table: Path, start: Callable[..., Child] = Child) -> None:
        super().__init__("tactable.run.click_process", {"table": str(table)}, _NAME, start)
        os.set_blocking(self._descriptor, False)
        self.is_there = False  # whether questions are answered: not before the child is ready, and not after its end
        self._has_ended = False
        self._answers = Answers()

    def wait_until_ready(self) -> None:
        """Wait until questions are answered, or the child has ended: for a replay, which can begin later."""
        while not (self.is_there or self._has_ended):
            select.select([self._descriptor], [], [])
            self.poll()

    def ask_for_click(self, placement: Placement, device: Device) -> None:
        """Ask for the click of a placement; a question that finds no room is lost, as one that comes too late is."""
        if self.is_there:
            with contextlib.suppress(BlockingIOError):
                self._child.write(question_of(placement, device))

    def poll(self) -> Sequence[tuple[str, ClickEntry]]:
        """Read at most 64 KiB; the clicks that have come whole, each with the fingerprint of its device."""
        lines = self._read_lines()
        if lines is None:
            self.is_there, self._has_ended = False, True
            self._fall_silent("clicks of more fingers than the table holds are no longer solved: the process has ended")
            return ()
        return [solved for line in lines if (solved := self._solved(line)) is not None]

    def _solved(self, line: bytes) -> tuple[str, ClickEntry] | None:
        try:
            answer = decode_line(line, _NAME)
        except ChildError as error:
            write_note(str(error))
            return None
        self.is_there = True
        return self._answers.decode(answer)


def question_of(placement: Placement, device: Device) -> dict[str, Any]:
    """Question to the child."""
    return {
        "fingerprint": device.fingerprint,
        "at_m": [*map(json_of, placement.position_m)],
        "is_felt": placement.is_felt,
    }


class Answers:
    """Decodes what the child says: clicks, and once each basis that they refer to."""

    def __init__(self) -> None:
        self._bases: dict[int, Basis] = {}

    def decode(self, answer: Mapping[str, Any]) -> tuple[str, ClickEntry] | None:
        """A click and the fingerprint of its device; None for a line that has none."""
        if "click" not in answer:  # it says that it is ready
            return None
        values = pickle.loads(base64.b64decode(answer["click"]))  # from our own process
        if "basis" in answer:
            self._bases[answer["basis_hash"]] = pickle.loads(base64.b64decode(answer["basis"]))
        return answer["fingerprint"], ClickEntry(basis=self._bases[answer["basis_hash"]], **values)


def solver_of(table_path: Path) -> "ClickSolver":
    """The solver of clicks in the basis of a table, with the options of clicks that a touch waits for."""
    from precompute.clicks import ClickSolver
    from precompute.clicks.click_options import read_click_options

    with Table.open(table_path, verify=False) as table:
        return ClickSolver(table.device, read_click_options(table).waited_for, table.clicks.basis)


class Service:
    """Answers questions of one loop."""

    def __init__(self, path: Path, parent: Parent) -> None:
        self._path, self._parent = path, parent
        self._solver: ClickSolver | None = None
        self._told = set[int]()

    def run(self) -> None:
        """Answer until the parent closes its end."""
        self._open()
        if self._solver is None:  # the run learns that from the end of this process
            return
        # Its kernels are loaded, or compiled, before the first question.
        corner_m = self._solver.device.surface.corner_m
        self._solver.solve(Placement((0.2 * corner_m, 0.5 * corner_m, 0.8 * corner_m), (True, True, False)))
        self._parent.say({"is_ready": True})
        while (question := self._parent.read()) is not None:
            while self._parent.has_spoken():
                newer = self._parent.read()
                if newer is None:
                    return
                question = newer
            self._answer(question)

    def _open(self) -> None:
        try:
            self._identity = identity_of(self._path)
            self._solver = solver_of(self._path)
        except (TableError, OSError) as error:
            self._solver = None
            write_note(f"clicks of more fingers than the table holds are not solved: {error}")

    def _answer(self, question: dict[str, Any]) -> None:
        with contextlib.suppress(OSError):  # it is being replaced
            if self._solver is None or identity_of(self._path) != self._identity:
                self._open()
        solver = self._solver
        if solver is None or solver.device.fingerprint != question["fingerprint"]:
            return
        click = solver.solve(Placement(tuple(map(point_of_json, question["at_m"])), tuple(question["is_felt"])))
        values = {field.name: getattr(click, field.name) for field in fields(click) if field.name != "basis"}
        answer = {"fingerprint": solver.device.fingerprint, "click": _packed(values), "basis_hash": click.basis.hash}
        if click.basis.hash not in self._told:
            self._told.add(click.basis.hash)
            answer["basis"] = _packed(click.basis)
        self._parent.say(answer)


def _packed(value: object) -> str:
    return base64.b64encode(pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)).decode()


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """The process behind a `ClickProcess`."""
    Service(Path(arguments["table"]), parent).run()
