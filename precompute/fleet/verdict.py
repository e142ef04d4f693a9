"""One verdict for each measured bar of a lot, PASS, RETEST or REJECT, from the reports of their calibrations.

The judge of a fit (precompute.calibration.adequacy) judges every bar by itself. Beyond it every fitted value is
compared with the limits that are stated for it or, where none are, with the other bars of the lot. What speaks against
the bar rejects it; what speaks only against its readings asks for them once more. Values that the readings cannot tell
are not compared, and dampings only with stated limits: they vary by factors between good bars.
"""

import math
import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from base.points import point_of_json, point_text
from engine.device.quantity import interval_text, quantity_text
from engine.device.toml_table import TomlTable, read_text
from engine.device.uncertainty import FITTED_UNITS
from precompute.calibration.adequacy import doubts_of, speaks_against_the_device
from precompute.calibration.calibrate import Known
from precompute.calibration.calibration_report import phase_text
from precompute.fleet.units import FleetError, Outcome

LIMITS = "limits.toml"  # file of the stated limits, in the folder of the units or beside their manifest
FEWEST = 8  # a unit is compared with its lot if at least this many units tell the value
_SPREADS = 5.0  # robust standard deviations from the median of the lot beyond which a value is off
_LEAST_SPREAD = 0.01  # of the median; estimate of how closely bars are made and measured
_WRONG_FACTOR = 1.1  # or 5.5 degrees; smaller errors change a fit little, and noise makes some among hundreds
_NORMAL_MAD = 1.4826  # standard deviation of normal noise over its median absolute deviation
_TOLD = (Known.WELL.value, Known.ROUGHLY.value)
Limits = Mapping[str, tuple[float, float]]


class Judgement(Enum):
    """What is to be done with a bar."""

    PASS = "PASS"
    RETEST = "RETEST"
    REJECT = "REJECT"


@dataclass(frozen=True)
class Verdict:
    """The judgement of one bar, with the reasons for it, the weightiest first."""

    judgement: Judgement
    reasons: tuple[str, ...]


class _LimitsFile(TomlTable):
    family = FleetError


def read_limits(source: Path) -> Limits:
    """Least and greatest value in SI by name, from the file of limits that belongs to the units of `source`.

    Without such a file there are none. Raises FleetError.
    """
    path = (source if source.is_dir() else source.parent) / LIMITS
    if not path.exists():
        return {}
    file, limits = _LimitsFile.parse(read_text(path, FleetError), str(path)), dict[str, tuple[float, float]]()
    for name, ends in file.left.items():
        unit = FITTED_UNITS.get(_of_all(name))
        if unit is None:
            raise file.error(name, ends, f"expected a name in quotation marks, one of {', '.join(FITTED_UNITS)}")
        if not isinstance(ends, list) or len(ends) != 2:
            raise file.error(name, ends, "expected the least and the greatest value, such as ['17 kN/m', '21 kN/m']")
        low, high = (file.checked(name, end, unit) for end in ends)
        if low > high:
            raise file.error(name, ends, "expected the lower limit first")
        limits[name] = low, high
    return limits


def _of_all(name: str) -> str:
    """The name of the same value of all actuators: actuator.mass for actuator[2].mass."""
    return re.sub(r"\[\d+\]", "", name)


@dataclass(frozen=True)
class LotValue:
    """A value over the bars of a lot: its median and its robust standard deviation."""

    median: float
    spread: float

    @property
    def judged_spread(self) -> float:
        """The spread that a bar is compared with, at least 1 % of the median."""
        return max(self.spread, _LEAST_SPREAD * abs(self.median)) or _LEAST_SPREAD


def lot_values(outcomes: Sequence[Outcome]) -> dict[str, LotValue]:
    """Median and spread of each fitted value that at least FEWEST bars tell."""
    found: dict[str, list[float]] = {}
    for outcome in outcomes:
        for each in outcome.report.get("parameters", ()):
            if each["known"] in _TOLD:
                found.setdefault(each["name"], []).append(each["value"])
    return {name: lot_value(values) for name, values in found.items() if len(values) >= FEWEST}


def lot_value(values: Sequence[float]) -> LotValue:
    """Median and spread of the values of one name."""
    median = statistics.median(values)
    spread = _NORMAL_MAD * statistics.median(abs(value - median) for value in values)
    return LotValue(median, spread)


def limit_of(name: str, limits: Limits) -> tuple[float, float] | None:
    """The limits of a value: stated for it, or for the same value of all actuators."""
    return limits.get(name, limits.get(_of_all(name)))


def judge(outcome: Outcome, limits: Limits, lot: Mapping[str, LotValue]) -> Verdict:
    """The verdict on one bar that was measured."""
    if outcome.error is not None:
        return Verdict(Judgement.RETEST, (outcome.error,))
    report = outcome.report
    off = [found for each in report["parameters"] if (found := _off(each, limits, lot))]
    reasons = tuple(text for _, text in sorted(off, reverse=True))
    doubts = tuple(doubts_of(report))
    if report.get("adequacy", {}).get("convention"):
        return Verdict(Judgement.RETEST, doubts)
    if reasons or speaks_against_the_device(report):
        return Verdict(Judgement.REJECT, reasons + doubts)
    doubts += tuple(wrong_readings(report))
    return Verdict(Judgement.RETEST if doubts else Judgement.PASS, doubts)


def _off(each: Mapping[str, Any], limits: Limits, lot: Mapping[str, LotValue]) -> tuple[float, str] | None:
    """How far a fitted value is beyond its limits, as a fraction of the nearest one, and in words."""
    name, value, unit = each["name"], each["value"], each["unit"]
    stated, against = limit_of(name, limits), "the limits"
    if stated is None:
        if name not in lot or name.endswith("damping"):
            return None
        reach = _SPREADS * math.hypot(lot[name].judged_spread, each["standard_error"])
        stated = max(lot[name].median - reach, 0.0), lot[name].median + reach
        against = "what the lot spreads over"
    low, high = stated
    if value < low and each["known"] in (*_TOLD, Known.AT_MOST.value):
        nearest, word = low, "below"
    elif value > high and each["known"] in (*_TOLD, Known.AT_LEAST.value):
        nearest, word = high, "above"
    else:
        return None
    far = abs(value - nearest) / nearest if nearest else math.inf
    text = f"{name} is {quantity_text(value, unit)}, {100 * far:.2g} % {word} {against}, {interval_text(stated, unit)}"
    return far, text


def wrong_readings(report: Mapping[str, Any]) -> list[str]:
    """One sentence for each reading that is off by more than noise explains, in magnitude or in phase."""
    return [
        f"reading {each['row'] + 1} ({each['drive']}, at {point_text(point_of_json(each['position_m']))}) is "
        f"{each['measured_over_predicted']:.3g} times what the other readings say{phase_text(each)}"
        for each in report["wrong_readings"]
        if math.hypot(math.log(each["measured_over_predicted"]), each.get("phase_off_rad") or 0.0)
        > math.log(_WRONG_FACTOR)
    ]
