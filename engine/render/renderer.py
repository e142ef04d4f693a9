"""The command for fingers, a level and a kind: a click is looked up, a steady drive solved or looked up.

A click of the table becomes the bytes of a PLAY, with its weights of the basis that the device holds; a steady drive,
after `clamp`, the bytes of a SET. Both are remembered, so the same fingers cost a dictionary look-up.
"""

from collections.abc import Sequence
from typing import Protocol

from engine.render.click_renderer import RenderedClicks
from engine.render.link_commands import SILENCE, Command, Rendered
from engine.steady.cases import MeasuredFinger
from engine.touch import Placement
from firmware_link.host.link_values import Capabilities


class Steady(Protocol):
    """Steady drives as commands: `SteadyDrives` solves them for positions, `ZoneDrives` looks them up for zones."""

    def prepare(self) -> None:
        """Load or compile what solving takes."""

    def take_fingers(self, measured: Sequence[MeasuredFinger]) -> None:
        """Know these fingers from now on."""

    def rendered(self, placement: Placement, level_db: float, held_hz: float | None = None) -> Rendered:
        """The drive for these fingers at this level; held_hz: frequency of the drive that they have, and moved."""


class Renderer:
    """Commands of one table on one device, at the rules' levels. `render` raises LimitError for a broken drive."""

    def __init__(
        self, capabilities: Capabilities, steady: Steady, clicks: RenderedClicks, levels_db: Sequence[float]
    ) -> None:
        self.not_achieved = 0  # number of commands that do not reach the level, or do not keep quiet fingers quiet
        self.levels_db = tuple(levels_db)  # levels of the rules
        self.clicks = clicks
        self.steady = steady
        self._wire = _wire_of(capabilities)

    def render(
        self, placement: Placement | None, level_db: float | None, is_click: bool = False, held_hz: float | None = None
    ) -> Command | None:
        """The command for these fingers; SILENCE where none is felt or the level is refused.

        held_hz: frequency of the steady drive that they have, and moved since; None: they have none.

        None: a click is wanted for these fingers that the table does not hold and nobody has solved yet; `fallback` is
        what is played where nobody solves it. A device that plays no clicks gets that at once.
        """
        if placement is None or level_db is None:
            return SILENCE
        if not is_click:
            return self._counted(self.steady.rendered(placement, level_db, held_hz))
        rendered = self.clicks.rendered(placement, level_db)
        if rendered is None:
            return None if self.clicks.is_unknown(placement) else self.fallback(placement, level_db)
        return self._counted(rendered)

    def fallback(self, placement: Placement, level_db: float) -> Command:
        """The steady drive for these fingers, also in place of a click; the effect player ends it."""
        return self._counted(self.steady.rendered(placement, level_db))

    def _counted(self, rendered: Rendered) -> Command:
        self.not_achieved += not rendered.is_achieved
        return rendered.command

    @property
    def click_shortfalls(self) -> dict[float, int]:
        """The number of tabulated clicks that do not reach a level with quiet fingers kept quiet, for each level."""
        if not self.clicks.are_played:
            return {}
        return {level_db: self.clicks.shortfall(level_db) for level_db in self.levels_db}

    def suits_device_of(self, other: "Renderer") -> bool:
        """Whether both were encoded for devices with the same number format on the wire and the same full scales."""
        return self._wire == other._wire

    def fits(self, capabilities: Capabilities) -> bool:
        """Whether a device has the number format and the full scales that the commands are encoded for."""
        return _wire_of(capabilities) == self._wire


def _wire_of(capabilities: Capabilities) -> tuple[float, ...]:
    return (
        capabilities.number_of_actuators,
        capabilities.frequency_resolution_hz,
        capabilities.frequency_minimum_hz,
        capabilities.frequency_maximum_hz,
        capabilities.synthesis_rate_hz,
        *capabilities.full_scales_m,
    )
