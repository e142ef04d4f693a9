"""Parts that the figures share: colours, zones, actuators, the note on estimates, and the frame of a picture."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from base.plain import to_plain
from engine.device import Device
from engine.device.quantity import GRAVITY_M_PER_S2
from tactable.explain.words import level_text as level_text
from tactable.figures.picture_file import Picture

if TYPE_CHECKING:  # as in picture_file.py: pages use the words of this module, and draw nothing
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart by the colour-blind.
BLUE, VERMILLION, GREEN, GREY, BLACK = "#0072B2", "#D55E00", "#009E73", "#999999", "#000000"
ROLE_COLOUR = {True: GREEN, False: VERMILLION}
"""Colours by whether a finger is to feel."""
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
"""Its brightness rises evenly, for the colour-blind and in print. It has no grey, which stands for absent values."""
THRESHOLD_NOTE = "detection threshold"
"""Stands for the curve of the device, which the note under a picture names."""
FINGER_NOTE = "finger"
COMPUTED = "Computed, not measured."
_NOTE_LETTERS_PER_INCH = 16
Columns = Mapping[str, Sequence[Any] | NDArray[Any]]


def draw_zone_names(axes: "Axes", device: Device, names: Sequence[str] | None = None) -> None:
    """Draw the edges of the zones over the bar (mm), and above them their names, or other `names`."""
    draw_zone_edges(axes, device)
    above = axes.get_xaxis_transform()
    for zone, name in zip(device.zones, names or [zone.name for zone in device.zones], strict=True):
        axes.text(1e3 * zone.middle_m.real, 0.98, name, ha="center", va="top", fontsize="small", transform=above)


def draw_zone_edges(axes: "Axes", device: Device, ls: str = "-") -> None:
    """Draw a vertical line at every edge of a zone (mm)."""
    for zone in device.zones:
        for edge_m in (zone.start_m, zone.stop_m):
            axes.axvline(1e3 * edge_m.real, color=GREY, lw=0.5, ls=ls)


def draw_actuators(axes: "Axes", device: Device) -> None:
    """Draw a triangle with its name under the bar (mm) for each actuator."""
    under = axes.get_xaxis_transform()
    text: dict[str, Any] = {"xytext": (0, 6), "textcoords": "offset points", "ha": "center", "fontsize": "small"}
    for actuator in device.actuators:
        place_mm = 1e3 * actuator.position_m
        axes.plot(place_mm, 0.015, "^", ms=9, color=BLACK, transform=under, clip_on=False)
        axes.annotate(actuator.name, (place_mm, 0.03), xycoords=under, **text)


def draw_gravities(axes: "Axes") -> None:
    """Draw a second axis on the right, in g."""
    draw_scaled(axes.secondary_yaxis, "right", 1 / GRAVITY_M_PER_S2).set_ylabel("(g)")


def draw_scaled(secondary: Callable[..., Any], side: str, factor: float) -> Any:
    """Draw a second axis whose values are `factor` times the first's; `secondary` makes it."""
    functions = (lambda value: np.asarray(value) * factor, lambda value: np.asarray(value) / factor)
    return secondary(side, functions=functions)


def finish_picture(
    figure: "Figure",
    device: Device,
    caption: str,
    words: str,
    columns: Columns,
    summary: Mapping[str, Any],
    *,
    notes: Sequence[str] = (FINGER_NOTE, THRESHOLD_NOTE),
    subtitle: str | None = None,
    origin: str = COMPUTED,
) -> Picture:
    """The picture of a figure, with title, note on estimates, and a summary that names the device.

    `words` follow the caption in the one line that describes the picture; `subtitle` stands below it in the picture.
    """
    figure.suptitle(caption if subtitle is None else f"{caption}\n{subtitle}", fontsize="medium")
    number = len(device.estimated_values)
    estimates = [device.threshold.note if each == THRESHOLD_NOTE else each for each in notes]
    estimates += [f"{number} values of the device that its file names"] if number else []
    note = f"{origin} ESTIMATES: {', '.join(estimates)}." if estimates else origin
    wrapped = textwrap.fill(note, round(_NOTE_LETTERS_PER_INCH * figure.get_figwidth()))
    figure.supxlabel(wrapped, fontsize="x-small", color="dimgrey", x=0.01, ha="left")
    named = {"device": device.name, "fingerprint": device.fingerprint, **summary}
    if THRESHOLD_NOTE in notes:
        named["threshold"] = device.threshold.title
    plain = to_plain({**named, "estimated": [*notes, *device.estimated_values]})
    # A CSV file has no note below it: its headers name the curve.
    headed = {name.replace("above threshold", device.threshold.above): values for name, values in columns.items()}
    return Picture(figure, headed, plain, f"{caption}: {words}")
