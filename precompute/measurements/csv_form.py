"""The form of a table that holds no readings of a bar: a sentence that names it, with an example of the right one.

Programs export time series and spectra in tables that look like measurements. Such a table fails at its first heading
for a reason that does not help, such as a missing unit. So the form is looked at first, and the remedy is said.
"""

import re
from collections.abc import Sequence

import numpy as np

from engine.device import Device
from precompute.measurements.columns import split_places
from precompute.measurements.sheet import has_no_header

_TIME = re.compile(r"(t|time|zeit|temps|timestamp|seconds?)\b.*", re.IGNORECASE)
_DENSITY = re.compile(r"\bpsd", re.IGNORECASE)
_DAMPING = re.compile(r"(modal )?damping|loss factor|q\b", re.IGNORECASE)
_SHOWN = 32  # enough to know a line again


def example_csv(device: Device) -> str:
    """Header and a row of the right form for this device, as one line of text."""
    names = [actuator.name for actuator in device.actuators]
    place_m = split_places(device, "position", np.array([device.surface.corner_m]) / 4)
    header = [f"{name} (mm)" for name in place_m]
    header += [*(f"frequency {name} (Hz)" for name in names), "peak acceleration (m/s^2)"]
    row = [f"{1e3 * part_m[0]:.1f}" for part_m in place_m.values()]
    row += [*(f"{150 - 20 * i}" for i in range(len(names))), "0.84"]
    return f"{','.join(header)!r}, then rows such as {','.join(row)!r}"


def wrong_form(titles: Sequence[str], device: Device) -> str | None:
    """What the form of a table with these titles is, and what to do; None if it may be right."""
    first = ",".join(titles)[:_SHOWN]
    if has_no_header(titles):
        return f"has no header: its first line is {first!r}; write one: {example_csv(device)}"
    whose = " of Klipper" if any(title.lower().startswith(("psd_", "accel_x")) for title in titles) else ""
    if any(_DENSITY.search(title) for title in titles):
        return f"holds power spectral densities{whose}, which have neither phase nor drive; {_remedy(device)}"
    if _TIME.fullmatch(titles[0]):
        unit = ", in mm/s^2" if whose else ""
        return f"is a time series{whose}{unit}: its first column is {titles[0]!r}; {_remedy(device)}"
    if any(_DAMPING.match(title) for title in titles):
        return f"has modes, as its header {first!r} says; give --modes to fit these"
    return None


def _remedy(device: Device) -> str:
    return (
        "`tactable measure` makes responses with a drive that it plays. Of a record of acceleration and drive, write "
        "their complex ratio at each frequency that was driven (scipy.signal.csd over scipy.signal.welch), the drive "
        f"in fractions of full scale; of the acceleration alone, the peak over several beats: {example_csv(device)}"
    )
