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
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

from base.child import Child, ChildError, Parent, decode_line
from base.printable import printable
from engine.device import Device
from engine.table import ClickEntry, Table, TableError
from engine.touch import Placement
from firmware_link.protocol.basis import Basis

_READ_BYTES = 1 << 16
_NAME = "the solver of clicks"


class ClickProcess:
    """The child, as the loop asks it (engine.loop.ClickSolving)."""

    def __init__(self, table: Path, start: Callable[..., Child] = Child) -> None:
        self._child = start("tactable.run.click_process", {"table": str(table)}, name=_NAME)
        self._descriptor = self._child.fileno()
        os.set_blocking(self._descriptor, False)
        self.process_id = self._child.process_id
        self.is_there = False
        """Whether questions are answered: not before the child is ready, and not after its end."""
        self._received = bytearray()
        self._answers = Answers()

    def __enter__(self) -> "ClickProcess":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._child.kill()

    def fileno(self) -> int:
        """The descriptor that is readable when a part of a click has come."""
        return self._descriptor

    def ask_for_click(self, placement: Placement, device: Device) -> None:
        """Ask for the click of a placement; a question that finds no room is lost, as one that comes too late is."""
        if self.is_there:
            with contextlib.suppress(BlockingIOError):
                self._child.write(question_of(placement, device))

    def poll(self) -> Sequence[tuple[str, ClickEntry]]:
        """Read at most 64 KiB; the clicks that have come whole, each with the fingerprint of its device."""
        try:
            part = os.read(self._descriptor, _READ_BYTES)
        except BlockingIOError:
            return ()
        except ConnectionResetError:
            part = b""
        if not part:
            self._end()
        self._received += part
        *lines, rest = self._received.split(b"\n")
        self._received = bytearray(rest)
        return [solved for line in lines if (solved := self._solved(bytes(line))) is not None]

    def _solved(self, line: bytes) -> tuple[str, ClickEntry] | None:
        try:
            answer = decode_line(line, _NAME)
        except ChildError as error:
            _say(str(error))
            return None
        self.is_there = True
        return self._answers.decode(answer)

    def _end(self) -> None:
        """Replace the socket of a child that died by a silent one, so that the run goes on."""
        _say("clicks of more fingers than the table holds are no longer solved: the solving process has ended")
        self.is_there = False
        silent, self._kept_open = os.pipe()
        os.dup2(silent, self._descriptor)
        os.close(silent)
        os.set_blocking(self._descriptor, False)


def question_of(placement: Placement, device: Device) -> dict[str, Any]:
    """Question to the child."""
    return {"fingerprint": device.fingerprint, "at_m": placement.position_m, "is_felt": placement.is_felt}


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


class Asker(Protocol):
    """The side that asks: a `Parent`."""

    def has_spoken(self) -> bool:
        """Whether `read` would return at once."""

    def read(self) -> dict[str, Any] | None:
        """The next question; None at the end."""

    def say(self, document: dict[str, Any]) -> None:
        """Answer."""


class Solver:
    """Clicks for the device of one table."""

    def __init__(self, path: Path) -> None:
        from precompute.clicks import ClickSolver
        from precompute.clicks.of_table import read_click_options

        with Table.open(path, verify=False) as table:
            self.device, options = table.device, read_click_options(table).waited_for
        self.solver: ClickSolver = ClickSolver(self.device, options)

    def solve(self, placement: Placement) -> ClickEntry:
        """The click of fingers where they are."""
        return self.solver.solve_entry(placement)


class Service:
    """Answers questions of one loop."""

    def __init__(self, path: Path, parent: Asker) -> None:
        self._path, self._parent = path, parent
        self._solver: Solver | None = None
        self._told = set[int]()

    def run(self) -> None:
        """Answer until the parent closes its end."""
        self._open()
        if self._solver is None:  # the run learns that from the end of this process
            return
        # Its kernels are loaded, or compiled, before the first question.
        length_m = self._solver.device.bar.length_m
        self._solver.solve(Placement((0.2 * length_m, 0.5 * length_m, 0.8 * length_m), (True, True, False)))
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
            self._solver = Solver(self._path)
        except (TableError, OSError) as error:
            self._solver = None
            _say(f"clicks of more fingers than the table holds are not solved: {error}")

    def _answer(self, question: dict[str, Any]) -> None:
        if self._solver is None or self._solver.device.fingerprint != question["fingerprint"]:
            self._open()
        solver = self._solver
        if solver is None or solver.device.fingerprint != question["fingerprint"]:
            return
        click = solver.solve(Placement(tuple(question["at_m"]), tuple(question["is_felt"])))
        values = {field.name: getattr(click, field.name) for field in fields(click) if field.name != "basis"}
        answer = {"fingerprint": solver.device.fingerprint, "click": _packed(values), "basis_hash": click.basis.hash}
        if click.basis.hash not in self._told:
            self._told.add(click.basis.hash)
            answer["basis"] = _packed(click.basis)
        self._parent.say(answer)


def _packed(value: object) -> str:
    return base64.b64encode(pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)).decode()


def _say(text: str) -> None:
    sys.stderr.write(f"note: {printable(text)}\n")
    sys.stderr.flush()


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """The process behind a `ClickProcess`."""
    Service(Path(arguments["table"]), parent).run()
