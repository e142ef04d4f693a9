"""The engine of the control bench, a child process: a run with a control channel, on the sockets that it is given."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from base.child import Parent
from base.plain import to_plain
from engine.effects.rules import DEFAULT_EFFECTS
from engine.loop.loop import SystemClock
from engine.table import Table
from firmware_link.host.descriptor_port import DescriptorPort
from tactable.bench.latency.conditions import PTY_BIT_RATE_HZ
from tactable.bench.latency.sockets import SocketSource
from tactable.control.slot import ControlOf, ControlProcess
from tactable.run.live_run import Live, LiveOptions, fast_library, ring_for
from tactable.shipped import named_effects


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Say where programs reach the run, run until the touches end, and say what was counted."""
    path = Path(arguments["table"])
    effects = replace(DEFAULT_EFFECTS, others=tuple(named_effects().values()))
    descriptor, numbers = bytes.fromhex(arguments["descriptor"]), (arguments["vendor_id"], arguments["product_id"])
    source = SocketSource(arguments["touch"], descriptor, numbers, arguments["reports"])
    with (
        tempfile.TemporaryDirectory(prefix="tactable-") as folder,
        ring_for(None, is_needed=True) as ring,
        Table.open(path, verify=False) as table,
    ):
        assert ring is not None  # it is needed
        fast = fast_library() if arguments["has_fast_path"] else None
        options = LiveOptions(effects, reconnect=True, bit_rate_hz=PTY_BIT_RATE_HZ, fast=fast)
        served = ControlOf(Path(folder) / "control.sock", ring.path, path)
        with ControlProcess(served) as slot:
            port = DescriptorPort("the socket", arguments["link"])
            live = Live(table, source, port, SystemClock(), options, ring, control=slot)
            slot.begin_steps(live.capabilities)
            with live.armed():
                parent.say({"socket": str(served.socket)})
                live.loop.run()
            parent.say({"loop": to_plain(live.loop.counters), "fast_path": to_plain(live.fast_counters)})
