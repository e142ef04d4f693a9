"""The one judge of a fit: reasons not to use it without a look, for one device and for a fleet."""

from collections.abc import Mapping
from typing import Any

from engine.device.quantity import quantity_text
from precompute.calibration.conventions import implausible_changes

LARGEST_MISFIT = 0.05
"""Typical misfit beyond which a fit is doubtful, unless another is given: it is that of noise of 7 %."""
_AT_BOUND = 1e-3  # relative


def doubts_of(
    report: Mapping[str, Any], accepted_misfit: float = LARGEST_MISFIT, *, is_strict: bool = False
) -> list[str]:
    """Reasons not to use a calibration, from its report; strict: a parameter not known within a factor of 2 is one.

    That the readings follow another convention explains all else, and is then the only doubt.
    """
    adequacy, parameters = report.get("adequacy", {}), report["parameters"]
    if adequacy.get("convention"):
        return [adequacy["doubt"]]
    doubts, misfit = [], report["median_misfit"]
    if doubt := adequacy.get("doubt"):
        doubts.append(doubt)
    doubts += implausible_changes(parameters)
    doubts += [_at_bound_text(each) for each in parameters if _is_at_bound(each)]
    if misfit > accepted_misfit:
        doubts.append(f"the typical misfit, {100 * misfit:.3g} %, is above {100 * accepted_misfit:g} %")
    dampings = [each["value"] for each in parameters if each["name"].endswith("damping")]
    if dampings and not any(dampings):
        doubts.append("every damping is fitted as 0: phases of the wrong sign do that, as of exp(-j w t)")
    if is_strict:
        unsure = [each["name"] for each in parameters if each["known"] != "known"]
        doubts += [f"{name} is not known within a factor of 2" for name in unsure]
    return doubts


def speaks_against_the_device(report: Mapping[str, Any]) -> bool:
    """Whether a doubt is about the device, a value or a length of it, and not about the readings alone."""
    adequacy, parameters = report.get("adequacy", {}), report["parameters"]
    is_off = bool(implausible_changes(parameters)) or any(map(_is_at_bound, parameters))
    return not adequacy.get("convention") and (is_off or bool(adequacy.get("remedy")))


def _is_at_bound(parameter: Mapping[str, Any]) -> bool:
    """Whether a value lies at an end of its bounds; a damping may be 0."""
    value, (low, high) = parameter["value"], parameter["bounds"]
    return bool(value >= (1 - _AT_BOUND) * high or 0 < value <= (1 + _AT_BOUND) * low)


def _at_bound_text(parameter: Mapping[str, Any]) -> str:
    value = quantity_text(parameter["value"], parameter["unit"])
    return (
        f"{parameter['name']} is fitted as {value}, an end of its bounds: something else is not as in the device file, "
        "such as the length, the thickness or the place of an actuator"
    )
