"""Background load beside the engine: nothing, processes that take processors and memory, or a busy thread."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from typing import Any

from base.child import Child, Parent

_MEMORY_BYTES = 1 << 26  # 64 MiB: more than a cache holds, so the copies go to memory


class BackgroundLoad(StrEnum):
    """Kind of load beside the engine under measurement."""

    IDLE = "idle"  # only what the machine does anyway
    STRESS = "stress"  # for each processor one process that computes and one that moves memory
    THREAD = "thread"  # a busy Python thread in the engine's own process: it shows why no other thread may live there


@contextmanager
def background_load(load: BackgroundLoad) -> Iterator[None]:
    """Run the processes of a load for the length of a `with` block; the busy thread belongs to the engine's process."""
    kinds = ("compute", "memory") * (os.cpu_count() or 1) if load is BackgroundLoad.STRESS else ()
    children = [Child(__name__, {"kind": kind}, name=f"the background load {kind}") for kind in kinds]
    try:
        yield
    finally:
        for child in children:
            child.kill()


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Work without end: the parent kills this process, or the system does when the parent is gone."""
    parent.end_with_it()
    block, target = bytes(_MEMORY_BYTES), bytearray(_MEMORY_BYTES)
    while True:
        if arguments["kind"] == "memory":
            target[:] = block
        else:
            sum(range(1_000_000))
