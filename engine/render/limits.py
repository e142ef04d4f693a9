"""Limits of a device: clamps what was solved to drives, and gives the firmware the limits that it enforces itself."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from base.errors import TactableError
from engine.device import Actuator, Device, Limits
from firmware_link.host.link_values import LinkConfiguration
from firmware_link.protocol.drive_words import ChannelDrive, encode_drive

# Quotients such as 1 / (5 ms) fall short of the whole number they stand for by a few units in the last place.
_ROUNDING = 1e-9


class LimitError(TactableError, ValueError):
    """A drive that clamping cannot correct: the table belongs to another device, or is broken."""


class Solved(Protocol):
    """A drive as it was solved, by actuator: a best row of a table, or one for fingers at their positions."""

    @property
    def frequencies_hz(self) -> Sequence[float]:
        """Frequency of each actuator."""

    @property
    def amplitudes(self) -> Sequence[float]:
        """Fractions of full scale."""

    @property
    def phases_rad(self) -> Sequence[float]:
        """Phase of each actuator."""


@dataclass(frozen=True)
class Drive:
    """The steady output of all actuators, in the device's order, within its limits. Only `clamp` makes one."""

    channels: tuple[ChannelDrive, ...]


def clamp(solved: Solved, device: Device) -> Drive:
    """The drive as it may be played, with amplitudes of at most `limits.amplitude` (fractions of full scale).

    All channels are scaled by one factor, which keeps their ratio and with it the localized factor. A silent actuator
    gets the frequency in its band nearest to the one solved. Raises LimitError for another number of actuators, a value
    that is not finite, an amplitude below 0, and a sounding actuator with a frequency outside its band.
    """
    requested = _channels(solved, device)
    greatest = max(channel.amplitude for channel in requested)
    limit = device.limits.amplitude
    scale = min(1.0, limit / greatest) if greatest > 0 else 1.0
    return Drive(
        tuple(
            _bounded(channel, actuator, scale, limit)
            for channel, actuator in zip(requested, device.actuators, strict=True)
        )
    )


def encode_scaled(drive: Drive, scales: Sequence[float], frequency_resolution_hz: float) -> bytes:
    """Bytes of a drive for a board that takes amplitudes multiplied by these `scales`, by actuator (`board_fit`)."""
    channels = (
        replace(channel, amplitude=min(1.0, channel.amplitude * scale))
        for channel, scale in zip(drive.channels, scales, strict=True)
    )
    return encode_drive(list(channels), frequency_resolution_hz)


def link_configuration(
    device: Device, bit_rate_hz: int = 115_200, scales: Sequence[float] | None = None
) -> LinkConfiguration:
    """The limits of the device as the link gives them to the firmware, which enforces them by itself.

    `scales` are those of `board_fit`, by actuator; None: 1. The slew, one for all actuators, is scaled by the greatest,
    so that every actuator is silent within `limits.ramp`. Raises LimitError for a slew of less than 1 full scale a
    second, the least that the wire can express.
    """
    limits = device.limits
    number_of_actuators = len(device.actuators)
    factors = scales or (1.0,) * number_of_actuators
    return LinkConfiguration(
        number_of_actuators,
        amplitude_limits=tuple(min(1.0, limits.amplitude * factor) for factor in factors),
        slew_limit_per_s=_slew_limit_per_s(device.name, limits, max(factors)),
        lease_ms=max(1, math.floor(1e3 * limits.lease_s * (1 + _ROUNDING))),
        bit_rate_hz=bit_rate_hz,
    )


def _channels(solved: Solved, device: Device) -> list[ChannelDrive]:
    values = (solved.frequencies_hz, solved.amplitudes, solved.phases_rad)
    if any(len(each) != len(device.actuators) for each in values):
        raise LimitError(
            f"a drive for {len(solved.frequencies_hz)} actuators, {device.name} has "
            f"{len(device.actuators)}: build the table for this device"
        )
    channels = [ChannelDrive(*channel) for channel in zip(*values, strict=True)]
    for channel, actuator in zip(channels, device.actuators, strict=True):
        _check(channel, actuator)
    return channels


def _check(channel: ChannelDrive, actuator: Actuator) -> None:
    where = f"actuator {actuator.name}"
    values = (channel.frequency_hz, channel.amplitude, channel.phase_rad)
    if None in values or not all(map(math.isfinite, values)):  # None: a value that a table marks as absent, a NaN
        raise LimitError(f"{where}: {channel}: expected finite values; the table is broken: build it again")
    if channel.amplitude < 0:
        raise LimitError(f"{where}: amplitude {channel.amplitude}: expected 0 or more; build the table again")
    low_hz, high_hz = actuator.band_hz
    if channel.amplitude > 0 and not low_hz <= channel.frequency_hz <= high_hz:
        raise LimitError(
            f"{where}: {channel.frequency_hz:g} Hz is outside its band, {low_hz:g}-{high_hz:g} Hz: "
            "build the table again for this device"
        )


def _bounded(channel: ChannelDrive, actuator: Actuator, scale: float, limit: float) -> ChannelDrive:
    low_hz, high_hz = actuator.band_hz
    return ChannelDrive(
        frequency_hz=min(max(channel.frequency_hz, low_hz), high_hz),
        # A product may round up beyond the limit.
        amplitude=min(channel.amplitude * scale, limit),
        phase_rad=channel.phase_rad,
    )


def _slew_limit_per_s(name: str, limits: Limits, factor: float) -> int:
    slew_per_s = math.floor(limits.slew_per_s * factor * (1 + _ROUNDING))
    if slew_per_s < 1:
        raise LimitError(f"{name}: limits.ramp: {1 / limits.slew_per_s:g} s: the firmware ramps within 1 s at most")
    return min(slew_per_s, 65_535)
