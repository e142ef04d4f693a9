"""A table for the page, built in a process of its own: first steady entries, which play at once, then clicks."""

import json
import os
import signal
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from engine.device import DeviceError
from engine.files import rename_durably
from engine.table import TableError
from precompute.builder.build import build_table
from precompute.parallel.pool import WorkerError, available_cores
from tactable.shipped import find_device


@dataclass(frozen=True)
class BuildOrder:
    """Which table of which device goes where; `clicks_up_to` so many fingers, 0 is none."""

    device: str
    objective: str
    clicks_up_to: int
    path: Path

    def command(self) -> list[str]:
        """The command line of a process that builds it."""
        words = [self.device, self.objective, str(self.clicks_up_to), str(self.path)]
        return [sys.executable, "-m", "tactable.page.processes.build", *words]

    @property
    def early_path(self) -> Path:
        """Where the table without clicks is until it has them."""
        return self.path.with_name(f"{self.path.stem}-early{self.path.suffix}")


def build(order: BuildOrder) -> None:
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
            progress=lambda step, fraction: _say({"step": step, "fraction": fraction}),
        )
        if clicks_up_to == stages[-1]:
            rename_durably(order.early_path, order.path)
            _say({"usable": str(order.path)})
        else:
            _say({"usable": str(order.early_path)})


def _say(document: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(document) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Build what the command line orders; a polite kill leaves the clicks that are done for the next build."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    os.nice(10)  # the page, which is looked at, comes first
    name, objective, clicks_up_to, path = sys.argv[1:]
    try:
        build(BuildOrder(name, objective, int(clicks_up_to), Path(path)))
    except BrokenPipeError:  # the page is gone
        raise SystemExit(1) from None
    except (DeviceError, TableError, WorkerError, OSError) as error:
        _say({"error": str(error)})
        raise SystemExit(1) from None
    except KeyboardInterrupt:
        raise SystemExit(1) from None


if __name__ == "__main__":
    main()
