"""The steady drive that fingers have while they move, whose frequency the next drive keeps where it can."""

from engine.render.link_commands import Command
from engine.touch import Placement

SAME_FINGER_M = 5e-3  # a finger that is farther away than this from one report to the next is taken for another one


class HeldDrive:
    """Remembers the last command, for as long as steady drives of the same fingers follow one another."""

    def __init__(self) -> None:
        self._placement: Placement | None = None
        self._frequency_hz: float | None = None

    def frequency_for(self, placement: Placement | None) -> float | None:
        """The frequency that these fingers have; None where they have no steady drive, or are others."""
        before = self._placement
        if placement is None or before is None or placement.is_felt != before.is_felt:
            return None
        moved_m = (abs(at_m - old_m) for at_m, old_m in zip(placement.position_m, before.position_m, strict=True))
        return self._frequency_hz if max(moved_m) < SAME_FINGER_M else None

    def note(self, placement: Placement | None, command: Command | None) -> None:
        """Take the command that these fingers get now; None: it is awaited."""
        self._frequency_hz = None if command is None else command.frequency_hz
        self._placement = placement
