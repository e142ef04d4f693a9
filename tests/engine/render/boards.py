"""Boards that a table is rendered for."""

from dataclasses import replace

from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.messages import Features

FULL_SCALE_M = 0.52e-6
"""Of the actuators of reference-a."""


def plain_board(*full_scales_m: float) -> Capabilities:
    """A board that plays no waveforms; by default of two actuators of reference-a's full scale."""
    full_scales_m = full_scales_m or (FULL_SCALE_M, FULL_SCALE_M)
    return Capabilities(len(full_scales_m), 0.01, 1.0, 655.35, full_scales_m, 100, 48_000, 1, 0)


def board(*full_scales_m: float, **changed: object) -> Capabilities:
    """One that plays waveforms, with other values."""
    room = {"features": Features.WAVEFORMS, "longest_waveform_ms": 100, "basis_capacity_bytes": 1 << 18}
    return replace(plain_board(*full_scales_m), **(room | changed))  # type: ignore[arg-type]  # by name
