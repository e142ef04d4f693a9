"""Doubts about fitted values that lie far from those of the device file: a wrong unit fits as well as the right one.

The model is linear in the drive. So a column of readings whose unit is wrong by a factor fits as closely as the right
one, with a full scale that is wrong by that factor, and no misfit tells. What tells is the device file: its values come
from data sheets, scales and rulers, and are seldom wrong by more than a factor of two or three. Of the usual mistakes,
m/s^2 for g_0 is a factor of 9.8, inches for millimetres 25, peak to peak for peak 2. Dampings are excepted up to a
factor of ten, since they are guesses before the first calibration. A value that the measurements hardly tell is no
doubt: all of its 95 % interval must lie that far off.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from engine.device.quantity import quantity_text

_FACTORS = {"full_scale": 1.9, "damping": 10.0}
"""Greatest credible factor between the value before and the fitted one, by what the parameter's name ends in."""
_FACTOR = 3.0  # as above: values of sheets, scales and rulers are seldom wrong by more


def implausible_changes(parameters: Sequence[Mapping[str, Any]]) -> list[str]:
    """One sentence for each fitted value that is implausibly far from the one before.

    `parameters` as in a calibration's report: "name", "before", "value", "interval" and "unit".
    """
    doubts = []
    for parameter in parameters:
        before, value = parameter["before"], parameter["value"]
        limit = next((limit for end, limit in _FACTORS.items() if end in parameter["name"]), _FACTOR)
        low, high = parameter["interval"]
        if min(before, value) <= 0 or (low <= limit * before and high * limit >= before):
            continue
        texts = [quantity_text(each, parameter["unit"]) for each in (value, before)]
        doubts.append(
            f"{parameter['name']} is fitted as {texts[0]}, before it was {texts[1]}, {value / before:.2g} times that: "
            "check the units of the measurements, then the device file"
        )
    return doubts
