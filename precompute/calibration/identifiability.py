"""Identifiability: combinations of parameters that the data leave open, and the drives that would separate them."""

from dataclasses import dataclass

import numpy as np

from precompute.calibration.calibrate import FittedDevice, Known
from precompute.calibration.measuring_plan import Accuracy, best_drive, prior_information, propose_candidates

_OPEN_BELOW = 2.0
"""Singular value below which a combination is open: the data narrow it to no less than half of its bounds."""
_PART = 0.25  # of a unit vector: smaller parts are not named
_WORTH = 0.7  # of the standard deviation: a drive that leaves more is not recommended
_NEARLY_ONE = 0.95  # of a unit vector: what the others have is then below 0.32 together


@dataclass(frozen=True)
class Combination:
    """A direction in parameter space that the data leave open; `singular_value` runs from 0 (wholly open) to 2.

    parts: of a unit vector by the name of the parameter, the greatest first.
    """

    singular_value: float
    parts: dict[str, float]
    text: str


@dataclass(frozen=True)
class Advice:
    """A parameter that is not well known, and the drive whose readings along the bar would narrow it most; SI values.

    drive_hz (actuator,): NaN for still; None where no drive of the sweep would help.
    """

    parameter: str
    standard_error: float
    drive_hz: tuple[float, ...] | None
    standard_error_after: float


def open_combinations(calibration: FittedDevice) -> tuple[Combination, ...]:
    """Open combinations, by singular values of the sensitivity scaled by the noise and the width of the bounds."""
    prior = np.array([parameter.prior for parameter in calibration.parameters])
    square, vector = np.linalg.eigh(calibration.information * np.outer(prior, prior))
    found: list[Combination] = []
    for value, direction in zip(np.sqrt(np.maximum(square, 0.0)).tolist(), vector.T, strict=True):
        if value >= _OPEN_BELOW:
            break
        signed = direction * np.sign(direction[np.argmax(np.abs(direction))])
        named = [
            (p.name, float(part)) for p, part in zip(calibration.parameters, signed, strict=True) if abs(part) > _PART
        ]
        parts = dict(sorted(named, key=lambda item: -abs(item[1])))
        found.append(Combination(value, parts, _words(parts)))
    return tuple(found)


def _words(parts: dict[str, float]) -> str:
    (first, size), *others = parts.items()
    if not others or size > _NEARLY_ONE:
        return f"{first} alone: it hardly changes what was measured"
    moves = " and ".join(f"{name} {'up' if part > 0 else 'down'}" for name, part in others)
    return f"{first} up with {moves}: together they hardly change what was measured"


def advise(calibration: FittedDevice, sensor_mass_kg: float, accuracy: Accuracy) -> tuple[Advice, ...]:
    """Advice for every parameter that is not known within a factor of 2 or better; `accuracy`: of further readings."""
    if all(estimate.known is Known.WELL for estimate in calibration.estimates):
        return ()
    parameters = calibration.parameters
    candidates = propose_candidates(calibration.device, parameters, calibration.coordinate, sensor_mass_kg, accuracy)
    information = calibration.information + prior_information(parameters)
    found: list[Advice] = []
    for i, estimate in enumerate(calibration.estimates):
        if estimate.known is Known.WELL:
            continue
        drive_hz, deviation = best_drive(candidates, information, i)
        rate = estimate.parameter.rate_at(float(calibration.coordinate[i]))
        helps = deviation * rate <= _WORTH * estimate.standard_error
        name, error = estimate.parameter.name, estimate.standard_error
        found.append(Advice(name, error, drive_hz if helps else None, standard_error_after=deviation * rate))
    return tuple(found)
