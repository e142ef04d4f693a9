"""The form of a CSV text that is not one reading a row: a sentence that names it, with an example of the right one.

Programs export measurements in forms of their own: with semicolons, as a wide table with one column for each frequency
or place, or as a time series. Such a file fails at its first header cell for a reason that does not help, such as a
missing unit. So the form is looked at first. Nothing is guessed: a file in another form is refused, since which column
is which place or drive is not known.
"""

import re
from collections.abc import Sequence

from engine.device import Device

_NUMBER = re.compile(r"[-+]?\d+([.,]\d+)?([eE][-+]?\d+)?")
_QUANTITY = re.compile(rf"({_NUMBER.pattern}) *(Hz|kHz|mm|cm|m|%)?")
_TIME = re.compile(r"(t|time|zeit|temps|timestamp|seconds?)\b.*", re.IGNORECASE)
_DAMPING = re.compile(r"(modal )?damping|loss factor|q\b", re.IGNORECASE)
_LEAST_COLUMNS = 2
_SHOWN = 32  # enough to know a line again


def example_csv(device: Device) -> str:
    """Header and a row of the right form for this device, as one line of text."""
    names = [actuator.name for actuator in device.actuators]
    header = ["position (mm)", *(f"frequency {name} (Hz)" for name in names), "peak acceleration (m/s^2)"]
    row = [f"{1e3 * device.bar.length_m / 4:.1f}", *(f"{150 - 20 * i}" for i in range(len(names))), "0.84"]
    return f"{','.join(header)!r}, then rows such as {','.join(row)!r}"


def wrong_form(lines: Sequence[str], device: Device) -> str | None:
    """What the form of these lines (header first, without comments) is, and the right one; None if it may be right."""
    header = lines[0]
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if mark in header and header.count(mark) >= header.count(","):
            decimals = " and decimal points" if any(re.search(r"\d,\d", line) for line in lines[1:]) else ""
            return f"separates its cells by {name}; write commas{decimals}: {example_csv(device)}"
    cells = [cell.strip().strip('"') for cell in header.split(",")]
    if all(_NUMBER.fullmatch(cell) for cell in cells):
        return f"has no header: its first line is {header[:_SHOWN]!r}; write one: {example_csv(device)}"
    if _TIME.fullmatch(cells[0]):
        return (
            f"is a time series: its first column is {cells[0]!r}; write one amplitude a row, such as the peak over "
            f"several beats: {example_csv(device)}"
        )
    wide = [cell for cell in cells[1:] if _QUANTITY.fullmatch(cell)]
    if len(wide) >= _LEAST_COLUMNS:
        return (
            f"is a wide table: {wide[0]!r} and {wide[1]!r} are columns of readings; write one reading a row: "
            f"{example_csv(device)}"
        )
    if any(_DAMPING.match(cell) for cell in cells):
        return f"has modes, as its header {header[:_SHOWN]!r} says; give --modes to fit these"
    return None
