"""Learns how a digitizer lies on the surface from strokes of a finger, for the table [digitizer] of the device file.

On a bar it takes one stroke from end to end. On a plate it takes two, the first along it and the second across it.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from base.files import write_text
from engine.touch import Digitizer, DigitizerError, TouchFrame
from engine.touch.descriptor import Surface

if TYPE_CHECKING:
    from engine.device import TouchAxis

# The centre of a finger cannot reach the edge of the surface: nearer than half a fingertip counts as at the edge.
FINGERTIP_MM = 6.0
_FINGERTIP = 0.02  # of the axis, where the device states no size
_SHORTEST_STROKE = 0.25  # of the axis
_STRAIGHT = 1.5  # travel along a side over travel across it


@dataclass(frozen=True)
class Stroke:
    """One finger from touch to lift: logical X and Y of each frame."""

    x: tuple[int, ...]
    y: tuple[int, ...]


@dataclass(frozen=True)
class LearntAxis:
    """How the digitizer lies along a side of the surface. A negative margin: the touch area reaches beyond that end.

    Margins are fractions of `length_mm`, or of the side's unknown length where that is None.
    """

    axis: Literal["x", "y"]
    flip: bool
    start_margin: float
    end_margin: float
    length_mm: float | None
    touch_mm: float | None  # length of the touch area as the device states it
    first: int
    last: int  # logical values at the start and end of the surface, as drawn
    notes: tuple[str, ...]
    across: "LearntAxis | None" = None  # on a plate: how it lies across it

    def margin_text(self, margin: float) -> str:
        """A margin as text of a device file."""
        if self.length_mm is None:
            return f"{100 * margin:.3g} %"
        return f"{margin * self.length_mm:.3g} mm"


def _strokes_of(frames: Iterable[TouchFrame]) -> Iterator[Stroke]:
    """Each stroke when its finger lifts, or when no more frames come."""
    paths: dict[int, list[tuple[int, int]]] = {}
    for frame in frames:
        down = {contact.contact_id: contact for contact in frame.contacts if contact.tip}
        for contact_id in paths.keys() - down.keys():
            yield Stroke(*zip(*paths.pop(contact_id), strict=True))
        for contact_id, contact in down.items():
            paths.setdefault(contact_id, []).append((contact.x, contact.y))
    for path in paths.values():
        yield Stroke(*zip(*path, strict=True))


def find_strokes(
    digitizer: Digitizer, frames: Iterable[TouchFrame], count: int = 1, *, is_live: bool = False
) -> list[Stroke]:
    """The longest stroke in the digitizer's frames, or of two the longest along each axis, in the order of time.

    Of a live digitizer they are the first that are long enough. Raises `DigitizerError` where nothing was touched, or
    where no stroke goes along one of the axes.
    """
    longest = dict[bool, tuple[float, int, Stroke]]()
    for number, stroke in enumerate(_strokes_of(frames)):
        x, y = _travel(digitizer.surface, stroke)
        kind = count > 1 and y > x
        if kind not in longest or max(x, y) > longest[kind][0]:
            longest[kind] = max(x, y), number, stroke
        if is_live and len(longest) == count and min(travel for travel, *_ in longest.values()) >= _SHORTEST_STROKE:
            break
    if not longest:
        reason = digitizer.foreign_notice or "draw one finger from one end of the surface to the other"
        raise DigitizerError(f"nothing was touched: {reason}")
    if len(longest) < count:
        raise DigitizerError("all strokes go along one axis: draw one finger along the plate, then one across it")
    return [stroke for _, _, stroke in sorted(longest.values(), key=lambda found: found[1])]


def learn(
    digitizer: Digitizer, frames: Iterable[TouchFrame], sides_mm: Sequence[float | None], *, is_live: bool = False
) -> LearntAxis:
    """How the digitizer lies, from a stroke along each side of the surface, in this order; `sides_mm` where known.

    Raises what `find_strokes` and `learn_axis` raise.
    """
    strokes = find_strokes(digitizer, frames, len(sides_mm), is_live=is_live)
    learnt = [learn_axis(digitizer.surface, *each) for each in zip(strokes, sides_mm, strict=True)]
    return replace(learnt[0], across=learnt[1] if learnt[1:] else None)


def learn_axis(surface: Surface, stroke: Stroke, length_mm: float | None = None) -> LearntAxis:
    """Axis, direction and margins from a stroke from end to end; `length_mm` is that of the side where it is known.

    Raises `DigitizerError` for a stroke that is too short or too slanted to tell the axis.
    """
    axis = _axis_of(surface, stroke)
    field, values, touch_mm = (
        (surface.x, stroke.x, surface.x.extent_mm) if axis == "x" else (surface.y, stroke.y, surface.y.extent_mm)
    )
    flip = values[-1] < values[0]
    low, high = min(values), max(values)
    span = field.logical_maximum - field.logical_minimum
    gaps = [(low - field.logical_minimum) / span, (field.logical_maximum - high) / span]
    first, last = (high, low) if flip else (low, high)
    margins, notes = _margins(gaps[::-1] if flip else gaps, touch_mm, length_mm)
    drawn_mm = None if touch_mm is None else (1 - sum(gaps)) * touch_mm
    return LearntAxis(axis, flip, *margins, length_mm or drawn_mm, touch_mm, first, last, notes)


def _axis_of(surface: Surface, stroke: Stroke) -> Literal["x", "y"]:
    x, y = _travel(surface, stroke)
    if max(x, y) < _SHORTEST_STROKE:
        raise DigitizerError(
            f"the longest stroke goes over {100 * max(x, y):.0f} % of the touch area: "
            "draw one finger from one end to the other without lifting it"
        )
    if surface.x.extent_mm is not None and surface.y.extent_mm is not None:
        x, y = x * surface.x.extent_mm, y * surface.y.extent_mm
    if max(x, y) < _STRAIGHT * min(x, y):
        raise DigitizerError("the longest stroke goes as far across as along: draw it straight along the surface")
    return "x" if x > y else "y"


def _travel(surface: Surface, stroke: Stroke) -> tuple[float, float]:
    """Distance from the first place to the last, as fractions of both axes."""
    x, y = (
        abs(values[-1] - values[0]) / (field.logical_maximum - field.logical_minimum)
        for values, field in ((stroke.x, surface.x), (stroke.y, surface.y))
    )
    return x, y


def _margins(
    gaps: list[float], touch_mm: float | None, length_mm: float | None
) -> tuple[tuple[float, float], tuple[str, ...]]:
    """Both margins as fractions of the side, from the parts of the touch area before and after the stroke.

    Lengths are in units of the touch area. A stroke that reaches the edge of the touch area says only that the
    surface reaches at least that far. A stroke that ends before it says where it ends, up to the distance by which the
    finger stopped short, which is taken as equal at both ends.
    """
    tip = _FINGERTIP if touch_mm is None else FINGERTIP_MM / touch_mm
    start_gap, end_gap = (0.0 if gap <= tip else gap for gap in gaps)
    drawn = 1 - start_gap - end_gap
    side = drawn if length_mm is None or touch_mm is None else length_mm / touch_mm
    missing = side - drawn
    notes = []
    if missing < -2 * tip:
        notes.append("the stroke is longer than the surface: is this the description of this surface?")
    if (start_gap == 0) == (end_gap == 0):
        start, end = missing / 2 - start_gap, missing / 2 - end_gap
        if missing > 2 * tip:
            notes.append("the surface is longer than the stroke, taken to lie in its middle: measure both margins")
    elif start_gap == 0:
        start, end = missing, -end_gap
    else:
        start, end = -start_gap, missing
    start, end = (0.0 if abs(margin) <= tip else margin for margin in (start, end))
    if min(start, end) < 0:
        notes.append("the touch area reaches beyond the surface: margins below 0; touches there count as at its edge")
    return (start / side, end / side), tuple(notes)


def digitizer_table(learnt: LearntAxis, before: "TouchAxis | None" = None) -> str:
    """The table as text of a device file; `before`: of the device, whose times of release it keeps."""
    times_s = () if before is None else (("silence", before.silence_s), ("debounce", before.debounce_s))
    return "\n".join(
        (
            "[digitizer] # learned by `tactable map`",
            f'axis = "{learnt.axis}"',
            *_lines(learnt, ""),
            *(() if learnt.across is None else _lines(learnt.across, "_across")),
            *(f'{key} = "{1e3 * time_s:g} ms"' for key, time_s in times_s if time_s),
        )
    )


def write_digitizer(path: Path, table: str) -> None:
    """Write the text of a [digitizer] table into a device file; it replaces an earlier [digitizer] table.

    The rest of the file stays as it is. Raises DeviceError where the new text is no valid device file; then nothing is
    written.
    """
    from engine.device import Device  # only who writes a file needs it
    from engine.device.named_files import document_of

    document = document_of(path.read_text(encoding="utf-8"), str(path))
    document["digitizer"] = document_of(table, str(path))["digitizer"]
    text = document.as_string()
    Device.parse(text, str(path))
    write_text(path, text)


def _lines(learnt: LearntAxis, suffix: str) -> tuple[str, ...]:
    return (
        f"flip{suffix} = {str(learnt.flip).lower()}",
        f'start_margin{suffix} = "{learnt.margin_text(learnt.start_margin)}"',
        f'end_margin{suffix} = "{learnt.margin_text(learnt.end_margin)}"',
    )
