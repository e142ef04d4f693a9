"""Both ends of a pipe of pointer events, in one process."""

import os

from engine.touch.sources.pointer import PointerFeed, PointerSource


def open_pointer_pipe() -> tuple[PointerSource, PointerFeed]:
    """The reading and the writing end of a new pipe."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    return PointerSource(reading), PointerFeed(writing)
