"""Times a program's message to the bytes on the line, beside touches that bring the same click in the same run.

Both are sent by this process, one after the other in each round, and end when the PLAY comes out of the engine's port:
a socket pair, so no wire is in the figures. A message passes the Unix socket, the control process and the slot; a touch
only the loop or its compiled step. The difference is what a program pays for not being in the loop.
"""

import json
import platform
import select
import socket
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as Grid

from base.child import Child, Parent
from base.plain import to_plain
from base.points import point_text
from engine.effects.rules import DEFAULT_EFFECTS
from engine.loop.loop import SystemClock
from engine.table import Table
from firmware_link.host.serial_port import DescriptorPort
from tactable.bench.ends import STAMPS, LightDevice, SocketSource
from tactable.bench.latency.conditions import PTY_BIT_RATE_HZ
from tactable.bench.latency.stages import figures_of, us
from tactable.control.slot import ControlOf, ControlProcess
from tactable.rig.emulate import configuration_of
from tactable.rig.virtual_digitizer import PRODUCT_ID, VENDOR_ID, descriptor_of, report_of
from tactable.run.live_run import Live, LiveOptions, fast_library, ring_for
from tactable.shipped import named_effects

ROUNDS = 1000  # the 99th percentile has ten samples beyond it
_SLOTS = 2
_LIFTED_NS = 3_000_000  # the lift has been taken before the next touch comes
_PAUSE_NS = 36_000_000  # longer than a click: one that is still playing has the next one wait
_LONGEST_NS = 1_000_000_000
_HELLO = {"type": "hello", "version": 1, "name": "bench", "lease": "60 s"}


class _Bench:
    """One engine with its control channel, and the far ends of its sockets, all served by this thread."""

    def __init__(self, table: Table, rounds: int, has_fast_path: bool, stack: ExitStack) -> None:
        self._touch, their_touch = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._link, their_link = socket.socketpair()
        for each in (self._touch, self._link):
            stack.enter_context(each)
        arguments = {
            "table": str(table.path),
            "touch": their_touch.fileno(),
            "link": their_link.fileno(),
            "reports": 2 * rounds + 2,
            "has_fast_path": has_fast_path,
        }
        ends = (their_touch.fileno(), their_link.fileno())
        name = "the engine under measurement"
        self._engine = stack.enter_context(Child(__name__, arguments, name=name, descriptors=ends))
        for each in (their_touch, their_link):
            each.close()
        self._far_end = LightDevice(configuration_of(table.device), time.monotonic_ns())
        self._serve_until_readable(self._engine, 120 * _LONGEST_NS)
        self._program = stack.enter_context(socket.socket(socket.AF_UNIX))
        self._program.connect(self._engine.read()["socket"])
        self._said = b""
        self._send(_HELLO)
        self._answered()
        self._corner_m = table.device.surface.corner_m
        self._start_ns = time.monotonic_ns()

    def touch(self, place: float) -> int | None:
        """Ns from a touch to its PLAY; None where none came."""
        took_ns = self._until_click(lambda: self._send_report([(0, True, place)]))
        self._serve(lambda: False, _PAUSE_NS)
        self._send_report([(0, False, place)])
        self._serve(lambda: False, _LIFTED_NS)
        return took_ns

    def trigger(self, place: float) -> tuple[int | None, int]:
        """Ns from a message to its PLAY, and to its answer."""
        message = {"type": "trigger", "effect": "click", "at": point_text(place * self._corner_m, 9)}
        sent_ns = time.monotonic_ns()
        took_ns = self._until_click(lambda: self._send(message))
        answered_ns = self._answered() - sent_ns
        self._serve(lambda: False, _PAUSE_NS)
        return took_ns, answered_ns

    def end(self) -> dict[str, Any]:
        """End the touches; the counters of the engine."""
        self._touch.shutdown(socket.SHUT_WR)
        self._serve_until_readable(self._engine, 10 * _LONGEST_NS)
        return self._engine.read()

    def _send_report(self, fingers: list[tuple[int, bool, float]]) -> None:
        now_ns = time.monotonic_ns()
        report = report_of(fingers, (now_ns - self._start_ns) / 1e9, _SLOTS)
        self._touch.send(STAMPS.pack(now_ns, now_ns) + report)

    def _until_click(self, send: Callable[[], None]) -> int | None:
        times_ns = self._far_end.arrivals.time_ns
        before, start_ns = len(times_ns), time.monotonic_ns()
        send()
        self._serve(lambda: len(times_ns) > before, _LONGEST_NS)
        return times_ns[before] - start_ns if len(times_ns) > before else None

    def _send(self, message: dict[str, Any]) -> None:
        self._program.sendall(json.dumps(message).encode() + b"\n")

    def _answered(self) -> int:
        """Time at which the next answer arrived."""
        while b"\n" not in self._said:
            self._serve_until_readable(self._program, _LONGEST_NS)
            self._said += self._program.recv(65_536)
        now_ns = time.monotonic_ns()
        line, _, self._said = self._said.partition(b"\n")
        answer = json.loads(line)
        assert answer["ok"], answer
        return now_ns

    def _serve_until_readable(self, other: Child | socket.socket, most_ns: int) -> None:
        self._serve(lambda: bool(select.select([other], [], [], 0)[0]), most_ns, other)

    def _serve(self, is_over: Callable[[], bool], most_ns: int, other: Child | socket.socket | None = None) -> None:
        """Be the device until something is over, which `other` wakes up for, or for a time."""
        until_ns = time.monotonic_ns() + most_ns
        watched = [self._link, *([] if other is None else [other])]
        while not is_over() and (now_ns := time.monotonic_ns()) < until_ns:
            due_ns = self._far_end.next_deadline_ns()
            next_ns = until_ns if due_ns is None else min(due_ns, until_ns)
            readable = select.select(watched, [], [], max(0, next_ns - now_ns) / 1e9)[0]
            now_ns = time.monotonic_ns()
            data = self._link.recv(65_536) if self._link in readable else b""
            answer = (self._far_end.receive(data, now_ns) if data else b"") + self._far_end.run_until(now_ns)
            if answer:
                self._link.sendall(answer)


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """The engine, a child process: it says where programs reach the run, and at the end what was counted."""
    path = Path(arguments["table"])
    effects = replace(DEFAULT_EFFECTS, others=tuple(named_effects().values()))
    numbers = (VENDOR_ID, PRODUCT_ID)
    source = SocketSource(arguments["touch"], descriptor_of(_SLOTS), numbers, arguments["reports"])
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


def run_control_bench(table: Table, rounds: int = ROUNDS) -> dict[str, Any]:
    """Time touches and messages in turn, with the compiled step and without. Raises ChildError."""
    places = np.random.default_rng(20).uniform(0.05, 0.95, rounds).tolist()
    rows = []
    for has_fast_path in (True, False):
        with ExitStack() as stack:
            bench = _Bench(table, rounds, has_fast_path, stack)
            touched, triggered, answered = [], [], []
            for place in places:
                touched.append(bench.touch(place))
                took_ns, answered_ns = bench.trigger(place)
                triggered.append(took_ns)
                answered.append(answered_ns)
            counted = bench.end()
        row = {
            "compiled_step": has_fast_path,
            "touch": figures_of(np.array(touched, np.float64)),
            "message": figures_of(np.array(triggered, np.float64)),
            "answer": figures_of(np.array(answered, np.float64)),
            "without_a_command": touched.count(None) + triggered.count(None),
            "control_steps": counted["loop"]["controlled"],
            "answered_by_compiled_step": counted["fast_path"]["answered"],
            "mispredicted": counted["fast_path"]["mispredicted"],
        }
        for name in ("p50", "p99"):
            one, other = ((row[kind] or {}).get(f"{name}_us") for kind in ("message", "touch"))
            row[f"ratio_{name}"] = one / other if one and other else None
        rows.append(row)
    machine = {"python": platform.python_version(), "rounds": rounds}
    return {"machine": machine, "device": table.device.name, "rows": rows}


def print_control_bench(out: Console, result: dict[str, Any]) -> None:
    """Print medians and 99th percentiles in us, and the ratio of a message to a touch."""
    head = ("touches answered by", "touch p50", "p99", "message p50", "p99", "ratio p50", "p99", "answer p50")
    grid = Grid(*head, title="us to the bytes of a click")
    for row in result["rows"]:
        touch, message, answer = (row[name] or {} for name in ("touch", "message", "answer"))
        times = [each.get(name) for each in (touch, message) for name in ("p50_us", "p99_us")]
        ratios = [row["ratio_p50"], row["ratio_p99"]]
        grid.add_row(
            f"the compiled step, {row['answered_by_compiled_step']} times"
            if row["compiled_step"]
            else "the Python loop",
            *map(us, times),
            *("-" if ratio is None else f"{ratio:.1f}" for ratio in ratios),
            us(answer.get("p50_us")),
        )
    out.print(grid)
