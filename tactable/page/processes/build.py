"""Child process that builds a table for the page: first the steady entries, which can play at once, then clicks."""

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
    """A table to build; `clicks_up_to`: the most fingers with clicks, 0 for no clicks."""

    device: str
    clicks_up_to: int
    path: Path

    def as_json(self) -> dict[str, Any]:
        """The arguments of the child process."""
        return asdict(self) | {"path": str(self.path)}

    @property
    def early_path(self) -> Path:
        """Path of the table while it has no clicks yet."""
        return self.path.with_name(f"{self.path.stem}-early{self.path.suffix}")


def build(order: BuildOrder, parent: Parent) -> None:
    """Build it; say {"step", "fraction"} as it goes on, and {"usable": path} for each usable table."""
    device = find_device(order.device)
    order.path.parent.mkdir(parents=True, exist_ok=True)
    stages = (0, order.clicks_up_to) if order.clicks_up_to else (0,)
    for clicks_up_to in stages:
        build_table(
            device,
            order.early_path,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
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
    """Build the order; SIGTERM keeps the finished clicks for the next build."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    parent.end_with_it()
    os.nice(10)  # the page comes first
    try:
        build(BuildOrder(**arguments | {"path": Path(arguments["path"])}), parent)
    except KeyboardInterrupt:
        raise SystemExit(1) from None
