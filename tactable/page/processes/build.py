"""Child process that builds a table for the page: steady drives at once, then coarse clicks, then fine ones."""

import os
import signal
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from engine.files import rename_durably
from firmware_link.child import Parent
from precompute.builder.build import COARSE_IN_PLACE, Coarse, build_table
from precompute.parallel.pool import available_cores
from tactable.rig.demo import early_path, open_cached
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
    """Build it; say {"step", "fraction"} as it goes on, and {"usable": path} for each usable table."""
    device, early = find_device(order.device), early_path(order.path)
    order.path.parent.mkdir(parents=True, exist_ok=True)

    def progress(step: str, fraction: float) -> None:
        parent.say({"usable": str(early)} if step == COARSE_IN_PLACE else {"step": step, "fraction": fraction})

    if open_cached(device, order.path) is None:
        build_table(device, early, clicks_up_to=0, coarse=Coarse.ONLY, workers=available_cores(), progress=progress)
        parent.say({"usable": str(early)})
    build_table(device, early, coarse=Coarse.FIRST, workers=available_cores(), progress=progress)
    rename_durably(early, order.path)
    parent.say({"usable": str(order.path)})


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Build the order; SIGTERM keeps the finished clicks for the next build."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    parent.end_with_it()
    os.nice(10)  # the page comes first
    try:
        build(BuildOrder(**arguments | {"path": Path(arguments["path"])}), parent)
    except KeyboardInterrupt:
        raise SystemExit(1) from None
