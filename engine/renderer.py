"""Zone state to the drive bytes of its command, encoded once when the table is opened."""

from collections.abc import Iterable

from engine.device import Device
from engine.entry import Entry
from engine.limits import Drive, clamp
from firmware_link.link_values import Capabilities
from firmware_link.messages import encode_drive


class RendererError(ValueError):
    """The table, the device description and the connected device do not belong together: which, and the remedy."""


class Renderer:
    """The drive of every state that has an entry.

    Raises RendererError when table, device and capabilities do not fit, LimitError for an entry that is broken.
    """

    def __init__(self, entries: Iterable[Entry], device: Device, capabilities: Capabilities) -> None:
        self.unknown_states = 0
        """How often a state was asked for that has no entry."""
        self._wire = _wire_of(capabilities)
        _check_actuators(device, capabilities)
        self._drives: dict[int, bytes] = {}
        for entry in entries:
            _check_zones(entry, device)
            drive = clamp(entry, device)
            _check_frequencies(entry, drive, capabilities)
            if entry.index in self._drives:
                raise RendererError(f"state {entry.index} has two entries: build the table again")
            self._drives[entry.index] = encode_drive(drive.channels, capabilities.frequency_resolution_hz)

    def render(self, state: int) -> bytes | None:
        """Drive bytes for `Link.set_drive`; None for silence: nothing touched, or a state without an entry."""
        if state == 0:
            return None
        drive = self._drives.get(state)
        self.unknown_states += drive is None
        return drive

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
