"""What a tracked run knows, as a file beside the table that it plays: drift, loads, when the table was re-scaled."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

STATUS = "track.json"


def read_status(table: Path) -> dict[str, Any] | None:
    """The status beside the table; None before there is one."""
    path = table.with_name(STATUS)
    found: dict[str, Any] | None = json.loads(path.read_text()) if path.exists() else None
    return found


def track_text(status: Mapping[str, Any] | None) -> str:
    """One line of what is known; "" for nothing to tell."""
    if status is None or status["drift"] is None:
        return ""
    simulated = " (SIMULATED sensor)" * status["simulated"]
    text = f"drift {100 * status['drift']:+.2f} ± {100 * status['drift_error']:.2f} %{simulated} "
    text += f"from {status['windows']} windows, {status['refused']} refused"
    for made in status["rescaled"][-1:]:
        text += f"; table re-scaled to {100 * made['drift']:+.2f} % after {made['after_s']:.0f} s"
    return text + f"; the table is left as it is: {status['trouble']}" * bool(status["trouble"])
