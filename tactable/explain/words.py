"""Levels, zones and states of a table in words, for pages, pictures and JSON alike."""

import math
from collections.abc import Sequence

from engine.device import Device
from engine.touch import ZoneState


def finger_text(position_m: float, is_felt: bool) -> str:
    """A finger in words, such as "35 mm felt"."""
    return f"{1e3 * position_m:.4g} mm {'felt' if is_felt else 'quiet'}"


def level_text(level_db: float) -> str:
    """A level in words, such as "20 dB"; an infinite one is full scale."""
    return "full scale" if math.isinf(level_db) else f"{level_db:g} dB"


def zone_names(device: Device, states: Sequence[ZoneState], kind: ZoneState) -> list[str]:
    """Names of the zones in one state."""
    return [zone.name for zone, state in zip(device.zones, states, strict=True) if state is kind]


def zone_lists(device: Device, states: Sequence[ZoneState]) -> dict[str, list[str]]:
    """Names of the felt and of the quiet zones, for a summary."""
    return {kind.name.lower(): zone_names(device, states, kind) for kind in (ZoneState.FELT, ZoneState.QUIET)}


def state_text(device: Device, states: Sequence[ZoneState]) -> str:
    """States of the zones in words, such as "I felt, IV quiet"."""
    return ", ".join(f"{', '.join(names)} {kind}" for kind, names in zone_lists(device, states).items() if names)
