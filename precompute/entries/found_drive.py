"""A drive that the search found, with its ratio, its level and the weights of its forms."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from precompute.entries.bfgs import fill_powers, interpolate
from precompute.entries.objective import Problem

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_NOTHING = 1e-9
_LEAST = 1e-200


@dataclass(frozen=True)
class Weights:
    """Weights of every numerator, denominator, level and actuator of a problem; all are 0 or more."""

    numerator: Array
    denominator: Array
    level: Array
    actuator: Array


@dataclass(frozen=True)
class FoundDrive:
    """frequency_hz and amplitude (actuator,), the strongest actuator at 1.

    value: the ratio, a share or a ratio of powers. loudness: weakest felt power over threshold, at full scale. weights:
    how much each form counts where the drive was climbed to; so weighted, it is a stationary point of two forms' ratio.
    """

    frequency_hz: Array
    amplitude: Complex
    value: float
    loudness: float
    weights: Weights

    @property
    def family(self) -> str:
        """The family that its tones make it: "single tone", "coherent", "two tones" or "several tones"."""
        tones = len(np.unique(self.frequency_hz[self.amplitude != 0]))
        if tones > 1:
            return "two tones" if tones == 2 else "several tones"
        return "single tone" if np.count_nonzero(self.amplitude) == 1 else "coherent"


def evaluate_drive(problem: Problem, frequency_hz: Array, amplitude: Complex, multipliers: Array) -> FoundDrive:
    """The drive with its figures; `multipliers` as precompute.entries.bfgs.evaluate leaves them."""
    tones, tone = np.unique(frequency_hz, return_inverse=True)
    amplitude = full_scale(amplitude)
    powers = [powers_of(stack, problem.frequency_hz, tones, tone, amplitude) for stack in problem.stacks]
    powers.append(np.asarray(abs(amplitude) ** 2, dtype=np.float64))
    parts = np.split(multipliers, np.cumsum([len(power) for power in powers[:-1]]))
    # A form without power has no weight either: 0/0 is to be 0.
    floors = [np.maximum(power, max(_NOTHING**2 * power.max(initial=0.0), _LEAST)) for power in powers]
    return FoundDrive(
        frequency_hz=frequency_hz,
        amplitude=amplitude,
        value=float(powers[0].min() / powers[1].max()),
        loudness=float(powers[2].min(initial=np.inf)),
        weights=Weights(*(part / power for part, power in zip(parts, floors, strict=True))),
    )


def powers_of(stack: Complex, grid_hz: Array, tones_hz: Array, tone: NDArray[np.int64], amplitude: Complex) -> Array:
    """a^H H a of every form of a stack (form, frequency, actuator, actuator), between its frequencies interpolated."""
    power = np.empty(len(stack))
    fill_powers(stack, grid_hz, tones_hz, tone, np.ascontiguousarray(amplitude), power)
    return power


def forms_at(stack: Complex, grid_hz: Array, tones_hz: Array, tone: NDArray[np.int64]) -> Complex:
    """Forms (form, actuator, actuator) of a drive whose actuators play tones_hz[tone]."""
    forms = np.empty((len(stack), *stack.shape[2:]), dtype=np.complex128)
    interpolate(stack, grid_hz, tones_hz, tone, forms)
    return forms


def full_scale(amplitude: Complex) -> Complex:
    """The drive with its strongest actuator at 1 and the first that is driven at phase 0."""
    scaled = amplitude / abs(amplitude).max()
    scaled[abs(scaled) < _NOTHING] = 0
    first = scaled[np.flatnonzero(scaled)[0]]
    out: Complex = scaled * np.conj(first) / abs(first)
    return out
