"""Child process that runs the engine for the page: fingers from a pipe, commands to a port, records to a ring.

It runs what `tactable run` runs. Orders come one after another from the page; each names table, port and switches, and
ends the run of the order before.
"""

from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from base.child import Parent
from engine.effects.rules import Drives
from engine.loop.loop import SystemClock
from engine.loop.ring import RingWriter
from engine.table import Table
from engine.touch.sources.pointer import PointerSource
from firmware_link.host.serial_port import ReopeningPort, SerialPort
from tactable.control.slot import ControlOf, ControlProcess
from tactable.page.choices import Choice, effects_of
from tactable.rig.rig import PTY_BIT_RATE_HZ
from tactable.run.click_process import ClickProcess
from tactable.run.live_run import Live, LiveOptions
from tactable.shipped import named_effects

IN_PLACE_NS = 800_000_000
"""Length of the steady drive that is played in place of a click until clicks are solved: it becomes steady."""
PATIENCE_NS = 300_000_000
"""On a busy machine a click takes longer than a finger should wait; a page shows it for seconds all the same."""


@dataclass(frozen=True)
class Order:
    """Order of the page to its engine: what to run."""

    table: Path
    port: str
    choice: Choice
    rule_file: Path | None
    has_kernels: bool  # whether the kernels of steady drives are compiled: without them drives are solved in NumPy
    is_first: bool  # whether the table is the first of a device: its clicks, if any, are solved as they are asked for


@dataclass(frozen=True)
class ProgramsAt:
    """Where programs reach the demo; the ports are as in tactable.control.slot.ControlOf."""

    socket: str
    port: int | None = None
    osc_port: int | None = None


class _NextOrder:
    """Stops a run when another order has come, or the page asks for the end."""

    def __init__(self, parent: Parent) -> None:
        self.is_set = parent.has_spoken


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Play orders until the page asks for the end; says a line for each run."""
    path, asked = Path(arguments["ring"]), arguments["programs"]
    slot: ControlProcess | None = None  # of all runs, so that programs stay connected, from the first run on
    with RingWriter(path) as ring, ExitStack() as stack:
        while (found := parent.read()) is not None:
            order = found["order"]
            if slot is not None:
                slot.change_run(order.table)
            elif asked is not None:
                of = ControlOf(Path(asked.socket), path, order.table, asked.port, asked.osc_port, is_watched=False)
                slot = stack.enter_context(ControlProcess(of))
            _run(order, arguments["pointer_pipe"], ring, slot, parent)


def _run(order: Order, pipe: int, ring: RingWriter, slot: ControlProcess | None, parent: Parent) -> None:
    """Play an order until the next one has come."""
    clock = SystemClock()
    with Table.open(order.table, verify=False) as table, ExitStack() as stack:
        effects = effects_of(order.choice, table.device, order.rule_file)
        if not table.best_rows:  # it has no sweep yet: drives are solved until a table comes that has one
            effects = replace(effects, drives=Drives.POSITIONS)
        if slot is not None:
            effects = replace(effects, others=tuple(named_effects().values()))
        has_several = table.clicks.finger_place.shape[1] > 1  # else all of several fingers are solved
        options = LiveOptions(
            effects,
            reconnect=True,
            bit_rate_hz=PTY_BIT_RATE_HZ,
            has_kernels=order.has_kernels,
            click_ns=IN_PLACE_NS if order.is_first or not has_several else None,
            patience_ns=PATIENCE_NS,
        )
        port = SerialPort(order.port)
        reopening = ReopeningPort(lambda: SerialPort(order.port), port)
        stack.callback(reopening.close)
        has_solver = order.has_kernels or order.is_first  # whose first click has compiled it
        solves_clicks = has_solver and table.clicks and effects.have_clicks
        solving = stack.enter_context(ClickProcess(order.table)) if solves_clicks else None
        source = PointerSource(pipe)
        live = Live(table, source, port, clock, options, ring, reopening=reopening, solving=solving, control=slot)
        lines = list[str]()  # what to print: where programs reach the first run
        if slot is not None:
            slot.begin_steps(live.capabilities)
            lines, slot.lines = slot.lines, []
        ring.begin_run(clock.now_ns())
        parent.say({"clicks": live.clicks, "lines": lines, "first_record": ring.written})
        live.run(_NextOrder(parent))
