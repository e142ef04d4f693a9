"""Serves the page of a live run from a separate process, which reads only the ring; the loop never waits for it."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class PageOf:
    """What the page shows, and where it is served."""

    ring: Path
    table: Path
    frequency_resolution_hz: float
    host: str
    port: int


@contextmanager
def page_of(shown: PageOf) -> Iterator[list[str]]:
    """Serve the page in a child process while the context lasts; yields the lines to print. Raises OSError."""
    words = [str(shown.ring), str(shown.table), repr(shown.frequency_resolution_hz), shown.host, str(shown.port)]
    process = subprocess.Popen(
        [sys.executable, "-m", "tactable.page.processes.live", *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C reaches the run alone, which then ends this process
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        told: dict[str, Any] = json.loads(line) if line else {"error": f"status {process.wait()}"}
        if "error" in told:
            raise OSError(f"no page at {shown.host}, port {shown.port}: {told['error']}")
        yield told["lines"]
    finally:
        process.stdin.close()
        process.wait()
        process.stdout.close()
