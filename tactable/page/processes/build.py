"""Child process that compiles kernels for the page, then builds its tables: one with few places first.

Kernels of clicks come first. A device without any table gets its first click with them, and the page solves the others
as fingers ask for them. Then come those of steady drives, and those of builds.
"""

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from base.child import Parent
from base.files import rename_durably
from tactable.rig.first_table import early_options, write_first_table
from tactable.rig.kernels import BUILDS, STEADY, SWEEP, compile_all, compile_for_clicks
from tactable.rig.ready import early_path, open_cached
from tactable.shipped import find_device

_HEAD_START_S = 3.0
"""The page changes over to the table with the first click in this time, and starts what solves the others."""


@dataclass(frozen=True)
class BuildOrder:
    """A table to build."""

    device: str
    path: Path
    first: Path
    """Where the table with the first click is put; where the page has another table, it is not made."""

    def as_json(self) -> dict[str, Any]:
        """The arguments of the child process."""
        return asdict(self) | {"path": str(self.path), "first": str(self.first)}


def build(order: BuildOrder, parent: Parent) -> None:
    """Build it, unless it is there; kernels come first.

    Says {"step", "fraction"} as it goes on, {"compiled": true} once those that play takes are, and {"usable": path} for
    each usable table.
    """
    device, early, say = find_device(order.device), early_path(order.path), partial(_say_module, parent)
    clicks = compile_for_clicks(say, device)
    found = open_cached(device, order.path)
    if found is None:
        write_first_table(device, order.first, clicks)
        parent.say({"usable": str(order.first)})
        time.sleep(_HEAD_START_S)
    compile_all((*STEADY, *SWEEP), say)
    parent.say({"compiled": True})
    compile_all(BUILDS, say)
    if found is not None and found.path == order.path:
        parent.say({"usable": str(order.path)})
        return
    from precompute.builder.build import build_table
    from precompute.parallel.pool import available_cores

    def progress(step: str, fraction: float) -> None:
        parent.say({"step": step, "fraction": fraction})

    order.path.parent.mkdir(parents=True, exist_ok=True)
    with _sigterm_as_interrupt():
        workers = available_cores()
        build_table(device, early, click_options=early_options(), workers=workers, progress=progress)
        parent.say({"usable": str(early)})
        build_table(device, early, completes=True, workers=workers, progress=progress)
    rename_durably(early, order.path)
    parent.say({"usable": str(order.path)})


def _say_module(parent: Parent, module: str, number: int, count: int) -> None:
    parent.say({"step": f"compiling {module}, {number} of {count}", "fraction": (number - 1) / count})


@contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """SIGTERM is Ctrl-C, which a build remembers; before and after, when nothing can be lost, it ends the process."""
    sys.unraisablehook = _tell_all_but_interrupts
    signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _tell_all_but_interrupts(ignored: Any) -> None:
    """An interrupt that comes up within a finalizer is remembered, and nothing to tell."""
    if ignored.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(ignored)


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Build the order; SIGTERM keeps the finished clicks for the next build."""
    parent.end_with_it()
    os.nice(10)  # the page comes first
    try:
        build(BuildOrder(arguments["device"], Path(arguments["path"]), Path(arguments["first"])), parent)
    except KeyboardInterrupt:
        raise SystemExit(1) from None
