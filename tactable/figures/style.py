"""Parts that the figures share: colours, zones, actuators, the note on estimates, and the frame of a picture."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from base.arrays import Array, Field, Points
from base.plain import to_plain
from base.points import parts_of
from base.points import sides_of as point_sides
from engine.device import Device
from engine.device.quantity import GRAVITY_M_PER_S2
from tactable.explain.words import level_text as level_text
from tactable.figures.picture_file import Picture

if TYPE_CHECKING:  # as in picture_file.py: pages use the words of this module, and draw nothing
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from engine.touch import Placement

# Okabe and Ito's colours, told apart by the colour-blind.
BLUE, VERMILLION, GREEN, GREY, BLACK = "#0072B2", "#D55E00", "#009E73", "#999999", "#000000"
ROLE_COLOUR = {True: GREEN, False: VERMILLION}  # colours by whether a finger is to feel
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
COLOUR_MAP = "viridis"  # its brightness rises evenly, for the colour-blind and in print; absent values are grey
THRESHOLD_NOTE = "detection threshold"  # stands for the curve of the device, which the note under a picture names
FINGER_NOTE = "finger"
COMPUTED = "Computed, not measured."
_NOTE_LETTERS_PER_INCH, _TITLE_LETTERS_PER_INCH = 16, 12
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


PICTURE_POINTS, _POINTS_ALONG = 4000, 401  # less than a millimetre apart on a bar of 300 mm, 4 mm on a tablet


def surface_field(device: Device, most: int = PICTURE_POINTS) -> Field:
    """The points of a surface that a picture is drawn at: on a bar `most`, or 401; on a plate `most` in rows."""
    return Field.of(device.surface.corner_m, most, min(most, _POINTS_ALONG))


def sides_of(device: Device) -> dict[str, Callable[[Any], Any]]:
    """The sides of the surface in words, and what gives the coordinate of points along each (mm)."""
    sides = {f"along the {device.surface.kind}": lambda at_m: 1e3 * np.real(at_m)}
    return sides | {"across": lambda at_m: 1e3 * np.imag(at_m)} if is_plate(device) else sides


def is_plate(device: Device) -> bool:
    """Whether pictures show the surface from above."""
    return isinstance(device.surface.corner_m, complex)


def map_height(device: Device, width: float) -> float:
    """Height (inches) of a map of a plate that is so wide, with room for its title and axis."""
    return 0.9 + width * device.surface.corner_m.imag / device.surface.corner_m.real


def draw_map(axes: "Axes", device: Device, field: Field, values: Array, label: str, **limits: Any) -> Any:
    """Draw values (point,) of a field over a plate, seen from above (mm), with its zones, actuators and a scale.

    limits: vmin, vmax and cmap of the image, which is returned.
    """
    corner_m = device.surface.corner_m
    width_mm, height_mm = 1e3 * corner_m.real, 1e3 * corner_m.imag
    x_mm, y_mm = width_mm / (field.along - 1) / 2, height_mm / (field.across - 1) / 2  # half the sides of a pixel
    extent = (-x_mm, width_mm + x_mm, -y_mm, height_mm + y_mm)
    rows = values.reshape(field.across, field.along)
    image = axes.imshow(rows, origin="lower", extent=extent, interpolation="bilinear", **{"cmap": COLOUR_MAP, **limits})
    for zone in device.zones:
        left, low, right, high = (1e3 * side_m for at_m in (zone.start_m, zone.stop_m) for side_m in point_sides(at_m))
        axes.plot([left, right, right, left, left], [low, low, high, high, low], color="white", lw=0.5)
        axes.text(left + 2, low + 2, zone.name, fontsize="small", color="white")
    for actuator in device.actuators:
        axes.plot(1e3 * actuator.position_m.real, 1e3 * actuator.position_m.imag, "^", ms=7, mfc=BLACK, mec="white")
    across = list(sides_of(device))
    axes.set(xlabel=f"{across[0]} (mm)", ylabel=f"{across[1]} (mm)", xlim=(0, width_mm), ylim=(0, height_mm))
    axes.figure.colorbar(image, ax=axes, label=label, shrink=0.9)
    return image


def draw_values(axes: "Axes", image: Any, position_m: Points, values: ArrayLike) -> None:
    """Draw values (point,) at points on a map (mm), in circles of the colours of its image."""
    x, y = 1e3 * np.real(position_m), 1e3 * np.imag(position_m)
    axes.scatter(x, y, 36, values, cmap=image.cmap, norm=image.norm, edgecolors="white", linewidths=0.8, zorder=3)


def draw_fingers(axes: "Axes", placement: "Placement", texts: Sequence[str]) -> None:
    """Draw the fingers of a placement on a map (mm), each with its text, in the colour of its role."""
    for at_m, is_felt, text in zip(placement.position_m, placement.is_felt, texts, strict=True):
        place_mm = (1e3 * at_m.real, 1e3 * at_m.imag)
        axes.plot(*place_mm, "o", ms=11, mec="white", mew=1.5, color=ROLE_COLOUR[is_felt], zorder=4)
        box: dict[str, Any] = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8}
        at: dict[str, Any] = {"xytext": (0, 9), "textcoords": "offset points", "ha": "center"}
        axes.annotate(text, place_mm, fontsize="small", bbox=box, zorder=5, **at)


def position_columns(position_m: Points, header: str = "position (m)") -> dict[str, Array]:
    """Columns of data that say where points (point,) are: one on a bar, two on a plate."""
    columns = {header: np.real(position_m)}
    across = header.replace(" (m)", ", across (m)")
    return columns | {across: np.imag(position_m)} if np.iscomplexobj(position_m) else columns


def percent_of(device: Device, at_m: complex) -> float | list[float]:
    """A point in per cent of the sides of the surface: one number on a bar, two on a plate."""
    pairs = zip(parts_of(at_m), parts_of(device.surface.corner_m), strict=True)
    shares = [100 * part_m / side_m for part_m, side_m in pairs]
    return shares if len(shares) > 1 else shares[0]


def percents_text(device: Device, position_m: Sequence[complex]) -> str:
    """Points in words, such as "16, 97.7 %"."""
    shares = [np.atleast_1d(percent_of(device, at_m)) for at_m in position_m]
    return ", ".join(" x ".join(f"{share:.3g}" for share in each) for each in shares) + " %"


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
    lines = [caption, *(subtitle or "").split("\n")]
    wide = round(_TITLE_LETTERS_PER_INCH * figure.get_figwidth())
    figure.suptitle("\n".join(textwrap.fill(line, wide) for line in lines if line), fontsize="medium")
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
