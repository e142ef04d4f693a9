"""Steady drives as commands: solved for the exact positions when they are wanted, clamped, encoded, and remembered.

Optima are sharp and responses are smooth (docs/theory.md#steady-drives-at-positions), so no drive is tabulated: the
table holds the receptances, and a solve takes less time than a report of most digitizers.
"""

from engine.device import Device
from engine.render.commands import SILENCE, DriveCommand, Rendered
from engine.render.limits import clamp
from engine.steady import Receptances
from engine.touch import Placement
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.messages import encode_drive

MOST_REMEMBERED = 4096


class SteadyDrives:
    """The steady drives of one table for one connected device; silence for a level out of reach with `refuses`."""

    def __init__(self, device: Device, capabilities: Capabilities, receptances: Receptances, refuses: bool) -> None:
        from engine.steady.solver import SteadySolver  # Numba takes half a second, and not every command solves

        self._solver = SteadySolver(device, receptances)
        self._device, self._resolution_hz, self._refuses = device, capabilities.frequency_resolution_hz, refuses
        self._remembered: dict[tuple[Placement, float], Rendered] = {}

    def prepare(self) -> None:
        """Load or compile what a solve needs, so that no touch waits for that."""
        self._solver.prepare()

    def rendered(self, placement: Placement, level_db: float) -> Rendered:
        """The drive for these fingers at this level."""
        key = (placement, level_db)
        found = self._remembered.get(key)
        if found is None:
            if len(self._remembered) == MOST_REMEMBERED:
                del self._remembered[next(iter(self._remembered))]
            found = self._remembered[key] = self._solve(placement, level_db)
        return found

    def _solve(self, placement: Placement, level_db: float) -> Rendered:
        solved = self._solver.solve(placement.position_m, placement.is_felt, level_db)
        if self._refuses and not solved.achieved:
            return Rendered(SILENCE, is_achieved=False)
        drive = clamp(solved, self._device)
        return Rendered(DriveCommand(encode_drive(drive.channels, self._resolution_hz)), solved.achieved)
