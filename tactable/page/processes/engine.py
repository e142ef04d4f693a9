"""The engine as a process of its own: fingers of a page by a pipe, commands to a port, the ring for who looks on.

It runs what `tactable run` runs. One process plays one order after another: a line of JSON on standard input names
table, port and switches, and ends the run before.
"""

import json
import select
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from engine.device import DeviceError
from engine.effects import EffectError
from engine.loop.loop import SystemClock
from engine.loop.ring import RingError, RingWriter
from engine.render.limits import LimitError
from engine.render.renderer import RendererError, WhenNotAchieved
from engine.table import Table, TableError
from engine.touch import DescriptorError, DigitizerError
from engine.touch.sources.pointer import PointerSource
from firmware_link.host.reopening import ReopeningPort
from firmware_link.host.serial_port import SerialPort
from firmware_link.protocol.errors import LinkError
from tactable.page.choices import Choice, effects_of
from tactable.rig.rig import PTY_BIT_RATE_HZ
from tactable.run.live import Live, LiveOptions

_FAMILIES = (
    DescriptorError,
    DeviceError,
    DigitizerError,
    EffectError,
    LimitError,
    LinkError,
    OSError,
    RendererError,
    RingError,
    TableError,
)


@dataclass(frozen=True)
class Order:
    """What to run."""

    table: Path
    port: str
    choice: Choice
    rule_file: Path | None

    def line(self) -> bytes:
        """For standard input."""
        rule_file = None if self.rule_file is None else str(self.rule_file)
        order = {"table": str(self.table), "port": self.port, "choice": self.choice.as_json(), "rule_file": rule_file}
        return json.dumps(order).encode() + b"\n"


def decode_order(line: str) -> Order:
    """The order of a line."""
    order = json.loads(line)
    rule_file = None if order["rule_file"] is None else Path(order["rule_file"])
    return Order(Path(order["table"]), order["port"], Choice.from_json(order["choice"]), rule_file)


def command_of(pointer_pipe: int, ring: Path) -> list[str]:
    """The command line of such a process; it inherits the pipe."""
    return [sys.executable, "-m", "tactable.page.processes.engine", str(pointer_pipe), str(ring)]


class _NextOrder:
    """Ends a run when another order has come, or none will come any more."""

    def is_set(self) -> bool:
        """Whether to end."""
        return bool(select.select((sys.stdin,), (), (), 0)[0])


def main() -> None:
    """Play orders until standard input ends; tell each run and each change, and the error that ends it all."""
    pipe, ring_path = int(sys.argv[1]), Path(sys.argv[2])
    try:
        # Unbuffered: `select` must see what is not read yet.
        with RingWriter(ring_path) as ring, open(sys.stdin.fileno(), "rb", buffering=0, closefd=False) as orders:
            while line := orders.readline():
                _run(decode_order(line.decode()), pipe, ring)
    except _FAMILIES as error:
        _say({"error": str(error)})
        raise SystemExit(1) from None


def _run(order: Order, pipe: int, ring: RingWriter) -> None:
    clock = SystemClock()
    with Table.open(order.table, verify=False) as table, ExitStack() as stack:
        effects = effects_of(order.choice, table.device, order.rule_file)
        options = LiveOptions(effects, WhenNotAchieved.GO_ON, reconnect=True, bit_rate_hz=PTY_BIT_RATE_HZ)
        port = SerialPort(order.port)
        reopening = ReopeningPort(lambda: SerialPort(order.port), port)
        stack.callback(reopening.close)
        live = Live(table, PointerSource(pipe), port, clock, options, reopening=reopening, ring=ring)
        _say({"clicks": live.clicks, "shortfalls": sum(live.renderer.shortfalls.values())})
        live.run(_NextOrder())


def _say(document: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(document) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
