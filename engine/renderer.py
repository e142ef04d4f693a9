"""Zone state and level to the drive bytes of their command, encoded once when the table is opened."""

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import NamedTuple

from engine.device import Device
from engine.entry import Entry
from engine.limits import Drive, clamp
from firmware_link.link_values import Capabilities
from firmware_link.messages import encode_drive


class RendererError(ValueError):
    """The table, the device description and the connected device do not belong together: which, and the remedy."""


class WhenNotAchieved(StrEnum):
    """What becomes of a state whose entry cannot give every felt finger the wanted level."""

    REFUSE = "refuse"
    """It is silent."""
    WARN = "warn"
    """It is played as strong as it gets, and whoever runs it says so."""
    GO_ON = "go-on"
    """It is played as strong as it gets."""


class _Rendered(NamedTuple):
    drive: bytes | None
    is_achieved: bool


class Renderer:
    """The drive of every state that has an entry, at every level that is going to be asked for.

    `entries` are given by wanted level. Raises RendererError when table, device and capabilities do not fit, LimitError
    for an entry that is broken.
    """

    def __init__(
        self,
        entries: Mapping[float, Iterable[Entry]],
        device: Device,
        capabilities: Capabilities,
        when_not_achieved: WhenNotAchieved = WhenNotAchieved.WARN,
    ) -> None:
        self.unknown_states = 0
        """How often a felt state was asked for that has no entry."""
        self.not_achieved_states = 0
        """How often a state was asked for whose entry does not reach the level: silent where that is refused."""
        self._wire = _wire_of(capabilities)
        self._refuses = when_not_achieved is WhenNotAchieved.REFUSE
        _check_actuators(device, capabilities)
        self._rendered: dict[float, dict[int, _Rendered]] = {}
        for level_db, entries_of_level in entries.items():
            rendered = self._rendered[level_db] = {}
            for entry in entries_of_level:
                if entry.index in rendered:
                    raise RendererError(f"state {entry.index} has two entries: build the table again")
                rendered[entry.index] = self._render_entry(entry, device, capabilities)

    def _render_entry(self, entry: Entry, device: Device, capabilities: Capabilities) -> _Rendered:
        _check_zones(entry, device)
        drive = clamp(entry, device)
        _check_frequencies(entry, drive, capabilities)
        if self._refuses and not entry.achieved:
            return _Rendered(None, is_achieved=False)
        return _Rendered(encode_drive(drive.channels, capabilities.frequency_resolution_hz), entry.achieved)

    def render(self, state: int, level_db: float | None) -> bytes | None:
        """Drive bytes for `Link.set_drive`; None for silence: nothing is felt, or there is no entry, or it is refused.

        Raises KeyError for a level that no entries were given for.
        """
        if level_db is None:
            return None
        rendered = self._rendered[level_db].get(state)
        if rendered is None:
            self.unknown_states += 1
            return None
        self.not_achieved_states += not rendered.is_achieved
        return rendered.drive

    @property
    def shortfalls(self) -> dict[float, int]:
        """By level: how many of its states have an entry that does not reach it."""
        return {
            level_db: sum(not rendered.is_achieved for rendered in states.values())
            for level_db, states in self._rendered.items()
        }

    def fits(self, capabilities: Capabilities) -> bool:
        """Whether the drives mean the same to this device as to the one that they were encoded for."""
        return _wire_of(capabilities) == self._wire


def _wire_of(capabilities: Capabilities) -> tuple[float, ...]:
    return (
        capabilities.number_of_actuators,
        capabilities.frequency_resolution_hz,
        capabilities.frequency_minimum_hz,
        capabilities.frequency_maximum_hz,
    )


def _check_actuators(device: Device, capabilities: Capabilities) -> None:
    if capabilities.number_of_actuators < len(device.actuators):
        raise RendererError(
            f"{device.name} has {len(device.actuators)} actuators, the connected device drives "
            f"{capabilities.number_of_actuators}: connect its own device or choose another description"
        )


def _check_zones(entry: Entry, device: Device) -> None:
    names = [zone.name for zone in entry.zones]
    expected = [zone.name for zone in device.zones]
    if names != expected:
        raise RendererError(
            f"state {entry.index} is for zones {', '.join(names)}, {device.name} has {', '.join(expected)}: "
            "build the table for this device"
        )


def _check_frequencies(entry: Entry, drive: Drive, capabilities: Capabilities) -> None:
    # The wire counts in whole steps: a frequency at the end of the range may be off by rounding.
    half_step_hz = capabilities.frequency_resolution_hz / 2
    low_hz, high_hz = capabilities.frequency_minimum_hz, capabilities.frequency_maximum_hz
    for channel in drive.channels:
        if not low_hz - half_step_hz <= channel.frequency_hz <= high_hz + half_step_hz:
            raise RendererError(
                f"state {entry.index}: {channel.frequency_hz:g} Hz; the connected device plays {low_hz:g}-{high_hz:g} "
                "Hz: narrow the actuators' bands in the device description and build the table again"
            )
