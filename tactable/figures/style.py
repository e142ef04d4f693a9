"""What the figures share: colours, zones, actuators, and notes on estimates."""

import math
import textwrap
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from engine.device import Device
from engine.touch import ZoneState

if TYPE_CHECKING:  # as in figure_file: pages use the words of this module, and draw nothing
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart by the colour-blind.
BLUE, VERMILLION, GREEN, GREY, BLACK = "#0072B2", "#D55E00", "#009E73", "#999999", "#000000"
STATE_COLOUR = {ZoneState.FREE: GREY, ZoneState.QUIET: VERMILLION, ZoneState.FELT: GREEN}
ORANGE, PURPLE = "#E69F00", "#CC79A7"
CURVES: tuple[tuple[str, Any], ...] = (
    (BLUE, "-"),
    (VERMILLION, "--"),
    (GREEN, "-."),
    (PURPLE, ":"),
    (ORANGE, (0, (5, 1, 1, 1, 1, 1))),
    (BLACK, (0, (8, 2))),
)
"""Colour and line of curves that are compared: told apart in grey, too."""
COLOUR_MAP = "viridis"
"""Brightness rises evenly, for the colour-blind and in print; no grey in it, which stands for nothing there."""
THRESHOLD_NOTE = "detection threshold (within 8 dB between people)"
FINGER_NOTE = "finger"
COMPUTED = "Computed, not measured."
STANDARD_GRAVITY_M_PER_S2 = 9.80665
_NOTE_LETTERS_PER_INCH = 16


def level_text(level_db: float) -> str:
    """Such as "20 dB"; infinite is full scale."""
    return "full scale" if math.isinf(level_db) else f"{level_db:g} dB"


def finite(value: float | None) -> float | None:
    """The value for JSON, which has no infinity: None instead."""
    return value if value is not None and math.isfinite(value) else None


def zone_names(device: Device, states: Sequence[ZoneState], kind: ZoneState) -> list[str]:
    """Names of the zones in one state."""
    return [zone.name for zone, state in zip(device.zones, states, strict=True) if state is kind]


def state_text(device: Device, states: Sequence[ZoneState]) -> str:
    """Such as "I felt, IV quiet"."""
    named = {kind: ", ".join(zone_names(device, states, kind)) for kind in (ZoneState.FELT, ZoneState.QUIET)}
    return ", ".join(f"{names} {kind.name.lower()}" for kind, names in named.items() if names)


def draw_zones(axes: "Axes", device: Device, states: Sequence[ZoneState]) -> None:
    """Zones as bands over the bar (mm), coloured by state, named above it."""
    for zone, state in zip(device.zones, states, strict=True):
        if state is not ZoneState.FREE:
            axes.axvspan(1e3 * zone.start_m, 1e3 * zone.stop_m, color=STATE_COLOUR[state], alpha=0.16, lw=0)
    draw_zone_names(
        axes,
        device,
        [f"{zone.name}\n{state.name.lower()}" for zone, state in zip(device.zones, states, strict=True)],
    )


def draw_zone_names(axes: "Axes", device: Device, names: Sequence[str] | None = None) -> None:
    """Edges of the zones over the bar (mm), and above them their names, or other `names`."""
    for zone, name in zip(device.zones, names or [zone.name for zone in device.zones], strict=True):
        for edge_m in (zone.start_m, zone.stop_m):
            axes.axvline(1e3 * edge_m, color=GREY, lw=0.5)
        axes.text(
            500 * (zone.start_m + zone.stop_m),
            0.98,
            name,
            ha="center",
            va="top",
            fontsize="small",
            transform=axes.get_xaxis_transform(),
        )


def draw_actuators(axes: "Axes", device: Device) -> None:
    """A triangle under the bar (mm) for each actuator, with its name."""
    for actuator in device.actuators:
        place_mm = 1e3 * actuator.position_m
        under = axes.get_xaxis_transform()
        axes.plot(place_mm, 0.015, "^", ms=9, color=BLACK, transform=under, clip_on=False)
        axes.annotate(
            actuator.name,
            (place_mm, 0.03),
            xycoords=under,
            xytext=(0, 6),
            textcoords="offset points",
            ha="center",
            fontsize="small",
        )


def draw_gravities(axes: "Axes") -> None:
    """The same accelerations in g on the right."""
    draw_scaled(axes.secondary_yaxis, "right", 1 / STANDARD_GRAVITY_M_PER_S2).set_ylabel("(g)")


def draw_scaled(secondary: Callable[..., Any], side: str, factor: float) -> Any:
    """A second axis whose values are `factor` times the first's; `secondary` is what makes it."""

    def forth(value: Any) -> Any:
        return np.asarray(value) * factor

    def back(value: Any) -> Any:
        return np.asarray(value) / factor

    return secondary(side, functions=(forth, back))


def draw_note(figure: "Figure", device: Device, *estimates: str, origin: str = COMPUTED) -> None:
    """Below everything: that it is computed, and what rests on estimates."""
    listed = [f"{len(device.inferred)} values of the device that its file names"] if device.inferred else []
    known = [*estimates, *listed]
    note = f"{origin} ESTIMATES: {', '.join(known)}." if known else origin
    wrapped = textwrap.fill(note, round(_NOTE_LETTERS_PER_INCH * figure.get_figwidth()))
    figure.supxlabel(wrapped, fontsize="x-small", color="dimgrey", x=0.01, ha="left")
