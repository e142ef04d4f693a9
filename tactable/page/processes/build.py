"""A table for the page, built in a process of its own: first steady entries, which play at once, then clicks."""

import os
import signal
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from engine.files import rename_durably
from firmware_link.child import Parent
from precompute.builder.build import build_table
from precompute.parallel.pool import available_cores
from tactable.shipped import find_device


@dataclass(frozen=True)
class BuildOrder:
    """Which table of which device goes where; `clicks_up_to` so many fingers, 0 is none."""

    device: str
    objective: str
    clicks_up_to: int
    path: Path

    def as_json(self) -> dict[str, Any]:
        """The arguments of a process that builds it."""
        return asdict(self) | {"path": str(self.path)}

    @property
    def early_path(self) -> Path:
        """Where the table without clicks is until it has them."""
        return self.path.with_name(f"{self.path.stem}-early{self.path.suffix}")


def build(order: BuildOrder, parent: Parent) -> None:
    """Build it, and tell: {"step", "fraction"} again and again, {"usable": path} for what plays already."""
    device = find_device(order.device)
    order.path.parent.mkdir(parents=True, exist_ok=True)
    stages = (0, order.clicks_up_to) if order.clicks_up_to else (0,)
    for clicks_up_to in stages:
        build_table(
            device,
            order.early_path,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            objective=order.objective,
            clicks_up_to=clicks_up_to,
            workers=available_cores(),
            progress=lambda step, fraction: parent.say({"step": step, "fraction": fraction}),
        )
        if clicks_up_to == stages[-1]:
            rename_durably(order.early_path, order.path)
            parent.say({"usable": str(order.path)})
        else:
            parent.say({"usable": str(order.early_path)})


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Build what is ordered; SIGTERM leaves the clicks that are done for the next build."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    parent.end_with_it()
    os.nice(10)  # the page, which is looked at, comes first
    try:
        build(BuildOrder(**arguments | {"path": Path(arguments["path"])}), parent)
    except KeyboardInterrupt:
        raise SystemExit(1) from None
