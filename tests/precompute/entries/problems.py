"""Random problems of the search, and what any drive of any family makes of them, by plain NumPy."""

import numpy as np
from numpy.typing import NDArray

from precompute.entries.objective import Problem
from tests.precompute.entries.rivals import partitions

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]


def random_forms(random: np.random.Generator, count: int, frequencies: int, actuators: int) -> Complex:
    """Positive definite forms (form, frequency, actuator, actuator) over decades; between frequencies they stay so.

    V^H V with V linear in the frequency: the search's cubic interpolation is exact.
    """
    parts = random.normal(size=(4, count, 1, actuators + 1, actuators))
    along = np.linspace(-1.5, 1.5, frequencies)[:, None, None]
    rows = (parts[0] + 1j * parts[1] + (parts[2] + 1j * parts[3]) * along) * 10 ** random.uniform(-1, 0.5, actuators)
    forms: Complex = rows.conj().swapaxes(2, 3) @ rows
    return forms


def random_problem(seed: int, actuators: int, sizes: tuple[int, int, int], frequencies: int = 9) -> Problem:
    """As many numerators, denominators and levels as `sizes` says, at frequencies 20 Hz apart; all within all bands."""
    random = np.random.default_rng(seed)
    numerator, denominator, level = (random_forms(random, size, frequencies, actuators) for size in sizes)
    return Problem(
        name="random",
        frequency_hz=60 + 20 * np.arange(float(frequencies)),
        in_band=np.ones((frequencies, actuators), dtype=bool),
        numerator=numerator,
        denominator=denominator,
        level=level,
        is_share=False,
    )


def random_drives(problem: Problem, count: int, random: np.random.Generator) -> tuple[Index, Index, Complex]:
    """Tone, place in the problem's frequencies and amplitude, each (drive, actuator): every family, strongest at 1."""
    frequencies, actuators = problem.in_band.shape
    families = np.array(partitions(actuators))
    tone = families[random.integers(len(families), size=count)]
    order = random.permuted(np.tile(np.arange(frequencies), (count, 1)), axis=1)  # different tones, different places
    place = np.take_along_axis(order, tone, axis=1)
    amplitude = random.normal(size=(count, actuators)) + 1j * random.normal(size=(count, actuators))
    amplitude[~problem.in_band[place, np.arange(actuators)]] = 0
    strongest = abs(amplitude).max(axis=1)
    some = strongest > 0
    return tone[some], place[some], amplitude[some] / strongest[some, None]


def powers(stack: Complex, tone: Index, place: Index, amplitude: Complex) -> Array:
    """Shape (form, drive): a^H H a at each drive's frequencies, different tones not interfering."""
    same = tone[:, :, None] == tone[:, None, :]
    left, right = np.indices(same.shape[1:])
    forms = stack[:, place][:, :, left, left, right]
    product = amplitude.conj()[:, :, None] * amplitude[:, None, :] * same
    total: Array = (forms * product).sum(axis=(2, 3)).real
    return total


def ratios(problem: Problem, drives: tuple[Index, Index, Complex]) -> tuple[Array, Array]:
    """Ratio and weakest level, each (drive,)."""
    numerator, denominator, level = (powers(stack, *drives) for stack in problem.stacks)
    return numerator.min(axis=0) / denominator.max(axis=0), level.min(axis=0, initial=np.inf)
