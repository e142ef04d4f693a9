"""What else runs while the engine is measured: nothing, or processes that take processors and memory."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from typing import Any

from firmware_link.child import Child, Parent

_MEMORY_BYTES = 1 << 26


class Load(StrEnum):
    """What the engine has beside it."""

    IDLE = "idle"
    """What the machine does anyway."""
    STRESS = "stress"
    """For each processor one process that computes and one that moves memory."""
    THREAD = "thread"
    """A busy Python thread in the engine's own process: why nothing else may live there."""


@contextmanager
def load_running(load: Load) -> Iterator[None]:
    """The processes of a load, ended at the end; that of a thread belongs to the engine."""
    count = os.cpu_count() or 1
    kinds = ("compute", "memory") * count if load is Load.STRESS else ()
    children = [Child("tactable.bench.latency.load", {"kind": kind}, name=f"the load {kind}") for kind in kinds]
    try:
        yield
    finally:
        for child in children:
            child.kill()


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Work without end; the parent kills it, and where that is gone too, the system does."""
    parent.end_with_it()
    block, target = bytes(_MEMORY_BYTES), bytearray(_MEMORY_BYTES)
    while True:
        if arguments["kind"] == "memory":
            target[:] = block
        else:
            sum(range(1_000_000))
