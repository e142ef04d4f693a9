"""Child process that compiles kernels for the page, then builds its table: coarse clicks first, then fine ones."""

import os
import signal
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from engine.device import Device
from engine.files import rename_durably
from firmware_link.child import Parent
from tactable.rig.kernels import compile_kernels
from tactable.rig.ready import early_path, open_cached
from tactable.shipped import find_device


@dataclass(frozen=True)
class BuildOrder:
    """A table to build."""

    device: str
    path: Path

    def as_json(self) -> dict[str, Any]:
        """The arguments of the child process."""
        return asdict(self) | {"path": str(self.path)}


def build(order: BuildOrder, parent: Parent) -> None:
    """Build it, unless it is there; kernels come first.

    Says {"step", "fraction"} as it goes on, {"compiled": true} once, and {"usable": path} for each usable table.
    """
    device, early = find_device(order.device), early_path(order.path)
    _compile(device, parent)  # SIGTERM ends it at once: there is nothing to keep yet
    signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))  # the build remembers that one
    sys.unraisablehook = _tell_all_but_interrupts
    parent.say({"compiled": True})
    from precompute.builder.build import COARSE_IN_PLACE, Coarse, build_table
    from precompute.parallel.pool import available_cores

    order.path.parent.mkdir(parents=True, exist_ok=True)

    def progress(step: str, fraction: float) -> None:
        parent.say({"usable": str(early)} if step == COARSE_IN_PLACE else {"step": step, "fraction": fraction})

    found = open_cached(device, order.path)
    if found is not None and found.path == order.path:
        parent.say({"usable": str(order.path)})
        return
    build_table(device, early, coarse=Coarse.FIRST, workers=available_cores(), progress=progress)
    rename_durably(early, order.path)
    parent.say({"usable": str(order.path)})


def _compile(device: Device, parent: Parent) -> None:
    """Compile what play and builds take; the first click that is solved compiles the kernels of clicks."""

    def on_module(module: str, number: int, count: int) -> None:
        parent.say({"step": f"compiling {module}, {number} of {count}", "fraction": (number - 1) / count})

    compile_kernels(on_module, device)


def _tell_all_but_interrupts(ignored: Any) -> None:
    """An interrupt that comes up within a finalizer is remembered, and nothing to tell."""
    if ignored.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(ignored)


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Build the order; SIGTERM keeps the finished clicks for the next build."""
    parent.end_with_it()
    os.nice(10)  # the page comes first
    try:
        build(BuildOrder(**arguments | {"path": Path(arguments["path"])}), parent)
    except KeyboardInterrupt:
        raise SystemExit(1) from None
