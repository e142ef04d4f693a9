"""What a fit misses: the one parameter, or the one length of the description, that explains most of its misfit.

Each parameter that was not fitted is a candidate, and so are the lengths that no fit changes: the surface's own, and
the places of its actuators, which a ruler tells to a millimetre or so, on a plate along either side; on a bar also the
width over which all bolts clamp it, which no ruler tells.

Where the misfit may be noise, a score test picks the candidates worth a fit: the derivative of the readings by a
candidate, less what the fitted parameters can do, correlated with the residuals. In noise that is chi-squared with one
degree of freedom, and it needs no fit. A linear model says nothing of a bar whose modes lie elsewhere, so where the
misfit is larger than noise usually is, every candidate of a bar is fitted, and of a plate the three that promise most.
In noise twice the fall of the cost is chi-squared as well (likelihood ratio); where it is far beyond that, and either
the cost or the typical misfit says that misfits fall by a tenth or more, the candidate was wrong. The typical misfit
alone is blind to it where a third of the readings are far off. The one that helps most is the remedy.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from base.arrays import Array
from base.points import parts_of
from engine.device import Device
from precompute.calibration.calibrate import Calibration, pose_fit, sensor_mass_of
from precompute.calibration.fit import CAUCHY, Fit, Problem, fit, minimise, settle
from precompute.measurements.parameters import Bounds, find_parameters, known_names
from precompute.measurements.types import CalibrationError, Measurements

_WORTH = 0.9
"""Share of the misfit that a remedy leaves at most."""
_GAIN = 12.0
"""Twice the fall of the cost beyond which it is not chance: probability 5e-4 in chi-squared, for a few candidates."""
_PROMISING = 6.0
"""Score from which a candidate is fitted: half the gain, since the score is the gain of a linear model."""
_NOISY = 0.03
"""Relative noise beyond which the score is not asked: accelerometers and their places are better."""
_REACH = 0.05
"""Of the bar: how far off a length is looked for. Millimetres are misread, or the other end is counted from."""
_WIDEST_CLAMP = 0.15  # of the bar: bolts that clamp more of it would be seen
_LOOKED_AT = {"bar": 17, "plate": 7}  # 0.6 % of the bar apart, since costs have several minima; 9 pass the tests too
_MOST_FITTED = {"bar": None, "plate": 3}
"""Candidates that are fitted, the most promising ones: a fit of a plate takes a hundred times as long as of a bar."""
_SOUGHT_EVERYWHERE = ("bar",)
"""Surfaces on which candidates are fitted from everywhere, and where the misfit is large whatever their score."""
_STEP, _EXACT, _ROUGH = 1e-4, 1e-4, 1e-5  # of the bar, of the bar, of the cost


@dataclass(frozen=True)
class Remedy:
    """A parameter or length that was not fitted, and the typical misfit of the fit with it.

    length_m: the best value of a length, or of a place, which is complex on a plate; None for a parameter.
    """

    name: str
    misfit: float
    length_m: complex | None = None


@dataclass(frozen=True)
class _Length:
    """A length of the description within its reach, what the file would say of another one, and the device with it."""

    name: str
    length_m: float
    low_m: float
    high_m: float
    written: Callable[[float], complex]
    device_at: Callable[[complex], Device]


def find_remedy(device: Device, calibration: Calibration, bounds: Mapping[str, Bounds]) -> Remedy | None:
    """The candidate whose addition lowers the cost most; None where none lowers it beyond chance and by enough.

    `device` is that before the fit. Each fit starts from its values, and from what was fitted without the candidate.
    """
    before = float(np.median(np.abs(calibration.log_residual)))
    measurements, names = calibration.measurements, tuple(p.name for p in calibration.parameters)
    fitted = find_parameters(device, names, bounds, sensor_mass_of(measurements))
    without = pose_fit(device, measurements, fitted)

    def pose_at(length: _Length, length_m: float) -> Problem:
        return pose_fit(length.device_at(length.written(length_m)), measurements, fitted)

    candidates = [
        *_parameters_worth_a_fit(device, calibration, bounds, without),
        *_lengths_worth_a_fit(_lengths_of(device, measurements), calibration, without, pose_at),
    ]
    candidates.sort(key=lambda each: -each[0])
    gains = dict[float, Remedy]()
    for _, name, fitted_with in candidates[: _MOST_FITTED[device.surface.kind]]:
        length_m, better = fitted_with()
        _, cost = minimise(without, better.noise, calibration.coordinate)
        misfit = float(np.median(np.abs(better.misfit.log_residual[: len(measurements)])))
        if misfit <= _WORTH * before or better.cost <= _WORTH**2 * cost:
            gains[2 * (cost - better.cost)] = Remedy(name, misfit, length_m)
    return gains[max(gains)] if gains and max(gains) >= _GAIN else None


_Candidate = tuple[float, str, Callable[[], tuple[complex | None, Fit]]]
"""Score, name, and what makes the fit, with the best value of a length."""


def _parameters_worth_a_fit(
    device: Device, calibration: Calibration, bounds: Mapping[str, Bounds], without: Problem
) -> Iterator[_Candidate]:
    """Each further parameter that promises something."""
    measurements, names = calibration.measurements, tuple(p.name for p in calibration.parameters)
    for name in known_names(device):
        try:
            chosen = find_parameters(device, (*names, name), bounds, sensor_mass_of(measurements))
            problem = pose_fit(device, measurements, chosen)
        except CalibrationError:  # it is fitted already or under another name, is 0, or changes none of these readings
            continue
        started = np.append(calibration.coordinate, problem.start[-1])

        def fitted_with(problem: Problem = problem, started: Array = started) -> tuple[None, Fit]:
            found = [settle(problem, started)]
            found += [fit(problem, 1, 0)] if device.surface.kind in _SOUGHT_EVERYWHERE else []
            return None, min(reversed(found), key=lambda each: each.noise)

        score = _score(without, calibration, problem.misfit.at(started).log_slope[:, -1])
        if score >= _PROMISING or (calibration.noise > _NOISY and device.surface.kind in _SOUGHT_EVERYWHERE):
            yield score, name, fitted_with


def _lengths_worth_a_fit(
    lengths: list[_Length], calibration: Calibration, without: Problem, pose_at: Callable[[_Length, float], Problem]
) -> Iterator[_Candidate]:
    """Each length that promises something."""
    kind, residual = calibration.device.surface.kind, without.misfit.at(calibration.coordinate).log_residual
    for length in lengths:
        step_m = _STEP * (length.high_m - length.low_m)
        moved = pose_at(length, length.length_m + step_m).misfit.at(calibration.coordinate).log_residual

        def cost_at(length_m: float, length: _Length = length) -> float:
            problem = pose_at(length, float(length_m))
            return minimise(problem, calibration.noise, calibration.coordinate, _ROUGH)[1]

        def fitted_with(length: _Length = length, cost_at: Callable[[float], float] = cost_at) -> tuple[complex, Fit]:
            places_m = np.linspace(length.low_m, length.high_m, _LOOKED_AT[kind])
            best = int(np.argmin([cost_at(place_m) for place_m in places_m.tolist()]))
            ends_m = places_m[max(best - 1, 0)], places_m[min(best + 1, len(places_m) - 1)]
            exact_m = _EXACT * (length.high_m - length.low_m)
            found_m = float(minimize_scalar(cost_at, bounds=ends_m, method="bounded", options={"xatol": exact_m}).x)
            return length.written(found_m), settle(pose_at(length, found_m), calibration.coordinate)

        score = _score(without, calibration, (moved - residual) / step_m)
        if score >= _PROMISING or (calibration.noise > _NOISY and kind in _SOUGHT_EVERYWHERE):
            yield score, length.name, fitted_with


def _score(without: Problem, calibration: Calibration, column: Array) -> float:
    """Twice the fall of the cost that a candidate promises; column (datum,): the derivative of the residuals by it."""
    misfit = without.misfit.at(calibration.coordinate)
    residual = misfit.log_residual / calibration.noise
    weight = 1 / np.sqrt(1 + (residual / CAUCHY) ** 2)
    slope, own = misfit.log_slope * weight[:, None], column * weight
    own = own - slope @ np.linalg.lstsq(slope, own, rcond=None)[0]
    size = float(own @ own)
    return float(own @ (residual * weight)) ** 2 / size if size > 0 else 0.0


def _lengths_of(device: Device, measurements: Measurements) -> list[_Length]:
    """The sides of the surface, which hold everything on it, and the places of the actuators, along each side."""
    places_m = [actuator.position_m for actuator in device.actuators]
    told_m = [measurements.position_m, np.nan_to_num(measurements.finger_m)]
    told_m += [] if measurements.force_m is None else [measurements.force_m]
    every_m, found = np.concatenate([places_m, *told_m]), list[_Length]()
    ways = zip(("length", "width"), (1.0, 1j), parts_of(device.surface.corner_m), strict=False)
    for axis, (name, way, side_m) in enumerate(ways):
        reach_m, last_m = _REACH * side_m, float((every_m / way).real.max())

        def resized(other_m: complex, key: str = f"{name}_m") -> Device:
            side: dict[str, Any] = {key: other_m.real}
            return replace(device, surface=replace(device.surface, **side))

        ends_m = max(side_m - reach_m, last_m), side_m + reach_m
        found.append(_Length(f"{device.surface.kind}.{name}", side_m, *ends_m, lambda other_m: other_m, resized))
        for index, place_m in enumerate(places_m):

            def written(other_m: float, place_m: complex = place_m, way: complex = way, axis: int = axis) -> complex:
                return place_m + way * (other_m - parts_of(place_m)[axis])

            def moved(at_m: complex, index: int = index) -> Device:
                actuators = list(device.actuators)
                actuators[index] = replace(actuators[index], position_m=at_m)
                return replace(device, actuators=tuple(actuators))

            own_m = parts_of(place_m)[axis]
            ends_m = max(own_m - reach_m, 0.0), min(own_m + reach_m, side_m)
            found.append(_Length(f"actuator[{index + 1}].position", own_m, *ends_m, written, moved))
    if device.surface.kind == "bar":
        found.append(_clamps_of(device))
    return found


def _clamps_of(device: Device) -> _Length:
    """The clamps of all actuators, of one width: bolts that no file mentions are of one make."""

    def clamped(width_m: complex) -> Device:
        return replace(device, actuators=tuple(replace(each, clamp_m=width_m.real) for each in device.actuators))

    places_m = sorted(actuator.position_m.real for actuator in device.actuators)
    widest_m = min([_WIDEST_CLAMP * device.surface.length_m, *np.diff(places_m) / 2])
    return _Length("actuator.clamp", device.actuators[0].clamp_m, 0.0, widest_m, lambda width_m: width_m, clamped)
