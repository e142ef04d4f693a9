"""Readings of another convention than the file says: of another sign, phase, delay, derivative or unit.

Each is an error by a constant or by a function of frequency alone, so that one drive undoes it: the model is linear,
and velocities of a bar are the accelerations that 1/(j w) of the drive gives. A conjugate, as of exp(-j w t), is
undone in the readings. A wrong bar turns phases and moves resonances, which none of these does, so each is tried on a
fit that is doubtful, and the one that leaves the least noise is named if it leaves far less.

A constant is another full scale, which fits as closely as the right one. What tells it is the device file: its values
come from data sheets, scales and rulers, and are seldom wrong by more than a factor of two or three. Dampings are
guesses before the first calibration, so ten is credible there, and ten times its knee where the file says less: below
the knee it changes no reading, and is as good as 0. A value that the measurements hardly tell is no doubt:
all of its 95 % interval must lie that far off, or nearer to the constant than to the value of the file.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from base.arrays import Array, Complex
from engine.device import Device
from engine.device.quantity import quantity_text
from precompute.calibration.calibrate import Calibration, pose_fit, sensor_mass_of
from precompute.calibration.fit import Fit, Misfit, Problem, minimise, settle
from precompute.measurements.model import MeasurementModel
from precompute.measurements.parameters import Bounds, Parameter, find_parameters
from precompute.measurements.types import Kind, Measurements

_FACTORS = {"full_scale": 1.9, "damping": 10.0, "clamp": math.inf}
"""Greatest credible factor between the fitted value and that of the device file, by the end of the parameter's name.

What a bolt clamps is in no data sheet, and a file that does not say it counts as the least of the bounds.
"""
_FACTOR = 3.0  # as above: values of sheets, scales and rulers are seldom wrong by more
_CONSTANTS = (
    (math.sqrt(0.5), 0.04, "RMS values for peak values: multiply them by 1.414"),
    (math.sqrt(2), 0.04, "peak values that were multiplied by 1.414 as if they were RMS: divide them by 1.414"),
    (0.5, 0.08, "a two-sided spectrum, or a half for the whole: multiply them by 2"),
    (2.0, 0.08, "peak-to-peak values for peak values: divide them by 2"),
    (9.80665, 0.25, "m/s^2 that the file declares as g: declare m/s^2"),
    (1 / 9.80665, 0.25, "g that the file declares as m/s^2: declare g"),
    (1000.0, 0.25, "thousandths, as mm for m, that the file declares as whole units: divide them by 1000"),
    (1 / 1000, 0.25, "whole units, as m for mm, that the file declares as thousandths: multiply them by 1000"),
    (1000 / 9.80665, 0.25, "thousandths of g that the file declares as m/s^2: declare g and divide by 1000"),
    (1 / 0.0254, 0.25, "inches for metres: multiply them by 0.0254"),
    (1e6, 0.25, "micrometres for metres: divide them by 1e6"),
)
"""Factor by which readings are too large, how near a fitted one is taken for it, and what they are, with the remedy."""
_ORDERS = ("", "velocities", "displacements")
_WORTH = 0.7
"""Share of the misfit that a convention leaves at most."""
_SMALLEST_NOISE = 0.005  # of a fit; less is as good: no accelerometer is better
_PRICE = 12.0  # in units of ln(noise) summed over data, for each change of convention
_LONGEST_S, _DELAYS = 0.05, 1001  # sound cards buffer 10 to 50 ms; 0.1 ms apart is 10 degrees at 300 Hz
_FITTED = 3  # of those that were screened, by their cost
_SCREEN_NOISE, _SCREEN_TOLERANCE = 0.3, 1e-3  # of a reading, of the cost: a wrong convention costs four times the right
_COARSE_NOISE, _TOLERANCE = 0.1, 1e-6  # as above: what a wrong delay spoils does not count as wrong readings yet
_REACH_S, _EXACT_S = 1e-3, 1e-6  # of a delay: a bar that is not fitted yet tells it to this; 0.1 degrees at 300 Hz
_ROUNDS = 3  # of the factor and the fit in turn, where no full scale is fitted


@dataclass(frozen=True)
class Convention:
    """How the readings differ from what the file says, with the remedy in words.

    misfit_before, misfit: geometric means of the residuals' sizes of magnitude and phase, without and with the remedy.
    """

    text: str
    misfit_before: float
    misfit: float
    delay_s: float = 0.0


@dataclass(frozen=True)
class _Change:
    """A change of convention: sign (actuator,) of the readings of each; order: of integration; factor: of readings."""

    sign: tuple[int, ...]
    is_conjugate: bool = False
    order: int = 0
    delay_s: float = 0.0
    factor: float = 1.0

    @property
    def number(self) -> int:
        """How many things it changes."""
        return (min(self.sign) < 0) + self.is_conjugate + (self.order > 0) + (self.delay_s != 0)

    def undo(self, read: Measurements) -> Measurements:
        """The readings as the stated convention has them, of the changed drive that would cause them."""
        jw = 2j * np.pi * np.nan_to_num(read.frequency_hz, nan=1.0)
        amplitude = read.amplitude.conj() if self.is_conjugate else read.amplitude
        drive = self.factor * amplitude * np.array(self.sign) / jw**self.order * np.exp(-jw * self.delay_s)
        return replace(
            read, amplitude=drive, acceleration=read.acceleration.conj() if self.is_conjugate else read.acceleration
        )


def find_convention(device: Device, calibration: Calibration, bounds: Mapping[str, Bounds]) -> Convention | None:
    """The convention that leaves far less noise than the fit; None where none does.

    `device` is that before the fit. Each is fitted from its values.
    """
    read, names = calibration.measurements, tuple(p.name for p in calibration.parameters)
    chosen = find_parameters(device, names, bounds, sensor_mass_of(read))
    count = len(read) * (1 if read.kind is Kind.PEAK else 2)

    was = _spread(pose_fit(device, read, chosen).misfit.at(calibration.coordinate))

    def price(change: _Change, found: Fit) -> float:
        return count * math.log(_spread(found.misfit)) + _PRICE * change.number

    screened = list[tuple[float, _Change, Array]]()
    for change in _changes(device, read):
        problem = pose_fit(device, change.undo(read), chosen)
        place, cost = minimise(problem, _SCREEN_NOISE, problem.start, _SCREEN_TOLERANCE)
        screened.append((cost + change.number, change, place))
    best = sorted(screened, key=lambda each: each[0])[:_FITTED]
    tried = [_fitted(device, read, chosen, change, place) for _, change, place in best]
    if read.kind is Kind.RESPONSE:
        tried += [_fitted(device, read, chosen, change, place, _REACH_S) for _, change, place in best]
    change, found = min(tried, key=lambda each: price(*each))
    left = _spread(found.misfit)
    if left > _WORTH * was or price(change, found) > count * math.log(was) - _PRICE:
        return None
    scales = [p.value_at(x) / p.start for p, x in zip(chosen, found.coordinate, strict=True) if p.key == "full_scale"]
    factor = change.factor * float(np.exp(np.mean(np.log(scales)))) if scales else change.factor
    text = "; ".join(_words(device, change, factor))
    return Convention(text, was, left, change.delay_s) if text else None


def _spread(misfit: Misfit) -> float:
    """Geometric mean of the residuals' sizes: few wrong readings matter little, the half of a turned plug much."""
    return float(np.exp(np.log(np.maximum(np.abs(misfit.log_residual), _SMALLEST_NOISE)).mean()))


def _changes(device: Device, read: Measurements) -> Iterator[_Change]:
    """What is tried: with the signs and the factor that bring the device file's prediction nearest to the readings."""
    straight = _Change((1,) * len(device.actuators))
    is_peak = read.kind is Kind.PEAK
    for is_conjugate in (False,) if is_peak else (False, True):
        for order in range(len(_ORDERS)):
            change = replace(straight, is_conjugate=is_conjugate, order=order)
            ratio = _ratio(device, change.undo(read))
            change = replace(change, factor=float(np.exp(np.median(np.log(np.abs(ratio))))))
            yield change
            if is_peak:
                continue
            for delay_s in (0.0, _likely_delay(read, ratio)):
                sign = _signs(read, ratio, delay_s)
                if delay_s or min(sign) < 0:
                    yield replace(change, sign=sign, delay_s=delay_s)


def _ratio(device: Device, read: Measurements) -> Complex:
    """Measured over predicted (row,) for the device as it is."""
    predicted = MeasurementModel(device, read, ()).predict(np.zeros(0)).log_acceleration
    out: Complex = read.acceleration * np.exp(-predicted)
    return out


def _agreement(read: Measurements, ratio: Complex, delay_s: Array) -> Array:
    """Sum (delay, actuator) of the cosines between predicted and measured phases, over the rows of each actuator."""
    omega = 2 * np.pi * np.nanmax(np.where(read.amplitude != 0, read.frequency_hz, np.nan), axis=1)
    turned = np.cos(np.angle(ratio) + delay_s[:, None] * omega)
    out: Array = turned @ (read.amplitude != 0)
    return out


def _likely_delay(read: Measurements, ratio: Complex) -> float:
    """The delay that brings phases nearest to the prediction, but for signs of actuators; the least of equals."""
    delay_s = np.linspace(-_LONGEST_S, _LONGEST_S, _DELAYS)
    agreement = np.abs(_agreement(read, ratio, delay_s)).sum(axis=1)
    return float(delay_s[np.argmax(agreement - 1e-3 * len(read) * np.abs(delay_s) / _LONGEST_S)])


def _signs(read: Measurements, ratio: Complex, delay_s: float) -> tuple[int, ...]:
    return tuple(-1 if total < 0 else 1 for total in _agreement(read, ratio, np.array([delay_s]))[0])


def _fitted(
    device: Device,
    read: Measurements,
    chosen: tuple[Parameter, ...],
    change: _Change,
    place: Array,
    reach_s: float = 0.0,
) -> tuple[_Change, Fit]:
    """The fit to readings that were changed back, with the factor, and the delay within reach, that fit best."""

    def problem_at(delay_s: float) -> Problem:
        return pose_fit(device, replace(change, delay_s=delay_s).undo(read), chosen)

    def cost_at(delay_s: float) -> float:
        return minimise(problem_at(float(delay_s)), _COARSE_NOISE, place, _TOLERANCE)[1]

    if reach_s:
        ends_s = change.delay_s - reach_s, change.delay_s + reach_s
        found_s = minimize_scalar(cost_at, bounds=ends_s, method="bounded", options={"xatol": _EXACT_S}).x
        change = replace(change, delay_s=float(found_s))
    for _ in range(1 if any(p.key == "full_scale" for p in chosen) else _ROUNDS):
        problem = problem_at(change.delay_s)
        place, _cost = minimise(problem, _COARSE_NOISE, place, _TOLERANCE)
        over = float(np.median(problem.misfit.at(place).log_residual[: len(read)]))
        change = replace(change, factor=change.factor * math.exp(-over))
    return change, settle(problem_at(change.delay_s), place)


def _words(device: Device, change: _Change, factor: float) -> Iterator[str]:
    """What the change says of the readings, with the remedy."""
    if max(change.sign) < 0:
        yield "all responses have the wrong sign: the sensor lies upside down, or its plug is turned; turn it"
    elif min(change.sign) < 0:
        names = " and ".join(a.name for a, sign in zip(device.actuators, change.sign, strict=True) if sign < 0)
        yield f"the responses to {names} have the wrong sign: turn the plug of {names}, or of its loopback"
    if change.is_conjugate:
        yield "phases have the wrong sign, as of exp(-j w t): change the sign of all phases or imaginary parts"
    if change.order:
        yield (
            f"they are {_ORDERS[change.order]}, not accelerations: switch integration off, or multiply them by "
            f"{['', 'j w', '-w^2'][change.order]}, w = 2 pi f"
        )
    if change.delay_s:
        late = "late" if change.delay_s > 0 else "early"
        yield (
            f"they are {1e3 * abs(change.delay_s):.3g} ms too {late}: record the drive beside them, or add "
            f"{360 * change.delay_s:.3g} degrees for each Hz to the phases"
        )
    if constant := _constant_text(factor):
        yield f"they are {constant}"


def _constant_text(factor: float) -> str:
    """Usual mistake that makes readings too large by this factor; empty without one near it."""
    away = [(abs(math.log(factor / usual)), reach, text) for usual, reach, text in _CONSTANTS]
    return min([(off, text) for off, reach, text in away if off <= reach], default=(0.0, ""))[1]


def implausible_changes(parameters: Sequence[Mapping[str, Any]]) -> list[str]:
    """One sentence for each fitted value that is implausibly far from the one before.

    `parameters` as in a calibration's report: "name", "before", "value", "interval", "unit", and "knee" of a damping.
    """
    doubts = []
    for parameter in parameters:
        before, value = parameter["before"], parameter["value"]
        limit = next((limit for end, limit in _FACTORS.items() if end in parameter["name"]), _FACTOR)
        low, high = parameter["interval"]
        if min(before, value) <= 0:
            continue
        usual = _constant_text(value / before) if "full_scale" in parameter["name"] else ""
        nearest = math.sqrt(before * value)  # geometric mean: equally far from the value before and from the constant
        most = limit * max(before, parameter.get("knee", 0.0))
        if low <= most and high * limit >= before and not (usual and (low > nearest or high < nearest)):
            continue
        texts = [quantity_text(each, parameter["unit"]) for each in (value, before)]
        why = f"the readings are {usual}" if usual else "check the units of the measurements, then the device file"
        doubts.append(
            f"{parameter['name']} is fitted as {texts[0]}, before it was {texts[1]}, {value / before:.2g} times that: "
            f"{why}"
        )
    return doubts
