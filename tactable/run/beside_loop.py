"""A child process beside a running loop, which polls it and never waits; if it dies, the run goes on without it."""

import os
from collections.abc import Callable
from typing import Any, Self

from base.child import Child
from base.printable import write_note

_READ_BYTES = 1 << 16


class BesideLoop:
    """The child of a module, ended at the end of a `with` block. Raises ChildError."""

    def __init__(self, module: str, arguments: dict[str, Any], name: str, start: Callable[..., Child] = Child) -> None:
        self._child = start(module, arguments, name=name)
        self._descriptor = self._child.fileno()
        self._rest = b""  # of a line that has not come whole
        self.process_id = self._child.process_id

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *unused: object) -> None:
        self._child.kill()

    def fileno(self) -> int:
        """The descriptor that is readable when something has come."""
        return self._descriptor

    def _read_lines(self) -> list[bytes] | None:
        """Read at most 64 KiB without waiting; the lines that have come whole. None: the child has ended."""
        try:
            part = os.read(self._descriptor, _READ_BYTES)
        except BlockingIOError:
            return []
        except ConnectionResetError:
            part = b""
        if not part:
            return None
        *lines, self._rest = (self._rest + part).split(b"\n")
        return lines

    def _fall_silent(self, why: str) -> None:
        """Replace the socket of a child that died by a silent one, and say why nothing comes any more."""
        write_note(why)
        silent, self._kept_open = os.pipe()
        os.dup2(silent, self._descriptor)
        os.close(silent)
        os.set_blocking(self._descriptor, False)
