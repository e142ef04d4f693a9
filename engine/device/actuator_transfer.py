"""`Transfer`: transfer function of a driver with its actuator, from a command to the displacement that follows it.

Theory of operation
-------------------
A device file gives points: frequency, magnitude and phase; 1 and 0 degrees where the base moves as commanded. Steady
drives need the function between the points, clicks at complex frequencies beside the imaginary axis (courses that ring
on are transformed with damping), and the simulated bar needs it in time. One form serves all three, a sum over poles,

    H(s) = d + sum over p of r_p / (s - p),    poles real or in conjugate pairs, with negative real parts,

which is causal and stable, and is simulated exactly. It is found by vector fitting [Gustavsen and Semlyen 1999]: with
trial poles q, H and a second sum d' + sum r'_q / (s - q) that multiplies it are fitted together by least squares; the
zeros of the second sum are better trial poles. Misses count relative to the magnitude of their point. The number of
poles is the least that reaches the points; noisy points are never reached, and an information criterion chooses.

Points that no causal actuator has, such as those whose phases have the wrong sign, leave a large miss, or are reached
only by a function that grows beyond all bounds beside them. Both are refused when the device file is read.

The engine only reads and checks it: a table's modes and clicks hold it already, and limits are the command's.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from base.arrays import Array, Complex

FEWEST_POINTS = 3  # two lie on a line whatever the actuator does
GREATEST_MISS = 0.05  # miss of a point, relative to its magnitude, that is refused: 0.4 dB or 3 degrees
GREATEST_GROWTH = 10.0  # greatest magnitude of the function at any frequency, in those of the greatest point
_CLOSE = 1e-3  # root mean square miss at which no more poles are taken: 0.01 dB, better than anything that is measured
_MOST_POLES = 16
_ROUNDS = 12  # 6, 12 and 24 fit the systems of tests/engine/device/test_actuator_transfer.py alike, to five digits
_LEAST_CONSTANT = 1e-6  # of the second sum, whose mean is 1; below it its zeros would lie at infinity
_RESOLVED = 1 / 6  # least decay rate of a pole within the points, in their distances: narrower peaks are noise
_LOOK_HZ = np.geomspace(0.1, 1e5, 400)


@dataclass(frozen=True)
class Transfer:
    """Points of a transfer function, of rising frequency in Hz; magnitudes, and phases in degrees (lag below 0)."""

    frequency_hz: tuple[float, ...]
    magnitude: tuple[float, ...]
    phase_deg: tuple[float, ...]

    @property
    def value(self) -> Complex:
        """Shape (point,)."""
        return np.array(self.magnitude) * np.exp(1j * np.radians(self.phase_deg))

    @property
    def series(self) -> "PoleSeries":
        """The causal function through the points; computed once."""
        return _fitted(self)

    def at(self, frequency_hz: Array) -> Complex:
        """Response (frequency,) to steady tones."""
        return self.series.at(2j * np.pi * np.asarray(frequency_hz, dtype=np.float64))

    def misses(self) -> Array:
        """Distance (point,) of the function from each point, relative to the point's magnitude."""
        return np.asarray(abs(self.at(np.array(self.frequency_hz)) / self.value - 1))

    def growth(self) -> float:
        """Greatest magnitude of the function at any frequency, in magnitudes of the greatest point."""
        return float(abs(self.at(_LOOK_HZ)).max() / max(self.magnitude))


@dataclass(frozen=True)
class PoleSeries:
    """d + sum of r / (s - p): poles with an imaginary part of 0 or more, 1/s; each stands for its conjugate too."""

    direct: float
    pole_per_s: tuple[complex, ...]
    residue_per_s: tuple[complex, ...]

    def at(self, s_per_s: NDArray[np.complexfloating[Any, Any]]) -> Complex:
        """H at complex frequencies (...,), in 1/s."""
        value = np.full(np.shape(s_per_s), self.direct, dtype=np.complex128)
        for pole, residue in zip(self.pole_per_s, self.residue_per_s, strict=True):
            value += residue / (s_per_s - pole)
            if pole.imag > 0:
                value += residue.conjugate() / (s_per_s - pole.conjugate())
        return value


@cache
def _fitted(transfer: Transfer) -> PoleSeries:
    """The function with the fewest poles that reaches the points.

    Where none does, because the points are noisy, the number of poles is that of the least Bayesian information
    criterion, n ln(mean square) + p ln(n) with n = 2 real numbers a point and p free numbers [Schwarz 1978].
    """
    s, value = 2j * np.pi * np.array(transfer.frequency_hz), transfer.value
    numbers, best, least = 2 * len(s), PoleSeries(1.0, (), ()), np.inf
    for poles in range(min(_MOST_POLES, (numbers - 1) // 3) + 1):
        series = _vector_fit(s, value, poles)
        square = float(np.mean(abs(series.at(s) / value - 1) ** 2))
        criterion = numbers * np.log(max(square, 1e-30)) + (2 * poles + 1) * np.log(numbers)
        if criterion < least and (poles == 0 or _is_resolved(series, s.imag)):
            best, least = series, criterion
            if square <= _CLOSE**2:
                break
    return best


def _is_resolved(series: PoleSeries, omega: Array) -> bool:
    """Whether no pole within the points is a peak so narrow that it could lie between two of them."""
    pole = np.array(series.pole_per_s)
    inside = (pole.imag >= omega[0]) & (pole.imag <= omega[-1])
    return bool((-pole.real[inside] >= _RESOLVED * np.diff(omega).max()).all())


def _vector_fit(s: Complex, value: Complex, count: int) -> PoleSeries:
    """Vector fitting with `count` poles, a conjugate pair being two."""
    top = abs(s[-1])
    # Trial poles: conjugate pairs spread over the band, well damped, and a real one where the number is odd.
    turns = top * (np.arange(count // 2) + 0.5) / max(count // 2, 1)
    pole = np.concatenate([turns * (-0.3 + 1j), np.full(count % 2, -top + 0j)])
    ones = np.ones((len(s), 1))
    for _ in range(_ROUNDS if count else 0):
        terms = _terms(s, pole)
        # H's own terms and constant, then the second sum and its constant times the points; rows divided by the points.
        columns = np.concatenate([terms / value[:, None], ones / value[:, None], -terms, -ones], axis=1)
        # Relaxed: the mean of the second sum is 1 rather than its constant, which noise would bias [Gustavsen 2006].
        mean = np.concatenate([np.zeros(count + 1), terms.real.mean(axis=0), [1.0]])
        rows = np.concatenate([columns, len(s) * mean[None]])
        found = _solve(rows, np.append(np.zeros(len(s)), len(s)).astype(np.complex128))
        second, constant = found[count + 1 : -1], found[-1]
        pole = _zeros(pole, second / (constant if abs(constant) > _LEAST_CONSTANT else _LEAST_CONSTANT))
    columns = np.concatenate([_terms(s, pole), ones], axis=1) / value[:, None]
    found = _solve(columns, np.ones(len(s), dtype=np.complex128))
    return PoleSeries(float(found[-1]), tuple(pole.tolist()), tuple(_residues(pole, found[:-1]).tolist()))


def _terms(s: Complex, pole: Complex) -> Complex:
    """Columns (point, term) of real unknowns: one for a real pole, two for a conjugate pair."""
    columns = []
    for each in pole:
        one, other = 1 / (s - each), 1 / (s - each.conjugate())
        columns += [one + other, 1j * one - 1j * other] if each.imag > 0 else [one]
    return np.stack(columns, axis=1) if columns else np.zeros((len(s), 0), dtype=np.complex128)


def _solve(columns: Complex, wanted: Complex) -> Array:
    """Real least-squares unknowns of complex equations; columns are scaled alike, since poles differ in size."""
    rows, right = np.concatenate([columns.real, columns.imag]), np.concatenate([wanted.real, wanted.imag])
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    return np.linalg.lstsq(rows / size, right, rcond=None)[0] / size


def _zeros(pole: Complex, second: Array) -> Complex:
    """Zeros of 1 + sum of r' / (s - q), eigenvalues of A - b r'^T in real form, mirrored into the stable half plane."""
    matrix, b, at = np.zeros((len(second), len(second))), np.zeros(len(second)), 0
    for each in pole:
        if each.imag > 0:
            matrix[at : at + 2, at : at + 2] = [[each.real, each.imag], [-each.imag, each.real]]
            b[at] = 2.0
            at += 2
        else:
            matrix[at, at], b[at] = each.real, 1.0
            at += 1
    zero = np.linalg.eigvals(matrix - np.outer(b, second)).astype(np.complex128)
    zero = zero[zero.imag >= 0]
    return np.asarray(-abs(zero.real) + 1j * zero.imag)


def _residues(pole: Complex, found: Array) -> Complex:
    out, at = np.empty(len(pole), dtype=np.complex128), 0
    for i, each in enumerate(pole):
        out[i] = complex(found[at], found[at + 1]) if each.imag > 0 else found[at]
        at += 2 if each.imag > 0 else 1
    return out
