"""Test of adequacy of a fit (lack of fit): whether its residuals are noise, or say that the model misses something.

Intervals are honest only if what is left over is noise. A bar whose Young's modulus is 6 % off is fitted with other
values that are wrong, and all of them look known. Three tests tell:

- *Sign changes.* Noise has no memory: along the surface, at one drive, the next residual has the other sign as often as
  not. A missed stiffness leaves residuals of one sign over long stretches, because modes are smooth. The number of sign
  changes is binomial with probability 1/2. Only signs count, so wrong readings and uneven noise do no harm.
- *Repeats.* Readings of one drive at one place scatter by the noise alone. If the fit misses their means by more than
  that scatter allows (F test of lack of fit), the model is wrong whatever the signs.
- *One thing more.* A parameter that was not fitted, the length of the bar or the place of an actuator explains much of
  the misfit, far beyond chance (precompute.calibration.remedy).

A fit is doubted where one of these would happen by chance less than about once in 200 adequate fits. None of them says
anything where the typical misfit is below 0.5 %, which accelerometers and their places are not better than.

`doubts_of` is the one judge of a fit, for one device and for a fleet: from its report, reasons not to use it unseen.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr, fdtrc

from base.arrays import Array
from base.plain import to_plain
from base.points import point_text
from engine.device import Device
from engine.device.quantity import quantity_text
from precompute.calibration.calibrate import Calibration
from precompute.calibration.conventions import Convention, find_convention, implausible_changes
from precompute.calibration.remedy import Remedy, find_remedy
from precompute.measurements.parameters import Bounds
from precompute.measurements.types import Measurements

UNLIKELY = 0.005
"""Probability below which a finding is not taken for chance."""
SMALLEST_MISFIT = 0.005  # docs/calibration.md: 0.04 dB, below what any accelerometer is good for
_NOISY = 0.03  # relative noise from which a convention is looked for: accelerometers and their places are better
_MANY_WRONG = 0.08  # share of wrong readings from which it is, too: an actuator of a few that is turned
_LESS = 0.9  # of the typical misfit: what falls less is told of the greater ones
_LEAST_REPEATS = 5
"""Degrees of freedom of repeated readings below which they say too little."""
LARGEST_MISFIT = 0.05
"""Typical misfit beyond which a fit is doubtful, unless another is given: it is that of noise of 7 %."""
_AT_BOUND = 1e-3  # relative


@dataclass(frozen=True)
class Adequacy:
    """What the residuals say. misfit: median of their sizes. neighbours: pairs along the bar; sign_changes in them.

    chance: probability of so few changes in noise. repeat_noise: relative standard deviation of repeated readings, and
    repeat_chance the probability of such a misfit beside it; None without repeats.
    """

    misfit: float
    neighbours: int
    sign_changes: int
    chance: float
    repeat_noise: float | None
    repeat_chance: float | None

    @property
    def is_noise(self) -> bool:
        """Whether the residuals can be noise, or are too small to matter."""
        chances = [self.chance, *([] if self.repeat_chance is None else [self.repeat_chance])]
        return self.misfit < SMALLEST_MISFIT or min(chances) >= UNLIKELY


def assess(calibration: Calibration) -> Adequacy:
    """Test the residuals of a calibration; readings that were taken for wrong are left out."""
    kept = np.flatnonzero(~calibration.is_wrong)
    residual, place = calibration.log_residual[kept], _places(calibration.measurements, kept)
    groups, group_of_row = np.unique(place, axis=0, return_inverse=True)
    group_of_row = group_of_row.reshape(-1)
    count = np.bincount(group_of_row)
    mean = np.bincount(group_of_row, residual) / count
    neighbours = (groups[1:, :-1] == groups[:-1, :-1]).all(axis=1)  # one drive, one finger, the next position
    changes = int(((mean[1:] >= 0) != (mean[:-1] >= 0))[neighbours].sum())
    number = int(neighbours.sum())
    noise, chance = _repeat_test(residual, mean[group_of_row], len(groups), len(calibration.parameters))
    return Adequacy(
        misfit=float(np.median(np.abs(calibration.log_residual))),
        neighbours=number,
        sign_changes=changes,
        chance=float(bdtr(changes, number, 0.5)) if number else 1.0,
        repeat_noise=noise,
        repeat_chance=chance,
    )


def _places(measurements: Measurements, rows: NDArray[np.intp]) -> Array:
    """Drive, sensor mass, finger and position (row, 6) of readings; the position along the surface sorts last."""
    finger_m, at_m = np.nan_to_num(measurements.finger_m, nan=-1.0), measurements.position_m
    drive = measurements.drive_of_row, measurements.sensor_mass_kg
    return np.stack([*drive, finger_m.real, finger_m.imag, at_m.imag, at_m.real], axis=1)[rows].astype(float)


def _repeat_test(residual: Array, mean: Array, groups: int, parameters: int) -> tuple[float | None, float | None]:
    """Scatter of repeats about their mean (row,), and the probability that the means miss the fit by chance."""
    repeats, freedom = len(residual) - groups, groups - parameters
    if repeats < _LEAST_REPEATS or freedom < 1:
        return None, None
    pure = float(((residual - mean) ** 2).sum()) / repeats
    lack = float((mean**2).sum()) / freedom
    return float(np.sqrt(pure)), float(fdtrc(freedom, repeats, lack / pure)) if pure > 0 else 0.0


def adequacy_report(device: Device, calibration: Calibration, bounds: Mapping[str, Bounds]) -> dict[str, Any]:
    """The tests for JSON; "doubt" is a sentence with the remedy, empty where the fit is adequate.

    Where the readings follow another "convention", all else follows from that, and no other remedy is looked for.
    """
    found = assess(calibration)
    dampings = [each.value for each in calibration.estimates if each.parameter.key.endswith("damping")]
    has_many_wrong = calibration.is_wrong.mean() > _MANY_WRONG
    is_off = calibration.noise > _NOISY or has_many_wrong
    is_doubtful = is_off or not found.is_noise or (dampings and not any(dampings))
    convention = find_convention(device, calibration, bounds) if is_doubtful else None
    # A channel that is late spoils its own phases alone, a quarter of two channels' data: no typical misfit shows it.
    is_fit = found.misfit < SMALLEST_MISFIT and not has_many_wrong
    remedy = None if convention or is_fit else find_remedy(device, calibration, bounds)
    return {
        **to_plain(found),
        "remedy": to_plain(remedy),
        "convention": to_plain(convention),
        "doubt": _convention_text(convention)
        if convention
        else ("" if found.is_noise and remedy is None else _doubt_text(found, remedy)),
    }


def _convention_text(convention: Convention) -> str:
    was, left = (f"{100 * misfit:.2g} %" for misfit in (convention.misfit_before, convention.misfit))
    return (
        f"readings of another convention: {convention.text}; magnitudes and phases, {was} off, would be off by {left}"
    )


def _doubt_text(found: Adequacy, remedy: Remedy | None) -> str:
    parts = []
    if found.chance < UNLIKELY:
        parts.append(
            f"the residuals change sign {found.sign_changes} times between {found.neighbours} neighbours, "
            f"where noise does {found.neighbours / 2:.0f} times"
        )
    if found.repeat_noise is not None and found.repeat_chance is not None and found.repeat_chance < UNLIKELY:
        parts.append(f"repeated readings scatter by only {100 * found.repeat_noise:.2g} %")
    found_text = ", and ".join(parts) or "one thing more explains much of the misfit"
    why = f"{found_text}: something that was not fitted is wrong, and the intervals are too narrow"
    if remedy is None:
        return (
            f"{why}. No single further parameter or length explains it; check positions, drives and the sensor's mass"
        )
    fall = "the greater misfits would fall"
    if remedy.misfit < _LESS * found.misfit:
        fall = f"the typical misfit, {100 * found.misfit:.2g} %, would fall to {100 * remedy.misfit:.2g} %"
    if remedy.length_m is not None:
        text = point_text(remedy.length_m, 4)
        return f"{why}. Measure {remedy.name} again: with {text} in the device file {fall}"
    note = " (with the modulus it stands for the thickness)" if remedy.name.endswith(".density") else ""
    return f"{why}. Try --also {remedy.name}{note}: {fall}"


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
