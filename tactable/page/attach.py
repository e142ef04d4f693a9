"""Serves the page of a live run from a separate process, which reads only the ring; the loop never waits for it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from base.child import Child
from base.plain import to_plain


@dataclass(frozen=True)
class PageOf:
    """What the page shows, and the address at which it is served."""

    ring: Path
    table: Path
    frequency_resolution_hz: float
    full_scales_m: tuple[float, ...]
    """Full scales of the connected board, by actuator."""
    host: str
    port: int


@contextmanager
def page_of(shown: PageOf) -> Iterator[list[str]]:
    """Serve the page in a child process while the context lasts: the lines to print. Raises ChildError."""
    with Child(
        "tactable.page.processes.live", to_plain(shown), name=f"no page at {shown.host}, port {shown.port}"
    ) as child:
        yield child.read()["lines"]
