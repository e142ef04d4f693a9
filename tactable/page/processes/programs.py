"""The control channel of the page's engine: one process for all of its runs, so that programs stay connected."""

from dataclasses import dataclass
from pathlib import Path

from firmware_link.host.link_values import Capabilities
from tactable.control.slot import ControlOf, ControlProcess


@dataclass(frozen=True)
class ProgramsAt:
    """Where programs reach the demo; the ports are as in tactable.control.slot.ControlOf."""

    socket: str
    port: int | None = None
    osc_port: int | None = None


class Programs:
    """The control process, which starts with the first run; `slot` is None where no channel was asked for."""

    def __init__(self, asked: ProgramsAt | None, ring: Path) -> None:
        self.slot: ControlProcess | None = None
        self._asked, self._ring = asked, ring
        self._is_announced = False

    @property
    def are_wanted(self) -> bool:
        """Whether a channel was asked for."""
        return self._asked is not None

    def open(self, table: Path) -> ControlProcess | None:
        """The slot of the next run, which is told of it. Raises ChildError where a port or the socket is taken."""
        if self.slot is not None:
            self.slot.change_run(table)
        elif self._asked is not None:
            asked = self._asked
            of = ControlOf(Path(asked.socket), self._ring, table, asked.port, asked.osc_port, is_watched=False)
            self.slot = ControlProcess(of)
        return self.slot

    def begin_run(self, capabilities: Capabilities) -> list[str]:
        """Say that the device of the run is connected; the first time what to print."""
        if self.slot is None:
            return []
        self.slot.begin_steps(capabilities)
        lines = [] if self._is_announced else self.slot.lines
        self._is_announced = True
        return lines

    def close(self) -> None:
        """End the process."""
        if self.slot is not None:
            self.slot.__exit__(None, None, None)
