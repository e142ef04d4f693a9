"""Look-up of the command for a state of the zones, a level and a kind: encoded once, when the table is opened.

A steady drive becomes the bytes of a SET, after `clamp`; a click becomes the bytes of a PLAY, with its weights of the
basis that the device holds. Nothing is computed at run time, so a command costs two dictionary look-ups.
"""

from collections.abc import Iterable, Iterator, Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import NamedTuple

from engine.device import Device
from engine.render.chosen_basis import NO_BASIS, ChosenBasis
from engine.render.limits import Drive, clamp
from engine.table import ClickEntry, Entry
from firmware_link.host.link import Link
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.basis import EncodedClick, encode_click
from firmware_link.protocol.errors import TactableError
from firmware_link.protocol.messages import encode_drive

_NO_CLICKS: Mapping[float, Iterable[ClickEntry]] = MappingProxyType({})


class RendererError(TactableError, ValueError):
    """The table, the device description and the connected device do not belong together; the message has the remedy."""


class WhenNotAchieved(StrEnum):
    """What is played for a state whose entry does not reach the wanted level under every felt finger."""

    REFUSE = "refuse"
    """Silence."""
    WARN = "warn"
    """The strongest drive there is, and a note to the user."""
    GO_ON = "go-on"
    """The strongest drive there is."""


class DriveCommand(NamedTuple):
    """Hold this drive until the next command; no bytes are silence."""

    drive: bytes

    def hand_to(self, link: Link) -> None:
        """Send this next, in place of a command that waits."""
        link.set_drive(self.drive)


class PlayCommand(NamedTuple):
    """Play a click once, then silence."""

    click: EncodedClick

    def hand_to(self, link: Link) -> None:
        """Send this next, in place of a command that waits."""
        link.set_play(self.click)


Command = DriveCommand | PlayCommand
SILENCE = DriveCommand(b"")


class _Rendered(NamedTuple):
    command: Command
    is_achieved: bool


class Renderer:
    """The commands of all states that have an entry, at each level that the rules use.

    `entries` and `clicks` are keyed by wanted level, dB above the detection threshold. `basis` is the one that the
    device holds; a click of another set is played as the steady drive. Raises RendererError when table, device and
    capabilities do not fit, LimitError for a broken entry.
    """

    def __init__(
        self,
        entries: Mapping[float, Iterable[Entry]],
        device: Device,
        capabilities: Capabilities,
        when_not_achieved: WhenNotAchieved = WhenNotAchieved.WARN,
        clicks: Mapping[float, Iterable[ClickEntry]] = _NO_CLICKS,
        basis: ChosenBasis = NO_BASIS,
    ) -> None:
        self.unknown_states = 0
        """Number of requests for a felt state without an entry."""
        self.not_achieved_states = 0
        """Number of requests for a state whose entry or click does not reach the level."""
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
        self._clicks: dict[float, dict[int, _Rendered]] = {level_db: {} for level_db in clicks}
        for level_db, clicks_of_level in clicks.items():
            for click in clicks_of_level:
                if click.basis_set in basis.sets:
                    self._clicks[level_db][click.index] = self._render_click(click, basis)

    def _render_click(self, click: ClickEntry, basis: ChosenBasis) -> _Rendered:
        if self._refuses and not click.achieved:
            return _Rendered(SILENCE, is_achieved=False)
        assert basis.basis is not None  # it has the click's set
        number, weights = basis.sets[click.basis_set], click.weights.tolist()
        encoded = encode_click(basis.basis, number, weights, click.fraction_bits, click.amplitude)
        return _Rendered(PlayCommand(encoded), click.achieved)

    def _render_entry(self, entry: Entry, device: Device, capabilities: Capabilities) -> _Rendered:
        _check_zones(entry, device)
        drive = clamp(entry, device)
        _check_frequencies(entry, drive, capabilities)
        if self._refuses and not entry.achieved:
            return _Rendered(SILENCE, is_achieved=False)
        drive_bytes = encode_drive(drive.channels, capabilities.frequency_resolution_hz)
        return _Rendered(DriveCommand(drive_bytes), entry.achieved)

    def render(self, state: int, level_db: float | None, is_click: bool = False) -> Command:
        """The command for a state; SILENCE where no zone is felt, there is no entry, or the entry is refused.

        A click that the device cannot play is played as the steady drive; the effect player ends it. Raises KeyError
        for a level without entries.
        """
        if level_db is None:
            return SILENCE
        rendered = self._clicks[level_db].get(state) if is_click and self._clicks else None
        rendered = rendered or self._rendered[level_db].get(state)
        if rendered is None:
            self.unknown_states += 1
            return SILENCE
        self.not_achieved_states += not rendered.is_achieved
        return rendered.command

    @property
    def levels_db(self) -> tuple[float, ...]:
        """The levels that have entries."""
        return tuple(self._rendered)

    @property
    def playable_clicks(self) -> int:
        """Number of states whose click the device can play."""
        return max((len(clicks) for clicks in self._clicks.values()), default=0)

    def commands(self) -> Iterator[tuple[float, bool, int, Command]]:
        """Every command that `render` may return, beside SILENCE, as (level, is click, state, command)."""
        for level_db, steady in self._rendered.items():
            clicks = self._clicks.get(level_db, {})
            for state, rendered in steady.items():
                yield level_db, False, state, rendered.command
            for state, rendered in (steady | clicks).items():
                yield level_db, True, state, rendered.command

    @property
    def shortfalls(self) -> dict[float, int]:
        """By level: the number of states whose entry does not reach it."""
        return _shortfalls(self._rendered)

    @property
    def click_shortfalls(self) -> dict[float, int]:
        """By level: the number of clicks that do not reach it with quiet fingers kept quiet."""
        return _shortfalls(self._clicks)

    def suits_device_of(self, other: "Renderer") -> bool:
        """Whether both were encoded for devices with the same number format on the wire."""
        return self._wire == other._wire

    def fits(self, capabilities: Capabilities) -> bool:
        """Whether a device has the number format that the drives were encoded for."""
        return _wire_of(capabilities) == self._wire


def _shortfalls(rendered: Mapping[float, Mapping[int, _Rendered]]) -> dict[float, int]:
    return {
        level_db: sum(not rendered.is_achieved for rendered in states.values()) for level_db, states in rendered.items()
    }


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
